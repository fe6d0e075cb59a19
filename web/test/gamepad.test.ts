import { describe, expect, it } from "vitest";
import { rumble, type Feel } from "../src/feel";
import { panelValues } from "../src/panel";
import { decodeText, ProtocolError } from "../src/protocol";
import { PadNames } from "../src/gamepad";
import { padsOf, pedalsOf, readPad, stick, USUAL_PAD, type PadState } from "../src/input_devices/mapping";

const REST: PadState = { axes: [0.05, -0.1, 0, 0.02], pressed: [] };

describe("gamepad", () => {
  it("does nothing at rest and moves with its sticks", () => {
    expect(readPad(REST, REST, 0.016, USUAL_PAD)).toEqual({ motion_m: [0, 0, 0], actions: [], roll_rad: 0 });
    const { motion_m } = readPad({ axes: [1, 1, 0, -1], pressed: [] }, REST, 0.1, USUAL_PAD);
    const reach_m = USUAL_PAD.speed_m_per_s * 0.1;
    expect(motion_m).toEqual([reach_m, -reach_m, reach_m]);
  });

  it("sticks begin softly and end at one, whatever a broken one says", () => {
    const { deadZone } = USUAL_PAD;
    expect([0, deadZone, -deadZone, Number.NaN].map((x) => stick(x, deadZone))).toEqual([0, 0, 0, 0]);
    expect(stick(0.5, deadZone)).toBeLessThan(0.25);
    expect([1, -1, 7].map((x) => stick(x, deadZone))).toEqual([1, -1, 1]);
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
    const shown = (tool: number) => panelValues(null, null, 0, 1, tool, { role: null, timing: null, feel, parameters: null }).hand_force;
    expect([0, 1, 2].map(shown)).toEqual(["–", "1.00 N", "let go"]);
    for (const bad of [{}, { hands: [{ tool: 0 }] }, { hands: [], greatest_force_n: "x" }, { hands: 3, greatest_force_n: 1 }]) {
      expect(() => decodeText(JSON.stringify({ type: "feel", greatest_force_n: 1, ...bad }))).toThrow(ProtocolError);
    }
  });

  it("acts once when a button goes down, not when it was down from the start", () => {
    const down: PadState = { axes: [], pressed: [true, false, true] };
    expect(readPad(down, REST, 0.016, USUAL_PAD).actions).toEqual(["trigger", "cut"]);
    expect(readPad(down, down, 0.016, USUAL_PAD).actions).toEqual([]);
    expect(readPad(down, null, 0.016, USUAL_PAD).actions).toEqual([]);
  });

  it("two of one model are mapped each by itself, to any instrument", () => {
    const names = new PadNames();
    const pads = ["pad", "other", "pad", "pad"].map((id, index) => ({ id, index }));
    expect(names.of(pads)).toEqual(["pad", "other", "pad (2)", "pad (3)"]);
    // One that goes takes no name from another; the next one gets what is free.
    expect(names.of(pads.slice(1))).toEqual(["other", "pad (2)", "pad (3)"]);
    expect(names.of([{ id: "pad", index: 9 }, ...pads.slice(1)])).toEqual(["pad", "other", "pad (2)", "pad (3)"]);
    const kept = padsOf({ pad: { ...USUAL_PAD, instrument: 4 }, "pad (2)": { ...USUAL_PAD, instrument: 5 } });
    expect(["pad", "pad (2)"].map((name) => kept[name].instrument)).toEqual([4, null]);
    expect(pedalsOf({ F13: { action: "trigger", instrument: 4, whileHeld: true } }).F13.instrument).toBe(4);
  });

  it("does what it is mapped to", () => {
    const mapping = {
      ...USUAL_PAD,
      deadZone: 0.5,
      speed_m_per_s: 0.2,
      axes: { ...USUAL_PAD.axes, right: { axis: 5, inverted: true }, up: { axis: null, inverted: false }, roll: { axis: 2, inverted: false } },
      buttons: { 7: "cut" as const },
    };
    const now: PadState = { axes: [1, 1, 1, 0.4, 0, 1], pressed: [true, false, false, false, false, false, false, true] };
    expect(readPad(now, { axes: [], pressed: [] }, 0.1, mapping)).toEqual({
      motion_m: [-(0.2 * 0.1), 0, 0],
      roll_rad: Math.PI / 20,
      actions: ["cut"],
    });
  });

  it("is kept for each device, as far as what was kept is understood", () => {
    const kept = { "Pad A": { ...USUAL_PAD, instrument: 1, speed_m_per_s: 99, buttons: { 0: "explode", 1: "cut" } }, "Pad B": 3 };
    expect(padsOf(JSON.parse(JSON.stringify(kept)))).toEqual({ "Pad A": { ...USUAL_PAD, instrument: 1, buttons: { 1: "cut" } }, "Pad B": USUAL_PAD });
    const pedals = { KeyB: { action: "trigger", instrument: 1, whileHeld: true }, F13: { action: "nothing" }, F14: { action: "cut", instrument: -1 } };
    expect(pedalsOf(pedals)).toEqual({ KeyB: pedals.KeyB, F14: { action: "cut", instrument: null, whileHeld: false } });
    for (const nothing of [null, 3, "x", []]) expect([padsOf(nothing), pedalsOf(nothing)]).toEqual([{}, {}]);
  });
});
