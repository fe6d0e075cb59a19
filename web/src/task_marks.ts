/** Where a task wants something done, on the organ: a place, or a line that goes with the tissue. */
import { Group, InstancedMesh, Matrix4, MeshBasicMaterial, SphereGeometry, Triangle, Vector3 } from "three";
import type { Topology } from "./protocol";
import type { TaskMark } from "./task";

const COLOUR = "#ffe14a";
/** Radius of the ball at a place, and of the dots of a line [m]. */
const PLACE_RADIUS_M = 2.2e-3;
const DOT_RADIUS_M = 0.8e-3;
/** Dots of a line. */
const DOTS = 40;

/** A point of the surface: three vertices and their weights. */
interface OnSurface {
  readonly vertices: readonly [number, number, number];
  readonly weights: readonly [number, number, number];
}

/** Points along a mark, ends included [m]: on a line the same way apart, whatever points it is given by. */
export function pointsOf(mark: TaskMark): Vector3[] {
  const points = mark.points_m.map((point) => new Vector3(...point));
  if (mark.kind !== "line") return points.slice(0, 1);
  const lengths = points.slice(1).map((point, i) => point.distanceTo(points[i]));
  const apart = lengths.reduce((sum, length) => sum + length, 0) / DOTS;
  let [piece, before] = [0, 0];
  return Array.from({ length: DOTS + 1 }, (_, i) => {
    while (piece < lengths.length - 1 && before + lengths[piece] < i * apart) {
      before += lengths[piece];
      piece += 1;
    }
    const share = Math.min((i * apart - before) / lengths[piece], 1);
    return points[piece].clone().lerp(points[piece + 1], share);
  });
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

export class TaskMarks {
  readonly group = new Group();
  private mark: TaskMark | null = null;
  private topology: Topology | null = null;
  private places: readonly OnSurface[] = [];
  private readonly ball = new SphereGeometry(1, 16, 12);
  private readonly dots: InstancedMesh;

  constructor() {
    // Seen through what lies before it, faintly enough not to be taken for tissue.
    const material = new MeshBasicMaterial({ color: COLOUR, transparent: true, opacity: 0.85, depthTest: false, toneMapped: false });
    this.dots = new InstancedMesh(this.ball, material, DOTS + 1);
    this.dots.count = 0;
    this.dots.frustumCulled = false;
    this.dots.renderOrder = 12;
    this.group.add(this.dots);
  }

  /** Answers whether something else is to be drawn. */
  show(mark: TaskMark | null, positions_m: Float32Array | null): boolean {
    if (JSON.stringify(mark) === JSON.stringify(this.mark)) return false;
    this.mark = mark;
    this.find();
    this.follow(positions_m);
    return true;
  }

  setTopology(topology: Topology): void {
    this.topology = topology;
    this.find();
    this.follow(topology.rest_m);
  }

  private find(): void {
    const { mark, topology } = this;
    this.places = [];
    if (mark === null || topology === null || mark.kind === "space") return;
    this.places = pointsOf(mark).flatMap((point) => nearestOnSurface(point, topology) ?? []);
  }

  /** The tissue has moved. */
  follow(positions_m: Float32Array | null): void {
    const { mark } = this;
    const at: Vector3[] = mark?.kind === "space" ? pointsOf(mark) : [];
    if (positions_m !== null) {
      const corner = new Vector3();
      for (const { vertices, weights } of this.places) {
        const point = new Vector3();
        vertices.forEach((vertex, k) => point.addScaledVector(corner.fromArray(positions_m, 3 * vertex), weights[k]));
        at.push(point);
      }
    }
    const radius_m = mark?.kind === "line" ? DOT_RADIUS_M : PLACE_RADIUS_M;
    at.forEach((point, i) => this.dots.setMatrixAt(i, new Matrix4().makeScale(radius_m, radius_m, radius_m).setPosition(point)));
    this.dots.count = at.length;
    this.dots.instanceMatrix.needsUpdate = true;
  }
}
