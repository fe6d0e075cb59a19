/**
 * Jaws, each in the frame of its hinge: along -z, on the side of +x of the plane in which the two meet. The one on the other side
 * is turned by half a turn about z. Sizes follow those that the simulator touches tissue with (length, width, radius of the tip);
 * what lies between is made up.
 */
import { BoxGeometry, CylinderGeometry, SphereGeometry, type BufferGeometry } from "three";
import type { JawsInfo } from "../protocol";
import type { Part } from "./parts";
import { curved, EDGE_ON, FACE_ON, joined, plate, tongue, wire } from "./shapes";

/** Half the width of jaws, and how thick each is. */
interface JawSize {
  readonly length_m: number;
  readonly half_m: number;
  readonly thick_m: number;
}

function sizeOf(jaws: JawsInfo, tipRadius_m: number): JawSize {
  return { length_m: jaws.length_m, half_m: Math.max(0.5 * jaws.width_m, tipRadius_m), thick_m: Math.max(tipRadius_m, 0.5e-3) };
}

/** Rows of teeth on the face that meets the other jaw. */
function teeth({ length_m, half_m, thick_m }: JawSize, from: number, to: number, halfWidth_m: number, sides: readonly number[]): BufferGeometry[] {
  const apart_m = Math.max(0.9e-3, length_m / 16);
  const n = Math.max(1, Math.floor(((to - from) * length_m) / apart_m));
  return sides.flatMap((side) =>
    Array.from({ length: n }, (_, i) =>
      new CylinderGeometry(0.24 * thick_m, 0.24 * thick_m, 2 * halfWidth_m, 3, 1)
        .translate(0, side * half_m, 0)
        .translate(0.12 * thick_m, 0, -from * length_m - (i + 0.5) * apart_m),
    ),
  );
}

/** Atraumatic: a wide jaw with an opening, and teeth around it. */
function fenestrated(size: JawSize): Part[] {
  const { length_m, half_m, thick_m } = size;
  const end = length_m - half_m * 0.9;
  const body = plate({
    outline: tongue(length_m, [[0, 0.55 * half_m], [0.16, 0.97 * half_m], [0.5, half_m], [end / length_m, 0.9 * half_m]]),
    thickness_m: thick_m,
    rounding_m: 0.3 * thick_m,
    window: [0.26 * length_m, end - 0.1 * half_m, 0.42 * half_m],
  }, FACE_ON);
  return [{ look: "polished", geometry: joined([body, ...teeth(size, 0.2, 0.86, 0.2 * half_m, [-0.7, 0.7]), ...teeth(size, 0.88, 0.99, 0.6 * half_m, [0])]) }];
}

/** A curved blade beside the middle plane; its edge passes that of the other one. */
function blade({ length_m, thick_m }: JawSize, bend: (part: BufferGeometry) => BufferGeometry): Part[] {
  const outer: Array<[number, number]> = [[0, 1.1], [0.25, 1.25], [0.55, 1.05], [0.8, 0.7], [0.95, 0.35], [1, 0.1]];
  const outline = [...outer.map(([share, x]) => [share * length_m, x * thick_m] as const), [length_m, -0.08 * thick_m] as const, [0, -0.2 * thick_m] as const];
  const body = plate({ outline, thickness_m: 0.6 * thick_m, rounding_m: 0.1 * thick_m }, EDGE_ON);
  return [{ look: "polished", geometry: bend(joined([body])) }];
}

/** Of a clip applier: a narrow jaw with a channel, in which a leg of the clip lies. */
function channelled({ length_m, half_m, thick_m }: JawSize): Part[] {
  const half = 0.5 * half_m;
  const back = plate({ outline: tongue(length_m, [[0, 0.9 * half], [0.3, half], [0.94, half]]), thickness_m: 0.55 * thick_m, rounding_m: 0.12 * thick_m }, FACE_ON);
  back.translate(0.4 * thick_m, 0, 0);
  const lips = [-1, 1].map((side) => new BoxGeometry(0.5 * thick_m, 0.3 * half, 0.55 * length_m).translate(0.3 * thick_m, 0.85 * side * half, -0.68 * length_m));
  const leg = wire([[0.3 * thick_m, 0, -0.42 * length_m], [0.22 * thick_m, 0, -0.7 * length_m], [0.2 * thick_m, 0, -0.95 * length_m]], 0.22 * thick_m);
  return [{ look: "steel", geometry: joined([back, ...lips]) }, { look: "titanium", geometry: leg }];
}

/** Of a bipolar forceps: a slender curved jaw with a plate that heats, insulated outside. */
function sealing({ length_m, half_m, thick_m }: JawSize, bend: (part: BufferGeometry) => BufferGeometry): Part[] {
  const outline = tongue(length_m, [[0, 0.6 * half_m], [0.3, 0.75 * half_m], [0.9, 0.4 * half_m]]);
  const inner = tongue(0.97 * length_m, [[0.25, 0.6 * half_m], [0.9, 0.3 * half_m]]);
  const outside = plate({ outline, thickness_m: 0.8 * thick_m, rounding_m: 0.3 * thick_m }, FACE_ON).translate(0.3 * thick_m, 0, 0);
  const face = plate({ outline: inner, thickness_m: 0.34 * thick_m, rounding_m: 0.05 * thick_m }, FACE_ON);
  return [{ look: "insulation", geometry: bend(joined([outside])) }, { look: "polished", geometry: bend(joined([face])) }];
}

/** The parts of one of two jaws; side 1 is the one at -x. */
export function jawParts(kind: string, jaws: JawsInfo, tipRadius_m: number, side: 0 | 1): Part[] {
  const size = sizeOf(jaws, tipRadius_m);
  const turned = (part: BufferGeometry): BufferGeometry => (side === 1 ? part.rotateZ(Math.PI) : part);
  // Both bend the same way, whichever side they are on.
  const bend = (share: number) => (part: BufferGeometry): BufferGeometry => curved(turned(part), size.length_m, share * size.length_m);
  if (kind === "scissors") return blade(size, bend(0.1));
  if (kind === "cautery") return sealing(size, bend(0.12));
  const parts = kind === "clipper" ? channelled(size) : fenestrated(size);
  for (const part of parts) turned(part.geometry);
  return parts;
}

/** What carries the jaws in front of the shaft: a fork, and the pin that they turn about. In the tool's frame; answers where the shaft begins, too. */
export function hinge(jaws: JawsInfo, tipRadius_m: number, shaftRadius_m: number): { readonly parts: Part[]; readonly shaftFrom_m: number } {
  const { length_m, half_m, thick_m } = sizeOf(jaws, tipRadius_m);
  const outer = Math.min(half_m, shaftRadius_m);
  const prongs = [-1, 1].map((side) => new BoxGeometry(1.5 * thick_m, 0.3 * outer, 3 * outer).translate(0, side * 0.85 * outer, length_m + 0.9 * outer));
  const pin = new CylinderGeometry(0.4 * thick_m, 0.4 * thick_m, 2.1 * outer, 16).translate(0, 0, length_m);
  const knuckle = new SphereGeometry(0.8 * outer, 16, 12).translate(0, 0, length_m + 0.35 * outer);
  const shaftFrom_m = length_m + 2 * outer;
  return { parts: [{ look: "steel", geometry: joined([...prongs, pin, knuckle]) }], shaftFrom_m };
}
