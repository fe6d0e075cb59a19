/**
 * Organs around those of the scene, seen through the endoscope alone: shapes of low detail that nothing touches, and that say nothing
 * about the patient. A bed of fat behind, colon at the feet's side, stomach at the left, a liver towards the head of small scenes, and
 * before the liver the falciform ligament.
 * What the scene has among its bodies is not drawn twice, and what would stand in an instrument's way is left out.
 */
import { Box3, CatmullRomCurve3, Group, Mesh, Vector3, type ShaderMaterial } from "three";
import { isFullDetail } from "../detail";
import { latticeValue, valueNoise } from "../noise";
import type { Ray } from "../drag";
import type { Hello, Topology } from "../protocol";
import { tissueGeometry } from "../tissue/geometry";
import { lookOf } from "../tissue/looks";
import { falciform, type LiverSurface } from "./ligament";
import { abdomenOf } from "./walls";

/** What is behind organs is drawn after them, so that what they hide costs nothing. */
const AFTER_ORGANS = 2;
/** The bed lies so far below the scene's lowest place [m], and is so large to either side. */
const BED_BELOW_M = 0.006;
const BED_HALF_M = 0.17;
/** Blood looks for a hollow in steps of a share of that, so many at most. */
const GATHER_SHARE = 0.01;
const GATHER_STEPS = 30;
/** Scenes of which no side is longer lie before a made-up liver [m]. */
const SMALL_M = 0.12;
/** Where a patient lies on the back, things fall to it. */
const BACK = new Vector3(0, 1, 0);

/** Where blood and organs fall to: along gravity, to the back where the scene has none. */
export function downOf({ scene }: Pick<Hello, "scene">): Vector3 {
  const gravity = new Vector3(...scene.gravity_m_per_s2);
  return gravity.lengthSq() > 0 ? gravity.normalize() : BACK.clone();
}

/** How far along a direction the bed is, from the origin [m]. */
export function bedDepth_m({ bounds }: Pick<Hello, "bounds">, down: Vector3): number {
  const corners = [bounds.min_m, bounds.max_m];
  const [x, y, z] = [0, 1, 2].map((k) => Math.max(corners[0][k] * down.getComponent(k), corners[1][k] * down.getComponent(k)));
  return x + y + z + BED_BELOW_M;
}

/** A grid of points as a surface: `rows` of `columns`, closed around where `isRound`. */
interface Grid {
  readonly rows: number;
  readonly columns: number;
  readonly isRound: boolean;
  readonly at: (row: number, column: number) => Vector3;
}

function surfaceOf({ rows, columns, isRound, at }: Grid): { rest_m: Float32Array; triangles: Uint32Array } {
  const rest_m = new Float32Array(3 * rows * columns);
  const triangles: number[] = [];
  for (let i = 0; i < rows; i++) {
    for (let j = 0; j < columns; j++) {
      at(i, j).toArray(rest_m, 3 * (i * columns + j));
      if (i === rows - 1 || (j === columns - 1 && !isRound)) continue;
      const [a, b] = [i * columns + j, i * columns + ((j + 1) % columns)];
      triangles.push(a, b, a + columns, b, b + columns, a + columns);
    }
  }
  return { rest_m, triangles: Uint32Array.from(triangles) };
}

/** A hollow organ along a curve, of a radius at each share of it; `haustra` bulges. */
function tube(places: readonly Vector3[], radius_m: (share: number) => number, haustra = 0): ReturnType<typeof surfaceOf> {
  const curve = new CatmullRomCurve3([...places]);
  const [rows, columns] = isFullDetail() ? [56, 22] : [26, 12];
  const frames = curve.computeFrenetFrames(rows - 1, false);
  return surfaceOf({
    rows,
    columns,
    isRound: true,
    at: (i, j) => {
      const share = i / (rows - 1);
      const turn = (2 * Math.PI * j) / columns;
      const bulge = haustra > 0 ? 1 - 0.2 * Math.abs(Math.cos(Math.PI * haustra * share)) ** 6 - 0.05 * (1 + Math.cos(3 * turn)) : 1;
      // Round ends.
      const closing = Math.sqrt(Math.max(0, 1 - Math.max(0, Math.abs(2 * share - 1) - 0.88) ** 2 / 0.0144));
      const wobble = 1 + 0.1 * (valueNoise(9 * share, 1.5 * Math.cos(turn) + 4, 1.5 * Math.sin(turn) + 4) - 0.5);
      const radius = radius_m(share) * bulge * closing * wobble;
      return curve.getPointAt(share).addScaledVector(frames.normals[i], radius * Math.cos(turn)).addScaledVector(frames.binormals[i], radius * Math.sin(turn));
    },
  });
}

/** The ground as a bed of lumps: its axes, its middle, and how far its surface is above the flat ground at shares of its half width. */
class Bed {
  readonly down: Vector3;
  readonly across: Vector3;
  readonly ahead: Vector3;
  readonly middle: Vector3;

  constructor(hello: Hello) {
    this.down = downOf(hello);
    this.across = new Vector3(1, 0, 0).addScaledVector(this.down, -this.down.x);
    // Where things fall sideways, any axis across does.
    if (this.across.lengthSq() < 1e-6) this.across.set(0, 1, 0);
    this.across.normalize();
    this.ahead = this.down.clone().cross(this.across);
    this.middle = new Vector3(...hello.bounds.min_m).add(new Vector3(...hello.bounds.max_m)).multiplyScalar(0.5);
    this.middle.addScaledVector(this.down, bedDepth_m(hello, this.down) - this.middle.dot(this.down));
  }

  height_m(u: number, v: number): number {
    const lump = (size: number, seed: number): number => valueNoise(size * u + seed, size * v + seed, seed);
    // Higher towards the sides, as loops of bowel lie there.
    const height = 0.022 * (lump(5, 40) - 0.62) + 0.012 * (lump(11, 50) - 0.5) + 0.004 * (lump(27, 60) - 0.5) + 0.075 * (u * u + v * v) ** 1.5;
    return Math.min(height, 0.06);
  }

  at(u: number, v: number): Vector3 {
    return this.middle.clone().addScaledVector(this.across, BED_HALF_M * u).addScaledVector(this.ahead, BED_HALF_M * v).addScaledVector(this.down, -this.height_m(u, v));
  }

  surface(): ReturnType<typeof surfaceOf> {
    const n = isFullDetail() ? 61 : 27;
    const share = (i: number): number => (2 * i) / (n - 1) - 1;
    return surfaceOf({ rows: n, columns: n, isRound: false, at: (i, j) => this.at(share(i), share(j)) });
  }
}

/** Where blood gathers that falls from a place: it runs down the bed below to the next hollow. */
export function groundBelow(hello: Hello): (from_m: Vector3) => Vector3 {
  const bed = new Bed(hello);
  return (from_m) => {
    const way = from_m.clone().sub(bed.middle);
    let [u, v] = [way.dot(bed.across), way.dot(bed.ahead)].map((x) => Math.min(1, Math.max(-1, x / BED_HALF_M)));
    for (let i = 0; i < GATHER_STEPS; i++) {
      const around = [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]].map(([a, b]) => [u + a * GATHER_SHARE, v + b * GATHER_SHARE] as const);
      const [lowest] = around.sort((a, b) => bed.height_m(...a) - bed.height_m(...b));
      if (lowest[0] === u && lowest[1] === v) break;
      [u, v] = lowest;
    }
    return bed.at(u, v);
  };
}

interface Piece {
  /** Words that a body of the scene may have in its name. */
  readonly names: RegExp;
  readonly look: string;
  readonly surface: ReturnType<typeof surfaceOf>;
}

const LIVER = /liver|foie/;
/** What is in a liver is none. */
const IN_LIVER = /tumou?r|metasta|nodule/;

function isSmall({ bounds: { min_m, max_m } }: Pick<Hello, "bounds">): boolean {
  return max_m.every((most, k) => most - min_m[k] < SMALL_M);
}

/** The surface of a scene's own liver, where that is one of usual size. */
function liverOf(hello: Hello, { rest_m, triangles, bodyOf }: SceneSurface): LiverSurface | null {
  const number = hello.bodies.findIndex(({ name, is_rigid }) => !is_rigid && LIVER.test(name.toLowerCase()) && !IN_LIVER.test(name.toLowerCase()));
  const isLiver = hello.bodies.length > 0 ? number >= 0 : LIVER.test(hello.scene.material.toLowerCase());
  if (!isLiver || isSmall(hello)) return null;
  const isOfIt = (_: number, i: number): boolean => bodyOf[triangles[3 * Math.floor(i / 3)]] === Math.max(number, 0);
  return { rest_m, triangles: triangles.filter(isOfIt) };
}

function piecesOf(hello: Hello): Piece[] {
  const down = downOf(hello);
  const box = new Box3(new Vector3(...hello.bounds.min_m), new Vector3(...hello.bounds.max_m));
  const middle = box.getCenter(new Vector3());
  const onBed = (x: number, z: number, above_m: number): Vector3 => {
    const at = new Vector3(x, middle.y, z);
    return at.addScaledVector(down, bedDepth_m(hello, down) - at.dot(down) - above_m);
  };
  const [left, feet, head] = [box.max.x, box.min.z, box.max.z];
  const colonAt = feet - 0.042;
  const pieces: Piece[] = [
    { names: /fat|oment|mesent/, look: "fat", surface: new Bed(hello).surface() },
    {
      names: /colon|bowel|intestin/,
      look: "colon",
      surface: tube([-0.17, -0.09, -0.02, 0.06, 0.12, 0.18].map((x, i) => onBed(middle.x + x, colonAt + 0.022 * Math.sin(1.7 * i + 0.6), 0.012 + 0.008 * latticeValue(i, 3, 5))), () => 0.024, 11),
    },
    {
      names: /stomach|estomac/,
      look: "stomach",
      surface: tube([[0.075, 0.06, 0.03], [0.07, 0.02, 0.034], [0.055, -0.02, 0.03], [0.02, -0.045, 0.022], [-0.02, -0.05, 0.018]].map(([x, z, above]) => onBed(Math.max(left, middle.x + 0.03) + x, middle.z + z, above)), (share) => 0.04 - 0.022 * share),
    },
  ];
  if (isSmall(hello)) {
    pieces.push({
      names: LIVER,
      look: "liver",
      surface: tube([[-0.13, 0.075, 0.05], [-0.07, 0.066, 0.06], [0, 0.072, 0.06], [0.07, 0.085, 0.05], [0.12, 0.095, 0.045]].map(([x, z, above]) => onBed(middle.x + x, head + z, above)), (share) => 0.058 - 0.026 * share),
    });
  }
  return pieces;
}

/** Where instruments are at the start, and on their way to their trocars. */
function waysOf({ tools }: Hello): Vector3[] {
  return tools.flatMap(({ home_tip_m, home_shaft }) =>
    [0, 0.04, 0.08].map((back_m) => new Vector3(...home_tip_m).addScaledVector(new Vector3(...home_shaft).normalize(), back_m)));
}

/** What endoscopes look at at the start: places between them and the scene's middle, and the tips of the others. */
function sightsOf({ tools, bounds: { min_m, max_m } }: Hello): Vector3[] {
  const shares = Array.from({ length: 21 }, (_, i) => i / 20);
  const middle = new Vector3(...min_m).add(new Vector3(...max_m)).multiplyScalar(0.5);
  const seen = [middle, ...tools.map(({ home_tip_m }) => new Vector3(...home_tip_m))];
  return tools.filter(({ optics }) => optics !== null)
    .flatMap(({ home_tip_m }) => seen.flatMap((to) => shares.map((share) => new Vector3(...home_tip_m).lerp(to, share))));
}

/** What scenery knows of the bodies of a scene. */
export type SceneSurface = Pick<Topology, "rest_m" | "triangles" | "bodyOf">;

export class Scenery {
  readonly group = new Group();
  private readonly down = BACK.clone();
  private depth_m = 0;
  private hello: Hello | null = null;
  private isFull = false;
  /** The made-up liver, where there is one. */
  private liver: LiverSurface | null = null;
  private ligament: Mesh | null = null;
  private hasLookedForLiver = false;

  constructor(private readonly material: ShaderMaterial) {
    this.group.visible = false;
  }

  begin(hello: Hello): void {
    this.hello = hello;
    this.isFull = isFullDetail();
    this.liver = null;
    this.ligament = null;
    this.hasLookedForLiver = false;
    for (const part of this.group.children) (part as Mesh).geometry.dispose();
    this.group.clear();
    this.down.copy(downOf(hello));
    this.depth_m = bedDepth_m(hello, this.down);
    const ways = waysOf(hello);
    const named = hello.bodies.map(({ name }) => name.toLowerCase());
    for (const { names, look, surface } of piecesOf(hello)) {
      if (named.some((name) => names.test(name))) continue;
      // The bed is below all instruments.
      const part = this.add(surface, look, look === "fat" ? [] : ways);
      if (part !== null && names === LIVER) this.liver = surface;
    }
  }

  /** Adds a piece, unless a place is in its box. */
  private add(surface: ReturnType<typeof surfaceOf>, look: string, keptFree: readonly Vector3[]): Mesh | null {
    const geometry = tissueGeometry({ ...surface, lookAt: () => lookOf(look) });
    geometry.computeBoundingBox();
    if (keptFree.some((place) => geometry.boundingBox!.containsPoint(place))) {
      geometry.dispose();
      return null;
    }
    const part = new Mesh(geometry, this.material);
    part.renderOrder = AFTER_ORGANS;
    this.group.add(part);
    return part;
  }

  /** Shows it, as fine as all is drawn now, around the bodies of the scene, which may not be known yet. */
  show(shown: boolean, bodies: SceneSurface | null): void {
    const { hello } = this;
    if (shown && hello !== null && this.isFull !== isFullDetail()) this.begin(hello);
    if (shown && hello !== null && bodies !== null && !this.hasLookedForLiver) {
      this.hasLookedForLiver = true;
      const liver = this.liver ?? liverOf(hello, bodies);
      const sheet = liver && falciform(liver, abdomenOf(hello));
      if (sheet !== null) this.ligament = this.add(surfaceOf({ ...sheet, isRound: true }), "falciform ligament", [...waysOf(hello), ...sightsOf(hello)]);
    }
    this.group.visible = shown;
  }

  /** Whether the falciform ligament is there. */
  get showsLigament(): boolean {
    return this.ligament !== null;
  }

  /** How far along a ray the ground is, which is taken for flat; not finite where the ray does not go there. */
  distance_m({ origin, direction }: Ray): number {
    const ahead = direction.dot(this.down);
    return ahead > 0.1 ? (this.depth_m - origin.dot(this.down)) / ahead : Infinity;
  }
}
