import { describe, expect, it } from "vitest";
import { forceText, panelValues, pointText_mm } from "../src/panel";
import { arrowScale_m_per_n, ForceHistory, niceCeiling, PLOT_SPAN_S, plotScale } from "../src/plot";
import { Profile } from "../src/profiler";
import { Resolution } from "../src/resolution";

describe("plot", () => {
  it.each([
    [0, 0.01],
    [NaN, 0.01],
    [0.01, 0.01],
    [0.011, 0.02],
    [0.2, 0.2],
    [0.3, 0.5],
    [0.6, 1],
    [1, 1],
    [2.0001, 5],
    [7, 10],
    [123, 200],
  ])("niceCeiling(%d) = %d", (value, ceiling) => expect(niceCeiling(value)).toBeCloseTo(ceiling, 12));

  it("niceCeiling is never below its argument and at most 2.5 times it", () => {
    for (let x = 0.0101; x < 1e4; x *= 1.037) {
      expect(niceCeiling(x)).toBeGreaterThanOrEqual(x * (1 - 1e-12));
      expect(niceCeiling(x)).toBeLessThanOrEqual(2.5 * x * (1 + 1e-9));
    }
  });

  const area = { left: 30, top: 10, width: 200, height: 100 };

  it("scales a short history from time 0", () => {
    const scale = plotScale([{ time_s: 0, force_n: 0 }, { time_s: 5, force_n: 1.5 }], area);
    expect([scale.start_s, scale.top_n]).toEqual([0, 2]);
    expect([scale.x(0), scale.x(5), scale.x(10)]).toEqual([30, 130, 230]);
    expect([scale.y(0), scale.y(1), scale.y(2)]).toEqual([110, 60, 10]);
  });

  it("scrolls: the newest sample is at the right edge, older ones are cut at the left", () => {
    const scale = plotScale([{ time_s: 90, force_n: 1 }, { time_s: 100, force_n: 1 }], area);
    expect(scale.x(100)).toBe(230);
    expect(scale.x(50)).toBe(30);
  });

  it("an empty history has a scale too", () => {
    const scale = plotScale([], area);
    expect([scale.x(0), scale.y(0)]).toEqual([30, 110]);
  });

  it("history is bounded in time and number, keeps the peak, begins anew after a reset", () => {
    const history = new ForceHistory();
    for (let i = 0; i < 50_000; i++) history.add({ time_s: i * 0.002, force_n: i === 10 ? 9 : 1 });
    const samples = history.all();
    expect(samples.length).toBeLessThanOrEqual(2048);
    expect(samples[0].time_s).toBeGreaterThanOrEqual(99.998 - PLOT_SPAN_S - 0.002 - 1e-9);
    expect(history.peak_n).toBe(9);
    history.add({ time_s: 0, force_n: 0.5 });
    expect(history.all()).toEqual([{ time_s: 0, force_n: 0.5 }]);
    expect(history.peak_n).toBe(0.5);
  });

  it("a second sample of the same time replaces the first", () => {
    const history = new ForceHistory();
    history.add({ time_s: 1, force_n: 1 });
    history.add({ time_s: 1, force_n: 2 });
    expect(history.all()).toEqual([{ time_s: 1, force_n: 2 }]);
  });

  it("the arrow of the largest force is at most 6 cm long and more than 2 cm", () => {
    for (let force = 0.6; force < 500; force *= 1.1) {
      const length = force * arrowScale_m_per_n(force);
      expect(length).toBeLessThanOrEqual(0.06 * (1 + 1e-9));
      expect(length).toBeGreaterThan(0.02);
    }
    expect(arrowScale_m_per_n(0)).toBeCloseTo(0.1, 12);
  });
});

describe("panel", () => {
  it("a force is written to within half a per cent, in few letters", () => {
    const inNewtons = { N: 1, mN: 1e-3, µN: 1e-6 };
    for (let force = 1e-6; force < 1e4; force *= 1.0173) {
      const text = forceText(force);
      const [number, unit] = text.split(" ") as [string, keyof typeof inNewtons];
      expect(Math.abs(Number(number) * inNewtons[unit] - force) / force).toBeLessThanOrEqual(0.005);
      expect(text.length).toBeLessThanOrEqual(8);
    }
    expect(forceText(0)).toBe("0.000 N");
    expect(forceText(1.23456)).toBe("1.235 N");
    expect(forceText(1.89e-6)).toBe("1.89 µN");
  });
  it("points are in millimetres, without a negative zero", () => {
    expect(pointText_mm([0.0123, -0.00001, -0.004])).toBe("12.3   0.0   −4.0");
  });
  it("shows dashes before anything has arrived", () => {
    const values = panelValues(null, null, 0, 0.1, 0);
    expect(values.force).toBe("–");
    expect(values.state).toBe("waiting");
  });
});

describe("resolution in software", () => {
  const run = (resolution: Resolution, interval_ms: number, start_ms: number, frames: number): number => {
    let ratio = 0;
    for (let i = 0; i < frames; i++) ratio = resolution.moving(start_ms + i * interval_ms);
    return ratio;
  };
  it("is full when frames come in time, coarser when they are late, and recovers", () => {
    const resolution = new Resolution();
    expect(run(resolution, 16, 0, 40)).toBe(1);
    expect(run(resolution, 80, 1_000, 60)).toBe(0.55);
    expect(run(resolution, 16, 10_000, 60)).toBe(1);
  });
  it("pauses are no late frames", () => {
    expect(run(new Resolution(), 1000, 0, 60)).toBe(1);
  });
});

describe("profile", () => {
  it("averages over its window and forgets what is older", () => {
    const profile = new Profile();
    profile.frame({ at_ms: 0, work_ms: 100, draw_ms: 100 });
    for (let i = 0; i < 60; i++) {
      profile.frame({ at_ms: 5000 + i * 16, work_ms: 2, draw_ms: 1 });
      profile.arrival({ at_ms: 5000 + i * 16, bytes: 1000 });
    }
    const summary = profile.summary(6000);
    expect(summary.work_ms).toBe(2);
    expect(summary.frames_per_s).toBe(30);
    expect(summary.megabytes_per_s).toBeCloseTo(0.03, 12);
    expect(profile.summary(60_000).frames_per_s).toBe(0);
  });
});
