import { describe, expect, it } from "vitest";
import type { ToolInfo, ToolState } from "../src/protocol";
import { Score, SILENCE } from "../src/sound";

const hello = { tools: [{ kind: "hook" }, { kind: "probe" }, { kind: "suction" }] as ToolInfo[] };
const header = (time_s: number, triggers = [0, 0], ml_per_min = 0, paused = false) => ({
  time_s,
  paused,
  tools: triggers.map((trigger) => ({ trigger })) as ToolState[],
  bleeding: { lost_m3: 0, rate_m3_per_s: (ml_per_min * 1e-6) / 60, clips: 0, ends: [] },
});

describe("what sounds", () => {
  it("72 beats in a minute of the simulation, however often it is looked at", () => {
    for (const step_s of [0.016, 0.3]) {
      const score = new Score();
      let beats = 0;
      for (let time_s = 0.01; time_s < 60; time_s += step_s) beats += Number(score.take(header(time_s), hello).beat);
      expect(beats).toBe(71);
    }
  });

  it("the tone of instruments that burn, while they are on", () => {
    const score = new Score();
    expect(score.take(header(0, [1, 0]), hello).cautery).toBe(true);
    expect(score.take(header(0, [0, 1]), hello).cautery).toBe(false);
    expect(score.take(header(9, [1, 0], 100, true), hello)).toEqual(SILENCE);
  });

  it("the hiss of a suction tube while it sucks, and of nothing else that is on", () => {
    const score = new Score();
    expect(score.take(header(0, [1, 1, 0]), hello).suction).toBe(false);
    expect(score.take(header(0.1, [0, 0, 1]), hello)).toEqual({ ...SILENCE, suction: true });
  });

  it("the alarm while much bleeds, of two notes", () => {
    const score = new Score();
    expect(score.take(header(0, [0, 0], 4.9), hello).alarm).toBeNull();
    expect([0.1, 0.5, 0.9].map((time_s) => score.take(header(time_s, [0, 0], 5.1), hello).alarm)).toEqual([0, 1, 0]);
  });
});
