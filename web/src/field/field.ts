/** What an operation leaves behind on what is shown. Made from snapshots alone and in the time of the simulation: nothing of it changes a step. */
import { Vector3 } from "three";
import type { Organ } from "../organ";
import type { Hello, SnapshotHeader } from "../protocol";
import { Burns, hotTools } from "./burns";

/** Who jumps further than this in a recording has not seen what was left in between [s]. */
const JUMP_S = 1;

export class OperatingField {
  readonly burns = new Burns();
  private hello: Hello | null = null;
  private time_s: number | null = null;

  begin(hello: Hello): void {
    this.hello = hello;
    this.clear();
  }

  private clear(): void {
    this.burns.clear();
    this.time_s = null;
  }

  /** A new surface of the organ takes over what is burnt. */
  adopt(organ: Organ): void {
    if (this.burns.all.length > 0) organ.burn((rest_m, offset) => this.burns.at(rest_m, offset));
  }

  /** A snapshot of the organ is shown; answers whether there is something new to see. */
  take(header: SnapshotHeader, organ: Organ): boolean {
    const dt_s = this.time_s === null ? 0 : header.time_s - this.time_s;
    if (dt_s < 0 || dt_s > JUMP_S) {
      this.clear();
      organ.burn(() => 0);
    }
    this.time_s = header.time_s;
    if (this.hello === null || !(dt_s > 0 && dt_s <= JUMP_S)) return dt_s !== 0;
    return this.heat(header, organ, this.hello, dt_s);
  }

  private heat(header: SnapshotHeader, organ: Organ, hello: Hello, dt_s: number): boolean {
    const { positions_m, topology: { rest_m, triangles } } = organ;
    let isNew = false;
    for (const tool of hotTools(header, hello)) {
      const { contact, contactPoint_m, tip_m } = header.tools[tool];
      isNew = this.burns.heat(new Vector3(...(contact ? contactPoint_m : tip_m)), hello.tools[tool].tip_radius_m, dt_s, { positions_m, rest_m, triangles }) || isNew;
    }
    if (isNew) organ.burn((rest, offset) => this.burns.at(rest, offset));
    return isNew;
  }
}
