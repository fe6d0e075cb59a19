/** Places of the surface that go with the tissue, and dots there. */
import { InstancedMesh, Matrix4, MeshBasicMaterial, SphereGeometry, Triangle, Vector3 } from "three";
import type { Topology } from "./protocol";

/** A point of the surface: three vertices and their weights. */
export interface OnSurface {
  readonly vertices: readonly [number, number, number];
  readonly weights: readonly [number, number, number];
}

/** The place of the surface at rest that is nearest to a point; not in a cut, which was not there when the task was made. */
export function nearestOnSurface(point: Vector3, { rest_m, triangles, isCut }: Pick<Topology, "rest_m" | "triangles" | "isCut">): OnSurface | null {
  let nearest: OnSurface | null = null;
  let least = Infinity;
  const triangle = new Triangle();
  const [closest, weights] = [new Vector3(), new Vector3()];
  for (let t = 0; t < isCut.length; t += 1) {
    if (isCut[t] === 1) continue;
    const vertices = [triangles[3 * t], triangles[3 * t + 1], triangles[3 * t + 2]] as const;
    [triangle.a, triangle.b, triangle.c].forEach((corner, k) => corner.fromArray(rest_m, 3 * vertices[k]));
    // No place of it is nearer than its first corner, less how far it reaches from there.
    const reach = Math.max(triangle.a.distanceTo(triangle.b), triangle.a.distanceTo(triangle.c));
    if (triangle.a.distanceTo(point) - reach >= least) continue;
    const distance = triangle.closestPointToPoint(point, closest).distanceTo(point);
    if (distance < least && triangle.getBarycoord(closest, weights) !== null) {
      least = distance;
      nearest = { vertices, weights: [weights.x, weights.y, weights.z] };
    }
  }
  return nearest;
}

/** Where a place is when the vertices are at `positions_m`. */
export function pointAt({ vertices, weights }: OnSurface, positions_m: Float32Array): Vector3 {
  const [point, corner] = [new Vector3(), new Vector3()];
  vertices.forEach((vertex, k) => point.addScaledVector(corner.fromArray(positions_m, 3 * vertex), weights[k]));
  return point;
}

/** Where a point of a triangle lies at rest. */
export function atRest(point_m: Vector3, triangle: readonly [number, number, number], positions_m: Float32Array, rest_m: Float32Array): Vector3 {
  const [a, b, c] = triangle.map((vertex) => new Vector3().fromArray(positions_m, 3 * vertex));
  const weights = new Vector3();
  // Of a triangle without a face any corner will do.
  if (new Triangle(a, b, c).getBarycoord(point_m, weights) === null) weights.set(1, 0, 0);
  return pointAt({ vertices: triangle, weights: [weights.x, weights.y, weights.z] }, rest_m);
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
