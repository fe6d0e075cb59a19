import { describe, expect, it } from "vitest";
import { rumble, type Feel } from "../src/feel";
import { panelValues } from "../src/panel";
import { decodeText, ProtocolError } from "../src/protocol";
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

  it("shakes with what the hand feels that this page holds, and only then", () => {
    const feel = decodeText(
      JSON.stringify({
        type: "feel",
        greatest_force_n: 10,
        hands: [
          { tool: 1, force_n: [0, 0.6, 0.8], is_held: true },
          { tool: 2, force_n: [0, 9, 0], is_held: false },
          { tool: 3, force_n: [0, 9, 0], is_held: true },
        ],
      }),
    ) as Feel;
    expect([0, 1, 2, 3].map((tool) => rumble(feel, tool))).toEqual([0, 1 / 3, 0, 1]);
    expect(rumble(null, 0)).toBe(0);
    const shown = (tool: number) => panelValues(null, null, 0, 1, tool, { role: null, timing: null, feel }).hand_force;
    expect([0, 1, 2].map(shown)).toEqual(["–", "1.000 N", "let go"]);
    for (const bad of [{}, { hands: [{ tool: 0 }] }, { hands: [], greatest_force_n: "x" }, { hands: 3, greatest_force_n: 1 }]) {
      expect(() => decodeText(JSON.stringify({ type: "feel", greatest_force_n: 1, ...bad }))).toThrow(ProtocolError);
    }
  });

  it("acts once when a button goes down, not when it was down from the start", () => {
    const down: PadState = { axes: [], pressed: [true, false, true] };
    expect(readPad(down, REST, 0.016).actions).toEqual(["trigger", "cut"]);
    expect(readPad(down, down, 0.016).actions).toEqual([]);
    expect(readPad(down, null, 0.016).actions).toEqual([]);
  });
});
