/** Solids that instruments are made of. In the tool's frame: x the way jaws open, z towards the handle. */
import { BufferGeometry, CatmullRomCurve3, ExtrudeGeometry, LatheGeometry, Matrix4, Path, Shape, TubeGeometry, Vector2, Vector3 } from "three";
import { mergeGeometries } from "three/examples/jsm/utils/BufferGeometryUtils.js";

/** A place of an outline: how far in front of the hinge, and across. */
export type Place = readonly [forward_m: number, across_m: number];

/** A surface of revolution about z from (radius, z) pairs. */
export function revolved(profile: ReadonlyArray<readonly [number, number]>): BufferGeometry {
  const geometry = new LatheGeometry(profile.map(([radius, z]) => new Vector2(Math.max(radius, 0), z)), 40);
  // The lathe turns about y; the shaft runs along z.
  return geometry.rotateX(Math.PI / 2);
}

/** A round wire through places of the tool's frame. */
export function wire(places: ReadonlyArray<readonly [number, number, number]>, radius_m: number): BufferGeometry {
  const curve = new CatmullRomCurve3(places.map((place) => new Vector3(...place)), false, "catmullrom", 0.5);
  return new TubeGeometry(curve, 8 * places.length, radius_m, 12);
}

/** A rounded opening in a plate, from one place along its middle to another. */
function slot(from_m: number, to_m: number, halfWidth_m: number): Path {
  const path = new Path();
  path.absarc(from_m + halfWidth_m, 0, halfWidth_m, 0.5 * Math.PI, 1.5 * Math.PI, false);
  path.absarc(to_m - halfWidth_m, 0, halfWidth_m, -0.5 * Math.PI, 0.5 * Math.PI, false);
  path.closePath();
  return path;
}

export interface PlateShape {
  readonly outline: readonly Place[];
  readonly thickness_m: number;
  /** Of its edges. */
  readonly rounding_m: number;
  /** An opening along its middle: where it begins and ends, and half its width. */
  readonly window?: readonly [from_m: number, to_m: number, halfWidth_m: number];
}

/** Axes of a plate in the tool's frame: where forward, across and thickness go. */
type PlateAxes = readonly [forward: Vector3, across: Vector3, thick: Vector3];
const FORWARD = new Vector3(0, 0, -1);
/** A jaw that closes with its face: flat across y, thick along x. */
export const FACE_ON: PlateAxes = [FORWARD, new Vector3(0, 1, 0), new Vector3(1, 0, 0)];
/** A blade: flat in the plane in which jaws open, thick to -y. */
export const EDGE_ON: PlateAxes = [FORWARD, new Vector3(1, 0, 0), new Vector3(0, -1, 0)];

/** A plate with rounded edges, from thickness 0 on. */
export function plate({ outline, thickness_m, rounding_m, window }: PlateShape, axes: PlateAxes): BufferGeometry {
  const shape = new Shape(outline.map(([forward, across]) => new Vector2(forward, across)));
  if (window !== undefined) shape.holes.push(slot(...window));
  const bevel = { bevelEnabled: rounding_m > 0, bevelThickness: rounding_m, bevelSize: rounding_m, bevelOffset: -rounding_m, bevelSegments: 2 };
  const geometry = new ExtrudeGeometry(shape, { depth: thickness_m - 2 * rounding_m, curveSegments: 6, steps: 1, ...bevel });
  geometry.translate(0, 0, rounding_m);
  return geometry.applyMatrix4(new Matrix4().makeBasis(...axes));
}

/** The outline of a tongue: its half widths at shares of its length, with a round end. */
export function tongue(length_m: number, halfWidths: ReadonlyArray<readonly [share: number, half_m: number]>): Place[] {
  const side = halfWidths.map(([share, half]): Place => [share * length_m, half]);
  const [end, half] = side[side.length - 1];
  const round = [0.25, 0.5, 0.75].map((turn): Place => [end + half * Math.sin(turn * Math.PI), half * Math.cos(turn * Math.PI)]);
  return [...side, ...round, ...side.map(([forward, across]): Place => [forward, -across]).reverse()];
}

/** Joins parts of one look. */
export function joined(parts: readonly BufferGeometry[]): BufferGeometry {
  const plain = parts.map((part) => {
    const flat = part.index === null ? part : part.toNonIndexed();
    for (const name of Object.keys(flat.attributes)) if (name !== "position" && name !== "normal") flat.deleteAttribute(name);
    return flat;
  });
  const whole = mergeGeometries(plain);
  for (const part of [...parts, ...plain]) part.dispose();
  return whole;
}

/** Bends what lies in front of the hinge to +y, as the jaws of dissecting instruments are: `rise_m` at `length_m`. */
export function curved(geometry: BufferGeometry, length_m: number, rise_m: number): BufferGeometry {
  const place = geometry.getAttribute("position");
  for (let i = 0; i < place.count; i++) {
    const share = Math.max(0, -place.getZ(i)) / length_m;
    place.setY(i, place.getY(i) + rise_m * share * share);
  }
  return geometry;
}
