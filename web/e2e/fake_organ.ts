/**
 * TEST CODE ONLY: an ellipsoid that answers a tool with a closed-form dimple. No mechanics: it lets the viewer be
 * tested and developed without the simulator.
 */
import { Triangle, Vector3 } from "three";
import { CONTACT_KINDS, type ContactPoints } from "../src/contact_points";
import type { Vec3 } from "../src/fields";

const RADII_M: readonly [number, number, number] = [0.13, 0.075, 0.08];
/** Width of the dimple (standard deviation of a Gaussian) [m]. */
const DIMPLE_M = 0.022;
const STIFFNESS_N_PER_M = 240;

export const TIP_RADIUS_M = 0.005;
export const HOME_TIP_M = new Vector3(0.03, -0.13, 0.09);
export const HOME_SHAFT = new Vector3(0.35, -0.6, 0.72).normalize();

interface Contact {
  readonly vertices: readonly [number, number, number];
  readonly weights: readonly [number, number, number];
  /** Where the tip was when it touched [m], and the direction out of the organ there. */
  readonly tipThen_m: Vector3;
  readonly outward: Vector3;
  /** Influence of the contact on each vertex, 1 at the contact point. */
  readonly influence: Float64Array;
}

/** Icosahedron with `levels` subdivisions: 1,280 triangles for 3. */
function sphere(levels: number): { points: Vector3[]; triangles: number[] } {
  const g = (1 + Math.sqrt(5)) / 2;
  const points = [
    [-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g],
    [0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1],
  ].map((p) => new Vector3(...p).normalize());
  let triangles = [
    0, 11, 5, 0, 5, 1, 0, 1, 7, 0, 7, 10, 0, 10, 11, 1, 5, 9, 5, 11, 4, 11, 10, 2, 10, 7, 6, 7, 1, 8,
    3, 9, 4, 3, 4, 2, 3, 2, 6, 3, 6, 8, 3, 8, 9, 4, 9, 5, 2, 4, 11, 6, 2, 10, 8, 6, 7, 9, 8, 1,
  ];
  for (let level = 0; level < levels; level++) {
    const middles = new Map<string, number>();
    const middle = (a: number, b: number): number => {
      const key = a < b ? `${a} ${b}` : `${b} ${a}`;
      const known = middles.get(key);
      if (known !== undefined) return known;
      points.push(points[a].clone().add(points[b]).normalize());
      middles.set(key, points.length - 1);
      return points.length - 1;
    };
    const finer: number[] = [];
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = [triangles[t], triangles[t + 1], triangles[t + 2]];
      const [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
      finer.push(a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca);
    }
    triangles = finer;
  }
  return { points, triangles };
}

export class FakeOrgan {
  readonly rest_m: Vector3[];
  readonly triangles: number[];
  /** Not the vertex's own number, so that a mix-up of the two shows. */
  readonly nodeIds: number[];
  readonly fixedNodes: number[];
  positions_m: Vector3[];
  tip_m = HOME_TIP_M.clone();
  shaft = HOME_SHAFT.clone();
  private contact: Contact | null = null;

  constructor() {
    const { points, triangles } = sphere(3);
    // A dent above and a slimmer right end, so that it looks less like an egg; the frame is LPS.
    this.rest_m = points.map((p) => {
      const slim = 0.72 + 0.28 * Math.tanh(-2 * p.x);
      const dent = 1 - 0.16 * Math.exp(-((p.x - 0.15) ** 2) / 0.05) * Math.max(0, p.z);
      return new Vector3(RADII_M[0] * p.x, RADII_M[1] * p.y * slim, RADII_M[2] * p.z * slim * dent);
    });
    this.triangles = triangles;
    this.nodeIds = points.map((_, i) => 3 * i + 7);
    this.fixedNodes = this.nodeIds.filter((_, i) => points[i].y > 0.8);
    this.positions_m = this.rest_m.map((p) => p.clone());
  }

  reset(): void {
    this.contact = null;
    this.tip_m = HOME_TIP_M.clone();
    this.shaft = HOME_SHAFT.clone();
    this.deform();
  }

  /** The instrument goes to `tip_m`: touches, drags along, or lets go. */
  moveTool(tip_m: Vector3, shaft: Vector3): void {
    this.tip_m = tip_m.clone();
    this.shaft = shaft.clone();
    if (this.contact !== null && this.pull().dot(this.contact.outward) > 0.0005) this.contact = null;
    if (this.contact === null) {
      this.deform();
      this.contact = this.touch();
    }
    this.deform();
  }

  private pull(): Vector3 {
    return this.contact === null ? new Vector3() : this.tip_m.clone().sub(this.contact.tipThen_m);
  }

  private touch(): Contact | null {
    let best: { distance: number; t: number; point: Vector3 } | null = null;
    const triangle = new Triangle();
    const point = new Vector3();
    for (let t = 0; t < this.triangles.length; t += 3) {
      triangle.set(...this.corners(t));
      triangle.closestPointToPoint(this.tip_m, point);
      const distance = point.distanceTo(this.tip_m);
      if (best === null || distance < best.distance) best = { distance, t, point: point.clone() };
    }
    if (best === null || best.distance > TIP_RADIUS_M) return null;
    triangle.set(...this.corners(best.t));
    const weights = triangle.getBarycoord(best.point, new Vector3()) ?? new Vector3(1, 0, 0);
    const normal = triangle.getNormal(new Vector3());
    const { point: touched } = best;
    const raw = Float64Array.from(this.rest_m, (p) => Math.exp(-p.distanceToSquared(touched) / (2 * DIMPLE_M ** 2)));
    const vertices = [0, 1, 2].map((k) => this.triangles[best.t + k]) as [number, number, number];
    const w = weights.toArray() as [number, number, number];
    // The contact point follows the tool exactly.
    const atPoint = w[0] * raw[vertices[0]] + w[1] * raw[vertices[1]] + w[2] * raw[vertices[2]];
    return {
      vertices,
      weights: w,
      tipThen_m: touched.clone().addScaledVector(normal, TIP_RADIUS_M),
      outward: normal,
      influence: raw.map((x) => x / atPoint),
    };
  }

  private corners(t: number): [Vector3, Vector3, Vector3] {
    return [0, 1, 2].map((k) => this.rest_m[this.triangles[t + k]]) as [Vector3, Vector3, Vector3];
  }

  private deform(): void {
    const pull = this.pull();
    const { contact } = this;
    this.positions_m = this.rest_m.map((p, i) =>
      contact === null ? p.clone() : p.clone().addScaledVector(pull, contact.influence[i]),
    );
  }

  forceOnTool_n(): Vector3 {
    return this.pull().multiplyScalar(-STIFFNESS_N_PER_M);
  }

  /** The contact as a point, and a made-up one of the organ with itself; of the latter there are more than are told. */
  contactPoints(): ContactPoints {
    const report = this.contactReport();
    if (this.contact === null || report === null) return { sums: CONTACT_KINDS.map(() => ({ n: 0, force_n: 0 })), points: [] };
    const own = {
      kind: "tool_organ" as const,
      touched: 0,
      by: 0,
      place_m: report.point_m as unknown as Vec3,
      normal: this.contact.outward.toArray(),
      force_n: this.forceOnTool_n().toArray(),
    };
    const fold = { ...own, kind: "itself" as const, place_m: this.rest_m[0].toArray(), force_n: [0.25, 0, 0] as const };
    const sums = [{ n: 1, force_n: this.forceOnTool_n().length() }, { n: 0, force_n: 0 }, { n: 0, force_n: 0 }, { n: 5, force_n: 0.75 }, { n: 0, force_n: 0 }];
    return { sums, points: [own, fold] };
  }

  contactReport(): { point_m: number[]; node_ids: number[]; weights: number[] } | null {
    if (this.contact === null) return null;
    const { vertices, weights } = this.contact;
    const point = new Vector3();
    vertices.forEach((v, k) => point.addScaledVector(this.positions_m[v], weights[k]));
    return { point_m: point.toArray(), node_ids: vertices.map((v) => this.nodeIds[v]), weights: [...weights] };
  }
}
