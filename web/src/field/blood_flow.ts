/**
 * Blood on the surface of an organ, for the eye alone: drops come out where vessels are open, as much as the simulation says, run
 * down the surface as gravity goes, leave a film behind, lie where it goes no further down, and fall where it hangs over; what falls
 * makes puddles below. Suction takes it away, and rinsing washes it off. A film of thickness h on a slope of angle a runs with W. Nusselt's speed, rho g h^2 sin(a) / (3 mu).
 * Time goes in ticks of the simulation's time. Numbers of drops and puddles are bounded.
 */
import { Vector3 } from "three";
import type { BleedingEnd } from "../blood";
import type { Topology } from "../protocol";
import { NO_WASHING } from "./suction";
import { nearestOf, nearestOnSurface, placeIn, type OnSurface } from "../on_surface";

export const TICK_S = 0.02;
/** Density [kg/m3], viscosity [Pa s] of whole blood at 37 degrees, and how thick it runs [m], a choice. */
const RHO = 1060;
const MU = 3.5e-3;
const FILM_M = 0.3e-3;
const NUSSELT_PER_S2 = (RHO * FILM_M * FILM_M) / (3 * MU);
const G = 9.81;
/** Drops that come out one after the other: at least so large, at most so many a second, and no larger than that [m3, 1/s]. */
const LEAST_DROP_M3 = 6e-9;
const DROPS_PER_S = 6;
const MOST_DROP_M3 = 50e-9;
/** A running drop leaves so much behind, so far apart. */
const STAIN_M3 = 0.5e-9;
const STAIN_EVERY_M = 1.6e-3;
/** Surfaces whose normal is so much along gravity let drops fall. */
const HANGS_OVER = 0.6;
/** And so large a drop falls there [m3]. */
const FALLS_M3 = 25e-9;
/** It lies where it comes no further down than this share of what the slope lets expect, or than that in a tick [m]. */
const LIES = 0.2;
const LEAST_DESCENT_M = 2e-6;
const MOST_DROPS = 420;
const MOST_PUDDLES = 8;
/** Puddles whose middles are nearer are one [m]. */
const ONE_PUDDLE_M = 0.03;
/** How deep blood stands in a puddle [m]; no puddle is shown larger than that [m]. */
export const PUDDLE_DEPTH_M = 2e-3;
const MOST_PUDDLE_RADIUS_M = 0.07;
/** What suction takes in, and what rinsing washes down [m3/s], and how near it has to be [m]: choices. */
const SUCKS_M3_PER_S = 25e-6;
const RINSES_M3_PER_S = 2e-6;
const SUCKED_M = 8e-3;
const RINSED_M = 10e-3;
/** Ends nearer than this are the same from one snapshot to the next [m]. */
const SAME_END_M = 0.006;

export interface Drop {
  place: OnSurface;
  volume_m3: number;
  /** Where it runs; null where it lies. */
  way: Vector3 | null;
  sinceStain_m: number;
}

export interface Puddle {
  readonly middle_m: Vector3;
  volume_m3: number;
}

interface Source {
  at_m: Vector3;
  rate_m3_per_s: number;
  waiting_m3: number;
  place: OnSurface | null;
}

/** Radius of what a drop of a volume covers: a cap less than half as high as it is wide. */
export function dropRadius_m(volume_m3: number): number {
  return Math.cbrt(volume_m3 / 0.55);
}

export function puddleRadius_m({ volume_m3 }: Pick<Puddle, "volume_m3">): number {
  return Math.min(Math.sqrt(volume_m3 / (Math.PI * PUDDLE_DEPTH_M)), MOST_PUDDLE_RADIUS_M);
}

/** The surface that blood is on. */
export interface BloodySurface {
  readonly positions_m: Float32Array;
  readonly topology: Pick<Topology, "triangles" | "nodeIds">;
}

export class BloodFlow {
  readonly drops: Drop[] = [];
  readonly puddles: Puddle[] = [];
  private sources: Source[] = [];
  private topology: BloodySurface["topology"] | null = null;
  /** Triangles at each vertex, and around triangles that a drop was on; made when they are asked for. */
  private corners: number[][] | null = null;
  private readonly around = new Map<number, readonly number[]>();
  private owed_s = 0;
  /** Some was taken away, or washed down, since the last snapshot. */
  private isWashed = false;
  private washing = NO_WASHING;

  /** Unit vector to where things fall, and where on the ground blood gathers that falls from a place. */
  constructor(private readonly down: Vector3, private readonly groundBelow: (from_m: Vector3) => Vector3) {}

  /** Something runs, comes out, or is washed away. */
  get isMoving(): boolean {
    return this.isWashed || this.sources.length > 0 || this.drops.some(({ way }) => way !== null);
  }

  /** So much time has gone by in the simulation. */
  advance(dt_s: number, ends: readonly BleedingEnd[], surface: BloodySurface, washing = NO_WASHING): void {
    this.adopt(surface);
    this.find(ends, surface);
    this.owed_s += dt_s;
    this.isWashed = false;
    this.washing = washing;
    for (; this.owed_s >= TICK_S; this.owed_s -= TICK_S) this.tick(surface);
  }

  /** On a new surface, drops stay where their triangle still is. */
  private adopt({ topology }: BloodySurface): void {
    if (this.topology === topology) return;
    this.corners = null;
    this.around.clear();
    const { triangles } = topology;
    const nameOf = (of: BloodySurface["topology"], t: number): string => [0, 1, 2].map((k) => of.nodeIds[of.triangles[3 * t + k]]).join(" ");
    if (this.topology !== null && this.drops.length > 0) {
      const before = this.topology;
      const here = new Map(Array.from({ length: triangles.length / 3 }, (_, t) => [nameOf(topology, t), t]));
      for (const drop of this.drops.splice(0)) {
        const triangle = here.get(nameOf(before, drop.place.triangle));
        if (triangle === undefined) continue;
        const vertices = [triangles[3 * triangle], triangles[3 * triangle + 1], triangles[3 * triangle + 2]] as const;
        this.drops.push({ ...drop, place: { ...drop.place, triangle, vertices } });
      }
    }
    this.topology = topology;
    for (const source of this.sources) source.place = null;
  }

  /** The triangles around one that share a corner with it, or with one that does. */
  private near(triangle: number): readonly number[] {
    const known = this.around.get(triangle);
    if (known !== undefined) return known;
    const { triangles, nodeIds } = this.topology!;
    if (this.corners === null) {
      this.corners = Array.from({ length: nodeIds.length }, (): number[] => []);
      for (let i = 0; i < triangles.length; i++) this.corners[triangles[i]].push(Math.floor(i / 3));
    }
    const at = this.corners;
    const beside = (t: number): number[] => [0, 1, 2].flatMap((k) => at[triangles[3 * t + k]]);
    const once = [...new Set([...new Set(beside(triangle))].flatMap(beside))];
    this.around.set(triangle, once);
    return once;
  }

  /** The open ends of now, each with what it was before. */
  private find(ends: readonly BleedingEnd[], { positions_m, topology }: BloodySurface): void {
    this.sources = ends.filter(({ rate_m3_per_s }) => rate_m3_per_s > 0).map(({ position_m, rate_m3_per_s }) => {
      const at_m = new Vector3(...position_m);
      const known = this.sources.find((source) => source.at_m.distanceTo(at_m) < SAME_END_M);
      const place = known?.place ?? nearestOnSurface(at_m, positions_m, topology.triangles);
      return { at_m, rate_m3_per_s, waiting_m3: known?.waiting_m3 ?? 0, place };
    });
  }

  private tick(surface: BloodySurface): void {
    for (const source of this.sources) this.bleed(source, surface);
    for (const drop of [...this.drops]) if (drop.way !== null) this.run(drop, surface);
    for (const at_m of this.washing.rinsed_m) {
      const washed_m3 = this.take(at_m, RINSED_M, RINSES_M3_PER_S * TICK_S, surface);
      if (washed_m3 > 0) this.fall(at_m, washed_m3);
    }
    for (const at_m of this.washing.sucked_m) {
      const most_m3 = SUCKS_M3_PER_S * TICK_S;
      this.drain(at_m, most_m3 - this.take(at_m, SUCKED_M, most_m3, surface));
    }
    // The oldest stains dry away.
    if (this.drops.length > MOST_DROPS) this.drops.splice(0, this.drops.length - MOST_DROPS);
  }

  private bleed(source: Source, { positions_m }: BloodySurface): void {
    source.waiting_m3 += source.rate_m3_per_s * TICK_S;
    const whole_m3 = Math.max(LEAST_DROP_M3, source.rate_m3_per_s / DROPS_PER_S);
    if (source.waiting_m3 < whole_m3 || source.place === null) return;
    source.waiting_m3 -= whole_m3;
    const volume_m3 = Math.min(whole_m3, MOST_DROP_M3);
    this.drops.push({ place: source.place, volume_m3, way: new Vector3(), sinceStain_m: 0 });
    // What is more than drops can show falls at once.
    if (whole_m3 > volume_m3) this.fall(placeIn(positions_m, source.place, new Vector3()), whole_m3 - volume_m3);
  }

  private run(drop: Drop, { positions_m, topology: { triangles } }: BloodySurface): void {
    const at = placeIn(positions_m, drop.place, new Vector3());
    const normal = normalOf(positions_m, drop.place);
    const slope = this.down.clone().addScaledVector(normal, -normal.dot(this.down));
    if (normal.dot(this.down) > HANGS_OVER && drop.volume_m3 > FALLS_M3) {
      return this.drip(drop, at);
    }
    const reach = slope.multiplyScalar(NUSSELT_PER_S2 * G * TICK_S);
    const next = nearestOf(at.clone().add(reach), positions_m, triangles, this.near(drop.place.triangle));
    if (next === null) return this.lie(drop, positions_m);
    const way = placeIn(positions_m, next, new Vector3()).sub(at);
    const way_m = way.length();
    if (way.dot(this.down) < Math.max(LIES * reach.dot(this.down), LEAST_DESCENT_M)) return this.lie(drop, positions_m);
    drop.place = next;
    drop.way = way.divideScalar(way_m);
    drop.sinceStain_m += way_m;
    if (drop.sinceStain_m < STAIN_EVERY_M) return;
    drop.sinceStain_m = 0;
    drop.volume_m3 -= STAIN_M3;
    // Behind those that run, so that the oldest go first.
    if (drop.volume_m3 > STAIN_M3) this.drops.unshift({ place: next, volume_m3: STAIN_M3, way: null, sinceStain_m: 0 });
    else drop.way = null;
  }

  /** Where it lies it flows into what lies there; what is too much falls. */
  private lie(drop: Drop, positions_m: Float32Array): void {
    drop.way = null;
    const at = placeIn(positions_m, drop.place, new Vector3());
    const other = this.drops.find((known) => known !== drop && known.way === null && known.volume_m3 > STAIN_M3
      && placeIn(positions_m, known.place, new Vector3()).distanceTo(at) < dropRadius_m(known.volume_m3));
    if (other === undefined) {
      // It hangs from below until it is large enough.
      if (normalOf(positions_m, drop.place).dot(this.down) > HANGS_OVER && drop.volume_m3 > FALLS_M3) this.drip(drop, at);
      return;
    }
    this.drops.splice(this.drops.indexOf(drop), 1);
    other.volume_m3 += drop.volume_m3;
    if (normalOf(positions_m, other.place).dot(this.down) > HANGS_OVER && other.volume_m3 > FALLS_M3) return this.drip(other, at);
    if (other.volume_m3 <= MOST_DROP_M3) return;
    this.fall(at, other.volume_m3 - MOST_DROP_M3);
    other.volume_m3 = MOST_DROP_M3;
  }

  /** Takes drops that are so near, the nearest first, and answers how much of the most that is asked for that was. */
  private take(at_m: Vector3, reach_m: number, most_m3: number, { positions_m }: BloodySurface): number {
    const near = this.drops.map((drop) => ({ drop, away_m: placeIn(positions_m, drop.place, new Vector3()).distanceTo(at_m) }))
      .filter(({ away_m }) => away_m < reach_m).sort((a, b) => a.away_m - b.away_m);
    let left_m3 = most_m3;
    for (const { drop } of near) {
      const taken_m3 = Math.min(drop.volume_m3, left_m3);
      drop.volume_m3 -= taken_m3;
      left_m3 -= taken_m3;
      if (drop.volume_m3 <= 0) this.drops.splice(this.drops.indexOf(drop), 1);
      if (left_m3 <= 0) break;
    }
    this.isWashed ||= near.length > 0;
    return most_m3 - left_m3;
  }

  /** Takes from the puddles that a place is in, or beside. */
  private drain(at_m: Vector3, most_m3: number): void {
    let left_m3 = most_m3;
    for (const puddle of [...this.puddles]) {
      const way = at_m.clone().sub(puddle.middle_m);
      const above_m = way.dot(this.down);
      if (Math.abs(above_m) > SUCKED_M || way.addScaledVector(this.down, -above_m).length() > puddleRadius_m(puddle) + SUCKED_M) continue;
      const taken_m3 = Math.min(puddle.volume_m3, left_m3);
      puddle.volume_m3 -= taken_m3;
      left_m3 -= taken_m3;
      if (puddle.volume_m3 <= 0) this.puddles.splice(this.puddles.indexOf(puddle), 1);
      this.isWashed = true;
    }
  }

  private drip(drop: Drop, at: Vector3): void {
    this.drops.splice(this.drops.indexOf(drop), 1);
    this.fall(at, drop.volume_m3);
  }

  /** What falls where it is sucked does not come down. */
  private fall(from_m: Vector3, volume_m3: number): void {
    if (this.washing.sucked_m.some((at_m) => at_m.distanceTo(from_m) < SUCKED_M)) return;
    const middle_m = this.groundBelow(from_m);
    const near = this.puddles.find((puddle) => puddle.middle_m.distanceTo(middle_m) < ONE_PUDDLE_M + 0.5 * puddleRadius_m(puddle));
    if (near !== undefined) near.volume_m3 += volume_m3;
    else if (this.puddles.length < MOST_PUDDLES) this.puddles.push({ middle_m, volume_m3 });
    else this.puddles[MOST_PUDDLES - 1].volume_m3 += volume_m3;
  }
}

const [side, other] = [new Vector3(), new Vector3()];

/** Unit normal of a place's triangle, out of the organ. */
export function normalOf(positions_m: Float32Array, { vertices: [a, b, c] }: Pick<OnSurface, "vertices">): Vector3 {
  const corner = new Vector3().fromArray(positions_m, 3 * a);
  side.fromArray(positions_m, 3 * b).sub(corner);
  other.fromArray(positions_m, 3 * c).sub(corner);
  return side.cross(other).normalize().clone();
}
