/** The plane that cuts the bodies open for the eye: one of the patient's planes, at a share of the way through the organ. */
import type { Vec3 } from "../fields";

export const AXES = ["off", "axial", "coronal", "sagittal"] as const;
export type PlaneAxis = (typeof AXES)[number];

export interface CutPlane {
  readonly point_m: Vec3;
  /** What lies on its side is not shown. */
  readonly normal: Vec3;
}

export interface Bounds {
  readonly min_m: Vec3;
  readonly max_m: Vec3;
}

/** What is taken away: what is above, in front, or to the patient's left. */
const NORMALS: Readonly<Record<Exclude<PlaneAxis, "off">, Vec3>> = { axial: [0, 0, 1], coronal: [0, -1, 0], sagittal: [1, 0, 0] };

/** `share`: from where all is shown's last bit, 0, to where nothing is left, 1; `flipped`: the other side is taken away. */
export function cutPlane(axis: PlaneAxis, share: number, flipped: boolean, { min_m, max_m }: Bounds): CutPlane | null {
  if (axis === "off") return null;
  const towards = NORMALS[axis].map((x) => (flipped && x !== 0 ? -x : x)) as [number, number, number];
  const point_m = min_m.map((low, k) => {
    const [from, to] = towards[k] >= 0 ? [max_m[k], low] : [low, max_m[k]];
    return towards[k] === 0 ? (low + max_m[k]) / 2 : from + share * (to - from);
  }) as [number, number, number];
  return { point_m, normal: towards };
}

/** How thick the organ is along a plane's normal [m]. */
export function thickness_m(axis: PlaneAxis, { min_m, max_m }: Bounds): number {
  const k = { axial: 2, coronal: 1, sagittal: 0, off: 0 }[axis];
  return max_m[k] - min_m[k];
}
