/** Places that go with a deforming surface: a triangle, and weights of its corners. And dots there. */
import { InstancedMesh, Matrix4, MeshBasicMaterial, SphereGeometry, Triangle, Vector3 } from "three";

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

/** Where a point of a triangle lies at rest. */
export function atRest(point_m: Vector3, triangle: readonly [number, number, number], positions_m: Float32Array, rest_m: Float32Array): Vector3 {
  const [a, b, c] = triangle.map((vertex) => new Vector3().fromArray(positions_m, 3 * vertex));
  const weights = new Vector3();
  // Of a triangle without a face any corner will do.
  if (new Triangle(a, b, c).getBarycoord(point_m, weights) === null) weights.set(1, 0, 0);
  return placeIn(rest_m, { vertices: triangle, weights: [weights.x, weights.y, weights.z] }, new Vector3());
}

/** Points along a line, ends included [m]: the same way apart, whatever points it is given by. */
export function dotsAlong(points: readonly Vector3[], n: number): Vector3[] {
  const lengths = points.slice(1).map((point, i) => point.distanceTo(points[i]));
  const apart = lengths.reduce((sum, length) => sum + length, 0) / n;
  let [piece, before] = [0, 0];
  return Array.from({ length: n + 1 }, (_, i) => {
    while (piece < lengths.length - 1 && before + lengths[piece] < i * apart) {
      before += lengths[piece];
      piece += 1;
    }
    const share = lengths[piece] > 0 ? Math.min((i * apart - before) / lengths[piece], 1) : 0;
    return points[piece].clone().lerp(points[piece + 1], share);
  });
}

/** Dots of one colour. */
export class Dots {
  readonly mesh: InstancedMesh;
  private readonly most: number;

  constructor(colour: string, most: number) {
    // Seen through what lies before it, faintly enough not to be taken for tissue.
    const material = new MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.85, depthTest: false, toneMapped: false });
    this.most = most;
    this.mesh = new InstancedMesh(new SphereGeometry(1, 16, 12), material, most);
    this.mesh.count = 0;
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 12;
  }

  show(dots: ReadonlyArray<{ readonly at_m: Vector3; readonly radius_m: number }>): void {
    const shown = dots.slice(-this.most);
    shown.forEach(({ at_m, radius_m }, i) => this.mesh.setMatrixAt(i, new Matrix4().makeScale(radius_m, radius_m, radius_m).setPosition(at_m)));
    this.mesh.count = shown.length;
    this.mesh.instanceMatrix.needsUpdate = true;
  }
}
