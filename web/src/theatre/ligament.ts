/**
 * The falciform ligament, as scenery: a thin curved sheet from the front of a liver to the wall of the abdomen in front of it, to the
 * left of the liver's middle, with the round ligament in its free edge. It is made for the liver at rest, and nothing touches it.
 */
import { Box3, Ray, Vector3 } from "three";
import { valueNoise } from "../noise";
import type { Abdomen } from "./walls";

/** Where it is across the liver, as a share of its width from the patient's right, and from which height of it to which. Choices. */
const ACROSS = 0.62;
const FROM_HEIGHT = 0.5;
const TO_HEIGHT = 0.97;
/** Grid: heights, and places from the liver to the wall. */
const HEIGHTS = 22;
const PLACES = 13;
/** Its ends are so far inside the liver and the wall [m]. */
const ROOTED_M = 6e-3;
/** Thickness of the sheet, and radius of the cord in its edge [m]. */
const THICKNESS_M = 1.4e-3;
const CORD_RADIUS_M = 2.6e-3;
/** Its edge sags towards the liver by this share of its width; the sheet bulges to the side by that [m]. */
const SAG = 0.22;
const BULGE_M = 7e-3;
const WAVES_M = 5e-3;
/** No sheet is made where the wall is nearer to the liver [m]. */
const LEAST_GAP_M = 4e-3;

export interface LiverSurface {
  readonly rest_m: Float32Array;
  /** Vertices of the liver's triangles alone, whatever else there is. */
  readonly triangles: Uint32Array;
}

type Corners = readonly [Vector3, Vector3, Vector3];

function cornersOf({ rest_m, triangles }: LiverSurface): Corners[] {
  const corner = (at: number): Vector3 => new Vector3().fromArray(rest_m, 3 * triangles[at]);
  return Array.from({ length: triangles.length / 3 }, (_, t) => [corner(3 * t), corner(3 * t + 1), corner(3 * t + 2)]);
}

/** How far to the front triangles are at a place across and a height; null where none is. */
function frontAt(x_m: number, z_m: number, before_m: number, triangles: readonly Corners[]): number | null {
  const ray = new Ray(new Vector3(x_m, before_m, z_m), new Vector3(0, 1, 0));
  let front: number | null = null;
  const hit = new Vector3();
  for (const [a, b, c] of triangles) {
    if (ray.intersectTriangle(a, b, c, false, hit) !== null && (front === null || hit.y < front)) front = hit.y;
  }
  return front;
}

/** Where the wall is in front of a place; null outside of it. */
function wallAt(x_m: number, z_m: number, { middle_m, half_m }: Abdomen): number | null {
  const left = 1 - ((x_m - middle_m.x) / half_m.x) ** 2 - ((z_m - middle_m.z) / half_m.z) ** 2;
  return left > 0 ? middle_m.y - half_m.y * Math.sqrt(left) : null;
}

/**
 * The sheet as a closed surface, rows from its free edge towards the head, columns around from the liver to the wall and back; null
 * where the liver has no front there, or the wall is too near.
 */
export function falciform(liver: LiverSurface, abdomen: Abdomen): { readonly rows: number; readonly columns: number; readonly at: (row: number, column: number) => Vector3 } | null {
  const all = cornersOf(liver);
  const box = new Box3().setFromPoints(all.flat());
  const at = (share: number, axis: "x" | "z"): number => box.min[axis] + share * (box.max[axis] - box.min[axis]);
  const x = at(ACROSS, "x");
  const across = all.filter((corners) => Math.min(...corners.map((c) => c.x)) <= x && Math.max(...corners.map((c) => c.x)) >= x);
  const edges: Array<{ readonly z: number; readonly liver: number; readonly wall: number }> = [];
  for (let i = 0; i < HEIGHTS; i++) {
    const z = at(FROM_HEIGHT + ((TO_HEIGHT - FROM_HEIGHT) * i) / (HEIGHTS - 1), "z");
    const [front, wall] = [frontAt(x, z, box.min.y - 1, across), wallAt(x, z, abdomen)];
    if (front === null || wall === null || front - wall < LEAST_GAP_M) {
      // One piece: what comes after a gap is left out.
      if (edges.length > 1) break;
      edges.length = 0;
      continue;
    }
    edges.push({ z, liver: front + ROOTED_M, wall: wall - ROOTED_M });
  }
  if (edges.length < 4) return null;
  const place = (row: number, share: number): Vector3 => {
    const { z, liver: from, wall: to } = edges[row];
    const high = row / (edges.length - 1);
    const side = BULGE_M * Math.sin(Math.PI * share) * Math.cos(2.2 * high) + WAVES_M * (valueNoise(4 * share, 5 * high, 3.5) - 0.5) * Math.sin(Math.PI * share);
    // The edge hangs down between its ends; above it the sheet is as tight as it was.
    const sag = SAG * (to - from) * Math.sin(Math.PI * share) * (1 - high) ** 2;
    return new Vector3(x + side, from + share * (to - from), z - sag);
  };
  return {
    rows: edges.length,
    columns: 2 * PLACES,
    at: (row, column) => {
      const isBack = column >= PLACES;
      const share = (isBack ? 2 * PLACES - 1 - column : column) / (PLACES - 1);
      // The cord is round, and closes the edge; the other end is closed, too.
      const half = row === 0 || row === edges.length - 1 ? 0 : row === 1 ? CORD_RADIUS_M : 0.5 * THICKNESS_M;
      const middle = place(row, share);
      middle.x += isBack ? half : -half;
      return middle;
    },
  };
}
