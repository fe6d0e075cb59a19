/** Where a task wants something done, on the organ: a place, or a line that goes with the tissue. */
import { Group, Vector3 } from "three";
import { Dots, dotsAlong, nearestOnSurface, placeIn, type OnSurface } from "./on_surface";
import type { Topology } from "./protocol";
import type { TaskMark } from "./task";

const COLOUR = "#ffe14a";
/** Radius of the ball at a place, and of the dots of a line [m]. */
const PLACE_RADIUS_M = 2.2e-3;
const DOT_RADIUS_M = 0.8e-3;
/** Dots of a line. */
const DOTS = 40;

/** Points along a mark, ends included [m]: on a line the same way apart, whatever points it is given by. */
export function pointsOf(mark: TaskMark): Vector3[] {
  const points = mark.points_m.map((point) => new Vector3(...point));
  return mark.kind === "line" ? dotsAlong(points, DOTS) : points.slice(0, 1);
}

export class TaskMarks {
  readonly group = new Group();
  private mark: TaskMark | null = null;
  private topology: Topology | null = null;
  private places: readonly OnSurface[] = [];
  private readonly dots = new Dots(COLOUR, DOTS + 1);

  constructor() {
    this.group.add(this.dots.mesh);
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
    const { rest_m, triangles, isCut } = topology;
    // Not in a cut, which was not there when the task was made.
    this.places = pointsOf(mark).flatMap((point) => nearestOnSurface(point, rest_m, triangles, (t) => isCut[t] === 1) ?? []);
  }

  /** The tissue has moved. */
  follow(positions_m: Float32Array | null): void {
    const { mark } = this;
    const at: Vector3[] = mark?.kind === "space" ? pointsOf(mark) : [];
    if (positions_m !== null) {
      for (const place of this.places) at.push(placeIn(positions_m, place, new Vector3()));
    }
    const radius_m = mark?.kind === "line" ? DOT_RADIUS_M : PLACE_RADIUS_M;
    this.dots.show(at.map((at_m) => ({ at_m, radius_m })));
  }
}
