import { describe, expect, it } from "vitest";
import { decodeText, ProtocolError } from "../src/protocol";
import { hapticsText, histogramText, timingLines, type Timing } from "../src/timing";

const HISTOGRAM = { p50: 12, p99: 40, p999: 80.5, max: 120 };
const TIMING = {
  type: "timing",
  simulation: { rate_hz: 990, real_time_factor: 0.99, times_given_up: 2, left_out_s: 0.25, effort: "reduced" },
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
    motion_to_force_us: HISTOGRAM,
    local_model_age_ms: HISTOGRAM,
    scheduling: "SCHED_FIFO 40, on core 1",
  },
};

describe("who controls and how the loops keep time", () => {
  it("reads roles and timing", () => {
    const role = { type: "role", role: "viewer", control_is_taken: true };
    expect(decodeText(JSON.stringify(role))).toEqual(role);
    const timing = decodeText(JSON.stringify(TIMING)) as Timing;
    expect(timing.haptics).toMatchObject({ jitter_p50_us: 12, jitter_p999_us: 80.5, model_age_max_ms: 120 });
    expect(hapticsText(timing.haptics!)).toBe("1000 Hz, 0.03 % missed");
    expect(timingLines(timing).join("\n")).toMatch(/reduced effort; fell behind 2 times, 0.3 s[^]*5 of 20000[^]*SCHED_FIFO/);
    expect(histogramText(timing.haptics!.jitter_histogram_us)).toBe("▄█▁ 1.0 to 4.1 us");
    expect(histogramText([])).toMatch(/nothing/);
    const without = decodeText(JSON.stringify({ ...TIMING, haptics: null })) as Timing;
    expect(timingLines(without)).toHaveLength(1);
    expect(timingLines(null)).toHaveLength(0);
  });

  it("refuses what it cannot read", () => {
    for (const bad of [
      { type: "role", role: "king" },
      { type: "timing" },
      { ...TIMING, simulation: { ...TIMING.simulation, effort: 3 } },
      { ...TIMING, haptics: { ...TIMING.haptics, jitter_us: { p50: "12" } } },
      { ...TIMING, haptics: 7 },
      { ...TIMING, haptics: { ...TIMING.haptics, jitter_histogram_us: [[1, -2]] } },
    ]) {
      expect(() => decodeText(JSON.stringify(bad))).toThrow(ProtocolError);
    }
  });
});
