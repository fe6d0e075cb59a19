import { describe, expect, it } from "vitest";
import { PAD_DEAD_ZONE, PAD_SPEED_M_PER_S, readPad, stick, type PadState } from "../src/gamepad";

const REST: PadState = { axes: [0.05, -0.1, 0, 0.02], pressed: [] };

describe("gamepad", () => {
  it("does nothing at rest and moves with its sticks", () => {
    expect(readPad(REST, REST, 0.016)).toEqual({ motion_m: [0, 0, 0], actions: [] });
    const { motion_m } = readPad({ axes: [1, 1, 0, -1], pressed: [] }, REST, 0.1);
    const reach_m = PAD_SPEED_M_PER_S * 0.1;
    expect(motion_m).toEqual([reach_m, -reach_m, reach_m]);
  });

  it("sticks begin softly and end at one, whatever a broken one says", () => {
    expect([0, PAD_DEAD_ZONE, -PAD_DEAD_ZONE, Number.NaN].map(stick)).toEqual([0, 0, 0, 0]);
    expect(stick(0.5)).toBeLessThan(0.25);
    expect([stick(1), stick(-1), stick(7)]).toEqual([1, -1, 1]);
  });

  it("acts once when a button goes down, not when it was down from the start", () => {
    const down: PadState = { axes: [], pressed: [true, false, true] };
    expect(readPad(down, REST, 0.016).actions).toEqual(["trigger", "cut"]);
    expect(readPad(down, down, 0.016).actions).toEqual([]);
    expect(readPad(down, null, 0.016).actions).toEqual([]);
  });
});
