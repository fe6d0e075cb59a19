/** What who teaches draws on the tissue, and where somebody points: it goes with the tissue. */
import { Group, Vector3 } from "three";
import type { Vec3 } from "./fields";
import { Dots, dotsAlong, nearestOnSurface, placeIn, type OnSurface } from "./on_surface";
import type { Topology } from "./protocol";

const COLOUR = "#4fd2ff";
const POINTER_COLOUR = "#ff7ad9";
const DOT_RADIUS_M = 0.9e-3;
const PLACE_RADIUS_M = 2e-3;
const POINTER_RADIUS_M = 2.5e-3;
/** Dots of a stroke are so far apart [m], and not more than so many. */
const APART_M = 1.5e-3;
const MOST_OF_STROKE = 60;
const MOST_DOTS = 2000;

interface Placed {
  readonly radius_m: number;
  /** As it was asked for, on the tissue at rest. */
  readonly point: Vector3;
  place: Pick<OnSurface, "vertices" | "weights"> | null;
}

/** The dots of a stroke; one of a place. */
export function dotsOf(points_m: readonly Vec3[]): Vector3[] {
  const points = points_m.map((point) => new Vector3(...point));
  const length_m = points.slice(1).reduce((sum, point, i) => sum + point.distanceTo(points[i]), 0);
  if (length_m < APART_M) return points.slice(0, 1);
  return dotsAlong(points, Math.min(MOST_OF_STROKE, Math.ceil(length_m / APART_M)));
}

export class ClassMarks {
  readonly group = new Group();
  private readonly dots = new Dots(COLOUR, MOST_DOTS);
  private readonly pointers = new Dots(POINTER_COLOUR, 64);
  private topology: Topology | null = null;
  private positions_m: Float32Array | null = null;
  private marks: readonly Placed[] = [];
  private pointing: readonly Placed[] = [];
  private asked = "";

  constructor() {
    this.group.add(this.dots.mesh, this.pointers.mesh);
  }

  /** What is drawn: known strokes keep their places. */
  showMarks(marks: ReadonlyArray<readonly Vec3[]>): void {
    const dots = marks.flatMap((points_m) => {
      const along = dotsOf(points_m);
      return along.map((point) => ({ point, radius_m: along.length === 1 ? PLACE_RADIUS_M : DOT_RADIUS_M }));
    });
    const known = new Map(this.marks.map((mark) => [mark.point.toArray().join(), mark.place]));
    this.marks = dots.map((dot) => ({ ...dot, place: known.get(dot.point.toArray().join()) ?? this.find(dot.point) }));
    this.follow(this.positions_m);
  }

  /** Answers whether somebody points somewhere else. */
  showPointers(places_m: readonly Vec3[]): boolean {
    const asked = JSON.stringify(places_m);
    if (asked === this.asked) return false;
    this.asked = asked;
    this.pointing = places_m.map((place_m) => {
      const point = new Vector3(...place_m);
      return { point, radius_m: POINTER_RADIUS_M, place: this.find(point) };
    });
    this.follow(this.positions_m);
    return true;
  }

  /** Not in a cut, which was not there at rest. */
  private find(point: Vector3): OnSurface | null {
    if (this.topology === null) return null;
    const { rest_m, triangles, isCut } = this.topology;
    return nearestOnSurface(point, rest_m, triangles, (triangle) => isCut[triangle] === 1);
  }

  /** Places whose vertices are still there stay with them. */
  setTopology(topology: Topology): void {
    const before = this.topology;
    this.topology = topology;
    const vertexOf = new Map(Array.from(topology.nodeIds, (node, vertex) => [node, vertex]));
    for (const mark of [...this.marks, ...this.pointing]) {
      const nodes = before === null ? undefined : mark.place?.vertices.map((vertex) => vertexOf.get(before.nodeIds[vertex]));
      const [a, b, c] = nodes ?? [];
      const stays = mark.place !== null && a !== undefined && b !== undefined && c !== undefined;
      mark.place = stays && mark.place !== null ? { vertices: [a, b, c], weights: mark.place.weights } : this.find(mark.point);
    }
    this.follow(topology.rest_m);
  }

  /** The tissue has moved. */
  follow(positions_m: Float32Array | null): void {
    this.positions_m = positions_m;
    if (positions_m === null) return;
    const shown = (marks: readonly Placed[]): Array<{ at_m: Vector3; radius_m: number }> =>
      marks.flatMap(({ place, radius_m }) => (place === null ? [] : [{ at_m: placeIn(positions_m, place, new Vector3()), radius_m }]));
    this.dots.show(shown(this.marks));
    this.pointers.show(shown(this.pointing));
  }

  /** Where the dots are drawn [m]. */
  get shown(): { readonly dots: number; readonly pointers: number } {
    return { dots: this.dots.mesh.count, pointers: this.pointers.mesh.count };
  }
}
