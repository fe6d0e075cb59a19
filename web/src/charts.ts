/**
 * What the plot of the panel shows: force over time, force over how far the tip went in since it touched (the curve of an indentation),
 * energies, or what steps take of their budget. Which lines (pure), as CSV (pure), and their drawing.
 */
import type { ChartKind } from "./chart_kinds";
import { text } from "./language";
import { drawCurve, fitted, niceCeiling, PLOT_SPAN_S, type ForceHistory, type Sample } from "./plot";
import type { Vec3 } from "./protocol";
import type { Timing } from "./timing";

/** What a snapshot brings for the charts. */
export interface Moment extends Sample {
  readonly tip_m: Vec3;
  readonly contact: boolean;
  /** Kinetic, elastic, and in the hand's spring [J]; null while nobody looks inside. */
  readonly energies_j: readonly [number, number, number] | null;
}

interface Point {
  readonly time_s: number;
  readonly force_n: number;
  /** Of the tip since it touched; null without contact. */
  readonly displacement_m: number | null;
  readonly energies_j: Moment["energies_j"];
}

interface StepTime {
  readonly time_s: number;
  readonly p50_us: number;
  readonly p99_us: number;
  readonly budget_us: number;
}

export interface Line {
  readonly name: string;
  readonly colour: string;
  readonly points: ReadonlyArray<readonly [x: number, y: number]>;
}

export interface Chart {
  readonly lines: readonly Line[];
  readonly from: number;
  readonly to: number;
  readonly top: number;
  readonly xUnit: string;
  readonly yUnit: string;
}

/** Apart for people who do not see red and green apart (Okabe and Ito 2008), on a dark ground. */
const COLOURS = ["#ffb45e", "#56b4e9", "#cc79a7"] as const;
const MOST_POINTS = 4096;

/** What the charts know: from the start or the last reset on, at most so many snapshots. */
export class ChartHistory {
  private points: Point[] = [];
  private stepTimes: StepTime[] = [];
  private touched_m: Vec3 | null = null;

  add({ time_s, force_n, tip_m, contact, energies_j }: Moment): void {
    const last = this.points.at(-1);
    if (last !== undefined && time_s < last.time_s) this.clear();
    if (last !== undefined && time_s === last.time_s) this.points.pop();
    if (!contact) this.touched_m = null;
    else this.touched_m ??= tip_m;
    const from_m = this.touched_m;
    const displacement_m = from_m === null ? null : Math.hypot(...tip_m.map((x, i) => x - from_m[i]));
    this.points.push({ time_s, force_n, displacement_m, energies_j });
    if (this.points.length > MOST_POINTS) this.points.shift();
  }

  /** Once a second. */
  addTiming({ steps }: Pick<Timing, "steps">): void {
    const time_s = this.points.at(-1)?.time_s;
    if (time_s === undefined || steps.steps === 0) return;
    this.stepTimes.push({ time_s, p50_us: steps.p50_us, p99_us: steps.p99_us, budget_us: steps.budget_us });
    if (this.stepTimes.length > MOST_POINTS) this.stepTimes.shift();
  }

  clear(): void {
    this.points = [];
    this.stepTimes = [];
    this.touched_m = null;
  }

  /** The chart of a kind; that of the force over time is drawn from `force`, which has its span. */
  chart(kind: ChartKind, force: ForceHistory): Chart {
    switch (kind) {
      case "force_time":
        return forceChart(force);
      case "force_displacement": {
        const points = this.contactPoints().map((p) => [1e3 * (p.displacement_m ?? 0), p.force_n] as const);
        const lines = [{ name: text("chart_force"), colour: COLOURS[0], points }];
        return { lines, from: 0, to: niceCeiling(greatest(points, 0), 1), top: niceCeiling(greatest(points, 1)), xUnit: "mm", yUnit: "N" };
      }
      case "energy": {
        const known = this.points.filter((p) => p.energies_j !== null);
        const names = [text("chart_kinetic"), text("chart_elastic"), text("chart_hand")];
        const lines = names.map((name, i) => ({
          name,
          colour: COLOURS[i],
          points: known.map((p) => [p.time_s, 1e3 * (p.energies_j?.[i] ?? 0)] as const),
        }));
        return overTime(lines, "mJ", 1e-3);
      }
      case "step_time": {
        const line = (name: string, colour: string, of: (step: StepTime) => number): Line => ({
          name,
          colour,
          points: this.stepTimes.map((step) => [step.time_s, 1e-3 * of(step)] as const),
        });
        const lines = [
          line(text("chart_half"), COLOURS[0], (step) => step.p50_us),
          line("99 %", COLOURS[1], (step) => step.p99_us),
          line(text("chart_budget"), COLOURS[2], (step) => step.budget_us),
        ];
        return overTime(lines, "ms", 0.01);
      }
    }
  }

  /** Snapshots of the contact that is, or was last. */
  private contactPoints(): Point[] {
    const end = this.points.findLastIndex((p) => p.displacement_m !== null);
    const begin = this.points.findLastIndex((p, i) => i < end && p.displacement_m === null);
    return this.points.slice(begin + 1, end + 1);
  }

  /** All that the charts know as a table, SI units in its heads; a decimal point in any language. */
  csv(): string {
    const head = "time_s,force_n,displacement_since_touch_m,kinetic_energy_j,elastic_energy_j,hand_energy_j";
    const rows = this.points.map((p) =>
      [p.time_s, p.force_n, p.displacement_m, ...(p.energies_j ?? [null, null, null])].map((x) => (x === null ? "" : figures(x))).join(","),
    );
    const stepHead = "time_s,step_median_us,step_p99_us,step_budget_us";
    const stepRows = this.stepTimes.map((s) => [s.time_s, s.p50_us, s.p99_us, s.budget_us].map(figures).join(","));
    return [head, ...rows, "", stepHead, ...stepRows, ""].join("\n");
  }
}

/** Force over time. */
export function forceChart(force: ForceHistory): Chart {
  const points = force.all().map((s) => [s.time_s, s.force_n] as const);
  return overTime([{ name: text("chart_force"), colour: COLOURS[0], points }], "N", 0.01);
}

/** To what a measurement is good for: without what binary numbers add. */
const figures = (x: number): string => String(Number(x.toPrecision(9)));

function greatest(points: Line["points"], part: 0 | 1): number {
  return points.reduce((most, point) => Math.max(most, point[part]), 0);
}

/** The last span of time that any line has. */
function overTime(lines: readonly Line[], yUnit: string, floor: number): Chart {
  const newest = Math.max(0, ...lines.map(({ points }) => points.at(-1)?.[0] ?? 0));
  const from = Math.max(0, newest - PLOT_SPAN_S);
  const inside = lines.map((line) => {
    // One before the span stays, so that the line reaches the edge.
    const first = line.points.findLastIndex(([time_s]) => time_s < from);
    return { ...line, points: line.points.slice(Math.max(0, first)) };
  });
  const top = niceCeiling(Math.max(0, ...inside.map(({ points }) => greatest(points, 1))), floor);
  return { lines: inside, from, to: from + PLOT_SPAN_S, top, xUnit: "s", yUnit };
}

export function drawChart(canvas: HTMLCanvasElement, chart: Chart): void {
  const sheet = fitted(canvas);
  if (sheet === null) return;
  const { context, width, height } = sheet;
  const area = { left: 40, top: 8, width: width - 48, height: height - 26 };
  const clamp = (t: number): number => Math.min(1, Math.max(0, t));
  const x = (value: number): number => area.left + area.width * clamp((value - chart.from) / (chart.to - chart.from));
  const y = (value: number): number => area.top + area.height * (1 - clamp(value / chart.top));
  context.font = "10px system-ui, sans-serif";
  context.fillStyle = "#7f8c98";
  context.strokeStyle = "rgba(255,255,255,0.08)";
  context.lineWidth = 1;
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const part of [0, 0.5, 1]) {
    const height_px = Math.round(y(part * chart.top)) + 0.5;
    context.beginPath();
    context.moveTo(area.left, height_px);
    context.lineTo(area.left + area.width, height_px);
    context.stroke();
    context.fillText(String(Number((part * chart.top).toPrecision(3))), area.left - 5, height_px);
  }
  context.textBaseline = "top";
  context.textAlign = "left";
  const end = (value: number): string => `${Number(value.toFixed(1))} ${chart.xUnit}`;
  context.fillText(end(chart.from), area.left, area.top + area.height + 5);
  context.textAlign = "right";
  context.fillText(end(chart.to), area.left + area.width, area.top + area.height + 5);
  for (const line of chart.lines) {
    const points = line.points.map(([px, py]) => [x(px), y(py)] as const);
    drawCurve(context, points, area, line.colour, chart.lines.length === 1 && chart.xUnit === "s");
    const newest = points.at(-1);
    if (newest === undefined) continue;
    context.beginPath();
    context.arc(newest[0], newest[1], 2.5, 0, 2 * Math.PI);
    context.fillStyle = line.colour;
    context.fill();
  }
}
