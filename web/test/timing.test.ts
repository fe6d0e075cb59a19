import { describe, expect, it } from "vitest";
import { decodeText, ProtocolError } from "../src/protocol";
import { panelValues } from "../src/panel";
import { jitterPlot } from "../src/jitter";
import { hapticsText, histogramText, jitterText, mayMove, tickText, timingLines, type Role, type Timing } from "../src/timing";

const HISTOGRAM = { p50: 12, p99: 40, p999: 80.5, max: 120 };
const TIMING = {
  type: "timing",
  simulation: {
    rate_hz: 990,
    real_time_factor: 0.99,
    times_given_up: 2,
    left_out_s: 0.25,
    effort: "reduced",
    step_us: { p50: 420, p99: 800, p999: 1700, max: 9000 },
    step_budget_us: 1000,
    steps: 20000,
    steps_over_budget: 30,
    frame_ms: { p50: 16.4, p99: 18, p999: 33.1, max: 50 },
    frame_budget_ms: 16,
  },
  haptics: {
    rate_hz: 999.6,
    deadlines: 20000,
    missed_deadlines: 5,
    jitter_us: HISTOGRAM,
    jitter_histogram_us: [
      [1.024, 10],
      [2.048, 1000],
      [4.096, 0],
    ],
    tick_us: HISTOGRAM,
    period_us: 1000,
    motion_to_force_us: HISTOGRAM,
    local_model_age_ms: HISTOGRAM,
    scheduling: "SCHED_FIFO 40, on core 1",
  },
  haptics_at: "here",
};

describe("who controls and how the loops keep time", () => {
  it("reads roles and timing", () => {
    const role = { type: "role", role: "viewer", control_is_taken: true, instruments: ["offered", "this"] };
    expect(decodeText(JSON.stringify(role))).toEqual(role);
    const timing = decodeText(JSON.stringify(TIMING)) as Timing;
    expect(timing.haptics).toMatchObject({ jitter_p50_us: 12, jitter_p999_us: 80.5, model_age_max_ms: 120 });
    expect(hapticsText(timing.haptics!)).toBe("1000 Hz, 0.03 % missed");
    expect(timingLines(timing).join("\n")).toMatch(/reduced effort; fell behind 2 times, 0.3 s[^]*5 of 20000[^]*SCHED_FIFO/);
    expect(histogramText(timing.haptics!.jitter_histogram_us)).toBe("▄█▁ 1.0 to 4.1 us");
    expect(histogramText([])).toMatch(/nothing/);
    expect(tickText(timing.haptics!)).toBe("12 of 1000 µs, 99.9 % 81");
    expect(timingLines(timing).join("\n")).toMatch(/tick +12.0 us, 99 % 40.0 us, 99.9 % 80.5 us, of 1000 us/);
    const without = decodeText(JSON.stringify({ ...TIMING, haptics: null, haptics_at: "nowhere" })) as Timing;
    expect(timingLines(without)).toHaveLength(4);
    expect(timingLines(null)).toHaveLength(0);
  });

  it("tells what steps take of their budget and how often displays get a state", () => {
    const timing = decodeText(JSON.stringify(TIMING)) as Timing;
    expect(timing.steps).toMatchObject({ p50_us: 420, over_budget: 30, frame_p999_ms: 33.1 });
    const [, step, published] = timingLines(timing);
    expect(step).toMatch(/420 us, 99 % 800 us, 99.9 % 1700 us, of 1000 us; 0.15 % took longer/);
    expect(published).toMatch(/every 16.4 ms, 99.9 % 33.1 ms; wanted 16 ms/);
    const none = { ...TIMING, simulation: { ...TIMING.simulation, steps: 0 } };
    expect(timingLines(decodeText(JSON.stringify(none)) as Timing)[1]).toMatch(/none yet/);
    const broken = { ...TIMING, simulation: { ...TIMING.simulation, step_us: { p50: "fast" } } };
    expect(() => decodeText(JSON.stringify(broken))).toThrow(ProtocolError);
    expect(() => decodeText(JSON.stringify(broken))).toThrow(/timing.simulation.step_us/);
  });

  it("says in the panel what a tick takes, and where haptics are when they are not here", () => {
    const shown = (message: object | null) => {
      const timing = message === null ? null : (decodeText(JSON.stringify(message)) as Timing);
      const { haptics, haptic_tick } = panelValues(null, null, 0, 1, 0, { role: null, timing, feel: null, parameters: null });
      return [haptics, haptic_tick];
    };
    expect(shown(TIMING)).toEqual(["1000 Hz, 0.03 % missed", "12 of 1000 µs, 99.9 % 81"]);
    const remote = { ...TIMING, haptics: null, haptics_at: "other_machine" };
    expect(shown(remote)).toEqual(["at the other machine", "–"]);
    expect(timingLines(decodeText(JSON.stringify(remote)) as Timing).at(-1)).toMatch(/at the other machine/);
    expect(shown({ ...remote, haptics_at: "nowhere" })).toEqual(["no device", "–"]);
    expect(shown(null)).toEqual(["–", "–"]);
  });

  it("has a histogram with logarithmic bins that tells missed deadlines apart", () => {
    const of = (octaves: Array<[number, number]>, period_us = 1000) => jitterPlot({ jitter_histogram_us: octaves, period_us });
    expect(of([])).toBeNull();
    expect(of([[4.096, 0]])).toBeNull();
    const plot = of([[0.512, 3], [1.024, 4], [2.048, 1000], [4.096, 0], [1048.576, 1], [4194.304, 2]])!;
    // What is below a microsecond is one bar; empty ones are left out.
    expect(plot.bars.map(({ isMissed }) => isMissed)).toEqual([false, false, false, true]);
    const width = plot.bars[0].to;
    expect(plot.bars.map(({ from }) => Math.round(from / width))).toEqual([0, 1, 10, 12]);
    expect(plot.bars[1].height).toBe(1);
    expect(plot.bars[0].height).toBeCloseTo(Math.log1p(7) / Math.log1p(1000), 12);
    // Two periods of 1 ms lie between the octaves that end at 1.05 ms and at 4.2 ms.
    expect(plot.missedFrom).toBeGreaterThan(plot.bars[2].to);
    expect(plot.missedFrom).toBeLessThan(plot.bars[3].from + width);
    expect(plot.marks.map(({ text }) => text)).toEqual(["1 µs", "10", "100", "1 ms"]);
    const far = of([[1.024, 1]], 10_000)!;
    expect(far.missedFrom).toBeLessThan(1);
    expect(far.marks.at(-1)!.text).toBe("10 ms");
    expect(jitterText({ jitter_p50_us: 3.4, jitter_p999_us: 40.6 } as Timing["haptics"] & object)).toBe("3 µs, 99.9 % 41");
  });

  it("refuses what it cannot read", () => {
    for (const bad of [
      { type: "role", role: "king" },
      { type: "role", role: "viewer", instruments: ["mine"] },
      { type: "timing" },
      { ...TIMING, simulation: { ...TIMING.simulation, effort: 3 } },
      { ...TIMING, haptics: { ...TIMING.haptics, jitter_us: { p50: "12" } } },
      { ...TIMING, haptics: 7 },
      { ...TIMING, haptics_at: "on the moon" },
      { ...TIMING, haptics_at: undefined },
      { ...TIMING, haptics: { ...TIMING.haptics, jitter_histogram_us: [[1, -2]] } },
    ]) {
      expect(() => decodeText(JSON.stringify(bad))).toThrow(ProtocolError);
    }
  });
});

describe("which instruments a page may move", () => {
  const role = (of: "controller" | "viewer", instruments: Role["instruments"]): Role => ({ type: "role", role: of, control_is_taken: true, instruments });

  it("that which controls all but those that another one took, others only what they took", () => {
    const instruments = ["controller", "offered", "this", "another"] as const;
    const may = (of: "controller" | "viewer") => instruments.map((_, tool) => mayMove(role(of, instruments), tool));
    expect(may("controller")).toEqual([true, true, true, false]);
    expect(may("viewer")).toEqual([false, false, true, false]);
    expect(mayMove(null, 0)).toBe(true);
  });
});
