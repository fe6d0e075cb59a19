/**
 * Clips on vessels in the picture: a closed U of titanium wire across each, around the duct where the vessel runs in a thin one; else,
 * as at an open end in a cut face, about as wide as the vessel.
 */
import { CatmullRomCurve3, Group, Matrix4, Mesh, Ray, TubeGeometry, Vector3, type ShaderMaterial } from "three";
import type { Clip } from "./clips";
import { Surfaces } from "./instruments/surfaces";

/** Wire: its thickness, and how much wider it is along the vessel; it is pressed into the tissue by a part of that. */
const WIRE_RADIUS_M = 0.5e-3;
const WIDER = 1.8;
const PRESSED = 0.3;
/** Tissue around a vessel is a duct where it ends within so many radii of the vessel, and so much more [m]: a choice. */
const DUCT_RADII = 2;
const DUCT_MORE_M = 4e-3;
/** A clip so near to a cut face [m] lies on it. */
const AT_FACE_M = 3e-3;
/** Between a superellipse, as straight as legs are, and an ellipse (1). */
const ROUND = 0.72;
/** Half the angle that is left open between the ends of the legs [rad]. */
const GAP_RAD = 0.16;
const PLACES = 28;

/** Rays go past the edges of meshes that lie straight, where rounding lets them through between two triangles. */
const ASIDE = new Vector3(0.0131, 0.0077, 0.0101);

/** The surface that clips are drawn around. */
export interface ClippedSurface {
  readonly positions_m: Float32Array;
  readonly topology: { readonly triangles: Uint32Array };
}

/** How far the tissue reaches from a place in a direction; none where it does not end within `most_m`. */
export function tissueEnd_m(from_m: Vector3, direction: Vector3, most_m: number, { positions_m, topology: { triangles } }: ClippedSurface): number | null {
  const ray = new Ray(from_m, direction.clone().add(ASIDE).normalize());
  const [a, b, c, hit] = [new Vector3(), new Vector3(), new Vector3(), new Vector3()];
  let least = most_m;
  let found = false;
  for (let t = 0; t < triangles.length; t += 3) {
    a.fromArray(positions_m, 3 * triangles[t]);
    b.fromArray(positions_m, 3 * triangles[t + 1]);
    c.fromArray(positions_m, 3 * triangles[t + 2]);
    if (ray.intersectTriangle(a, b, c, false, hit) === null) continue;
    const away = hit.distanceTo(from_m);
    if (away > least) continue;
    [least, found] = [away, true];
  }
  return found ? least : null;
}

/** How far a clip's wire is from the vessel's axis: to either side, to the bend, to the legs' ends; and how far it lies ahead of its place. */
interface ClipShape {
  readonly sides_m: readonly [number, number];
  readonly bend_m: number;
  readonly ends_m: number;
  readonly ahead_m: number;
}

const axesOf = ({ along, legs }: Clip): readonly [side: Vector3, legs: Vector3, along: Vector3] => {
  const [z, y] = [new Vector3(...along), new Vector3(...legs)];
  return [y.clone().cross(z), y, z];
};

function shapeOf(clip: Clip, surface: ClippedSurface | null): ClipShape {
  const { radius_m } = clip;
  const at = new Vector3(...clip.position_m);
  const [side, legs, along] = axesOf(clip);
  const most_m = (1 + DUCT_RADII) * radius_m + DUCT_MORE_M;
  const found = [side, side.clone().negate(), legs, legs.clone().negate()].map((way) => surface && tissueEnd_m(at, way, most_m, surface));
  // Of a duct both sides end.
  const isDuct = found[0] !== null && found[1] !== null;
  const wire = (1 - PRESSED) * WIRE_RADIUS_M;
  const [right, left, bend, ends] = found.map((end_m) => Math.max(isDuct ? (end_m ?? 0) : 0, radius_m) + wire);
  const face_m = isDuct || surface === null ? null : tissueEnd_m(at, along, AT_FACE_M, surface);
  return { sides_m: [right, left], bend_m: bend, ends_m: ends, ahead_m: face_m ?? 0 };
}

/** In the clip's frame: x to its side, y along its legs to the bend, z along the vessel. */
function wireOf({ sides_m, bend_m, ends_m, ahead_m }: ClipShape): TubeGeometry {
  const power = (x: number): number => Math.sign(x) * Math.abs(x) ** ROUND;
  const places = Array.from({ length: PLACES }, (_, i) => {
    const turn = GAP_RAD - Math.PI / 2 + ((2 * Math.PI - 2 * GAP_RAD) * i) / (PLACES - 1);
    const [x, y] = [power(Math.cos(turn)), power(Math.sin(turn))];
    return new Vector3(x * sides_m[x > 0 ? 0 : 1], y * (y > 0 ? bend_m : ends_m), 0);
  });
  const wire = new TubeGeometry(new CatmullRomCurve3(places), 3 * PLACES, WIRE_RADIUS_M, 10);
  wire.scale(1, 1, WIDER).translate(0, 0, ahead_m);
  return wire;
}

export class ClipMarks {
  readonly group = new Group();
  private readonly titanium: ShaderMaterial = new Surfaces().of("titanium");
  /** Of what the shapes of the clips are. */
  private topology: ClippedSurface["topology"] | null = null;

  /** Shapes are made anew where clips come or go, or the surface is another one. */
  show(clips: readonly Clip[], surface: ClippedSurface | null): void {
    const { children } = this.group;
    if (children.length !== clips.length || (clips.length > 0 && this.topology !== (surface?.topology ?? null))) {
      this.topology = surface?.topology ?? null;
      for (const mesh of children as Mesh[]) mesh.geometry.dispose();
      this.group.clear();
      for (const clip of clips) {
        const mesh = new Mesh(wireOf(shapeOf(clip, surface)), this.titanium);
        mesh.matrixAutoUpdate = false;
        this.group.add(mesh);
      }
    }
    clips.forEach((clip, i) => {
      const place: Matrix4 = children[i].matrix;
      place.makeBasis(...axesOf(clip)).setPosition(...clip.position_m);
      children[i].matrixWorldNeedsUpdate = true;
    });
  }
}
