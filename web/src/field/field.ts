/**
 * What an operation leaves behind on what is shown: burns, blood, smoke. Made from snapshots alone and in the time of the simulation;
 * nothing of it changes a step.
 */
import { Group, Vector3, type ShaderMaterial } from "three";
import type { Organ } from "../organ";
import type { Hello, SnapshotHeader } from "../protocol";
import { downOf, groundBelow } from "../theatre/scenery";
import { setBurns } from "../tissue/material";
import { BloodFlow } from "./blood_flow";
import { BloodView } from "./blood_view";
import { Burns, hotTools } from "./burns";
import { Smoke } from "./smoke";
import { washingOf, type Washing } from "./suction";

/** Who jumps further than this in a recording has not seen what was left in between [s]. */
const JUMP_S = 1;

export class OperatingField {
  readonly group = new Group();
  private readonly burns = new Burns();
  private readonly smoke = new Smoke();
  private readonly blood = new BloodView();
  private flow: BloodFlow | null = null;
  private hello: Hello | null = null;
  private down = new Vector3();
  private time_s: number | null = null;
  private oddResets = false;

  /** Burns of the first organ show in the material of tissue. */
  constructor(private readonly tissue: ShaderMaterial) {
    this.group.add(this.blood.group, this.smoke.points);
  }

  begin(hello: Hello): void {
    this.hello = hello;
    this.down = downOf(hello);
    this.clear();
  }

  private clear(): void {
    this.burns.clear();
    this.smoke.clear();
    this.flow = this.hello && new BloodFlow(this.down, groundBelow(this.hello));
    this.blood.show(null, new Float32Array(), this.down);
    this.time_s = null;
  }

  /** A new surface of the organ takes over what is burnt. */
  adopt(organ: Organ): void {
    setBurns(this.tissue, this.burns.all);
    organ.burn((rest_m, offset) => this.burns.at(rest_m, offset));
  }

  /** What lies on scenery is shown with it. */
  showGround(shown: boolean): void {
    this.blood.showGround(shown);
  }

  /** A snapshot of the organ is shown; answers whether there is something new to see. */
  take(header: SnapshotHeader, organ: Organ): boolean {
    const dt_s = this.time_s === null ? 0 : header.time_s - this.time_s;
    const jumps = dt_s < 0 || dt_s > JUMP_S || header.oddResets !== this.oddResets;
    if (jumps) {
      this.clear();
      this.adopt(organ);
    }
    this.time_s = header.time_s;
    this.oddResets = header.oddResets;
    if (this.hello === null || !(dt_s > 0) || jumps) return jumps;
    const hot = hotTools(header, this.hello).map((tool) => {
      const { contact, contactPoint_m, tip_m } = header.tools[tool];
      return { at_m: new Vector3(...(contact ? contactPoint_m : tip_m)), radius_m: this.hello!.tools[tool].tip_radius_m };
    });
    const washing = washingOf(header, this.hello);
    const isNew = [this.heat(hot, organ, dt_s), this.bleed(header, organ, dt_s, washing), this.smoke.count > 0 || hot.length > 0];
    this.smoke.advance(dt_s, hot.map(({ at_m }) => at_m), this.down, washing.sucked_m);
    return isNew.includes(true);
  }

  private heat(hot: ReadonlyArray<{ readonly at_m: Vector3; readonly radius_m: number }>, organ: Organ, dt_s: number): boolean {
    const { positions_m, topology: { rest_m, triangles } } = organ;
    let isNew = false;
    for (const { at_m, radius_m } of hot) isNew = this.burns.heat(at_m, radius_m, dt_s, { positions_m, rest_m, triangles }) || isNew;
    if (isNew) this.adopt(organ);
    return isNew;
  }

  private bleed({ bleeding }: SnapshotHeader, organ: Organ, dt_s: number, washing: Washing): boolean {
    const { flow } = this;
    if (flow === null || bleeding === null) return false;
    flow.advance(dt_s, bleeding.ends, organ, washing);
    if (flow.isMoving || flow.drops.length > 0 || flow.puddles.length > 0) this.blood.show(flow, organ.positions_m, this.down);
    return flow.isMoving;
  }

  /** What tests read. */
  report(): { readonly drops: number; readonly puddles: number; readonly puffs: number; readonly burns: number } {
    return { drops: this.flow?.drops.length ?? 0, puddles: this.flow?.puddles.length ?? 0, puffs: this.smoke.count, burns: this.burns.all.length };
  }
}
