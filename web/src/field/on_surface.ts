/** Places that go with a deforming surface: a triangle, and weights of its corners. */
import { Triangle, Vector3 } from "three";

export interface OnSurface {
  readonly triangle: number;
  readonly vertices: readonly [number, number, number];
  readonly weights: readonly [number, number, number];
}

/** Where it is in the surface that has its vertices there. */
export function placeIn(positions_m: ArrayLike<number>, { vertices, weights }: Omit<OnSurface, "triangle">, into: Vector3): Vector3 {
  into.set(0, 0, 0);
  for (let k = 0; k < 3; k++) {
    const at = 3 * vertices[k];
    into.x += weights[k] * positions_m[at];
    into.y += weights[k] * positions_m[at + 1];
    into.z += weights[k] * positions_m[at + 2];
  }
  return into;
}

const triangle = new Triangle();
const [closest, shares] = [new Vector3(), new Vector3()];

/** The place of some triangles that is nearest to a point, and its distance; null where all of them are flat, or none is given. */
export function nearestOf(point_m: Vector3, positions_m: ArrayLike<number>, triangles: Uint32Array, some: Iterable<number>): (OnSurface & { readonly distance_m: number }) | null {
  let nearest: OnSurface | null = null;
  let least = Infinity;
  for (const t of some) {
    const vertices = [triangles[3 * t], triangles[3 * t + 1], triangles[3 * t + 2]] as const;
    triangle.a.fromArray(positions_m as number[], 3 * vertices[0]);
    triangle.b.fromArray(positions_m as number[], 3 * vertices[1]);
    triangle.c.fromArray(positions_m as number[], 3 * vertices[2]);
    // No place of it is nearer than its first corner, less how far it reaches from there.
    const reach = Math.max(triangle.a.distanceTo(triangle.b), triangle.a.distanceTo(triangle.c));
    if (triangle.a.distanceTo(point_m) - reach >= least) continue;
    const distance = triangle.closestPointToPoint(point_m, closest).distanceTo(point_m);
    if (distance < least && triangle.getBarycoord(closest, shares) !== null) {
      least = distance;
      nearest = { triangle: t, vertices, weights: [shares.x, shares.y, shares.z] };
    }
  }
  return nearest && { ...nearest, distance_m: least };
}

/** The same of a whole surface, but for the triangles that are left out. */
export function nearestOnSurface(point_m: Vector3, positions_m: ArrayLike<number>, triangles: Uint32Array, isLeftOut?: (triangle: number) => boolean): OnSurface | null {
  const all = function* (): Generator<number> {
    for (let t = 0; t < triangles.length / 3; t++) if (isLeftOut?.(t) !== true) yield t;
  };
  return nearestOf(point_m, positions_m, triangles, all());
}
