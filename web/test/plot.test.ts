import { describe, expect, it } from "vitest";
import { forceText, panelValues, pointText_mm } from "../src/panel";
import { ChartHistory, type Moment } from "../src/charts";
import { arrowScale_m_per_n, ForceHistory, niceCeiling, PLOT_SPAN_S } from "../src/plot";
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

  const chartOf = (samples: ReadonlyArray<readonly [number, number]>) => {
    const force = new ForceHistory();
    for (const [time_s, force_n] of samples) force.add({ time_s, force_n });
    return new ChartHistory().chart("force_time", force);
  };

  it("a short history has its scale from time 0, an empty one too", () => {
    expect(chartOf([[0, 0], [5, 1.5]])).toMatchObject({ from: 0, to: PLOT_SPAN_S, top: 2, xUnit: "s", yUnit: "N" });
    expect(chartOf([])).toMatchObject({ from: 0, to: PLOT_SPAN_S, top: 0.01 });
  });

  it("scrolls: the newest sample is at the right edge", () => {
    expect(chartOf([[90, 1], [100, 1]])).toMatchObject({ from: 90, to: 100 });
  });

  const moment = (time_s: number, depth_mm: number, force_n: number): Moment => ({
    time_s,
    force_n,
    tip_m: [0, 0, -1e-3 * depth_mm],
    contact: force_n > 0,
    energies_j: time_s < 2 ? null : [1e-3, 2e-3, 3e-3],
  });

  it("the curve of an indentation counts from where the tip touched, in the last contact alone", () => {
    const history = new ChartHistory();
    const moments: ReadonlyArray<readonly [number, number, number]> = [[0, -9, 0], [1, 1, 5], [2, -3, 0], [3, 2, 0.5], [4, 5, 1.5], [5, 4, 1], [6, -8, 0]];
    for (const [time_s, depth_mm, force_n] of moments) history.add(moment(time_s, depth_mm, force_n));
    const { lines, to, top, xUnit } = history.chart("force_displacement", new ForceHistory());
    expect(lines[0].points.map(([x, y]) => [Number(x.toFixed(9)), y])).toEqual([[0, 0.5], [3, 1.5], [2, 1]]);
    expect([to, top, xUnit]).toEqual([5, 2, "mm"]);
  });

  it("energies begin when somebody looks inside; step times come once a second", () => {
    const history = new ChartHistory();
    for (let time_s = 0; time_s < 4; time_s++) history.add(moment(time_s, 0, 0));
    const energies = history.chart("energy", new ForceHistory());
    expect(energies.lines.map(({ points }) => points)).toEqual([1, 2, 3].map((mj) => [[2, mj], [3, mj]]));
    const steps = { steps: 9, p50_us: 400, p99_us: 900, p999_us: 950, budget_us: 1000, over_budget: 0, frame_p50_ms: 16, frame_p999_ms: 17, frame_budget_ms: 16 };
    history.addTiming({ steps });
    expect(history.chart("step_time", new ForceHistory()).lines.map(({ points }) => points)).toEqual([[[3, 0.4]], [[3, 0.9]], [[3, 1]]]);
  });

  it("as a table it has a head with units, and empty cells for what is not known", () => {
    const history = new ChartHistory();
    history.add(moment(0.1 + 0.2, -9, 0));
    history.add(moment(3, 2, 0.5));
    const [head, first, second, gap, stepHead, end] = history.csv().split("\n");
    expect(head.split(",")).toHaveLength(6);
    expect([first, second, gap, end]).toEqual(["0.3,0,,,,", "3,0.5,0,0.001,0.002,0.003", "", ""]);
    expect(stepHead).toBe("time_s,step_median_us,step_p99_us,step_budget_us");
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
    expect(forceText(0)).toBe("0 N");
    expect(forceText(1.23456)).toBe("1.23 N");
    expect([9.996, 99.96, 123.4, 0.0512].map(forceText)).toEqual(["10.0 N", "100 N", "123 N", "0.0512 N"]);
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
