/**
 * Where hot instruments were on the tissue, at rest: made from what snapshots tell (an instrument that burns, switched on, where it
 * touches or what it holds), because they do not tell what is burnt. Places go with the tissue; an undone cut leaves them.
 */
import { Vector3 } from "three";
import type { Hello, SnapshotHeader } from "../protocol";
import { nearestOnSurface, placeIn } from "../on_surface";

/** Contact for so long chars tissue [s]: a choice. */
const CHARS_IN_S = 0.35;
/** Tissue is burnt so far beyond the tip [m]: a choice, near to what monopolar hooks leave. */
const SPREAD_M = 2.5e-3;
/** Burns nearer than this share of their size are one. */
const ONE = 0.4;
const MOST_BURNS = 256;
/** Kinds of instruments that burn. */
const HOT: ReadonlySet<string> = new Set(["hook", "cautery"]);

export interface Burn {
  readonly rest_m: Vector3;
  readonly radius_m: number;
  amount: number;
}

/** The instruments that are switched on and burn what they touch or hold. */
export function hotTools(header: SnapshotHeader, { tools }: Pick<Hello, "tools">): number[] {
  return header.tools.flatMap(({ trigger, contact, grasps }, i) =>
    HOT.has(tools[i]?.kind ?? "") && trigger > 0.5 && (contact || grasps) ? [i] : []);
}

export class Burns {
  private readonly burns: Burn[] = [];

  get all(): readonly Burn[] {
    return this.burns;
  }

  clear(): void {
    this.burns.length = 0;
  }

  /** A hot tip was at a place of the deformed surface for some time; answers whether that changed anything. */
  heat(at_m: Vector3, tipRadius_m: number, dt_s: number, surface: { readonly positions_m: Float32Array; readonly rest_m: Float32Array; readonly triangles: Uint32Array }): boolean {
    const place = nearestOnSurface(at_m, surface.positions_m, surface.triangles);
    if (place === null || dt_s <= 0) return false;
    const rest_m = placeIn(surface.rest_m, place, new Vector3());
    const radius_m = tipRadius_m + SPREAD_M;
    let burn = this.burns.find((known) => known.rest_m.distanceTo(rest_m) < ONE * radius_m);
    if (burn === undefined) {
      burn = { rest_m, radius_m, amount: 0 };
      this.burns.push(burn);
      if (this.burns.length > MOST_BURNS) this.burns.shift();
    }
    const before = burn.amount;
    burn.amount = Math.min(1, before + dt_s / CHARS_IN_S);
    return burn.amount !== before;
  }

  /** How much a place at rest is burnt, 0 to 1. */
  at(rest_m: ArrayLike<number>, offset = 0): number {
    let most = 0;
    for (const { rest_m: place, radius_m, amount } of this.burns) {
      const away = Math.hypot(rest_m[offset] - place.x, rest_m[offset + 1] - place.y, rest_m[offset + 2] - place.z) / radius_m;
      if (away < 1) most = Math.max(most, amount * Math.min(1, 1.6 * (1 - away)));
    }
    return most;
  }
}
