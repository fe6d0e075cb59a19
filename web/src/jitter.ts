/** Histogram of the haptic loop's jitter: which bars it has (pure), and its drawing on a canvas. */
import { fitted, type PlotArea } from "./plot";
import type { HapticTiming } from "./timing";

/** The axis begins here [us]: what is below counts in the first bar. */
export const FIRST_END_US = 1.024;
/** A deadline is missed when its tick begins later than so many periods after it. */
export const MISSED_PERIODS = 2;

export interface Bar {
  /** From left to right, as shares of the axis. */
  readonly from: number;
  readonly to: number;
  /** Logarithm of the count as a share of that of the largest one: what is rare matters most. */
  readonly height: number;
  readonly isMissed: boolean;
}

export interface JitterPlot {
  readonly bars: readonly Bar[];
  /** Where on the axis jitter is a missed deadline. */
  readonly missedFrom: number;
  /** Where times [us] stand on the axis. */
  readonly marks: ReadonlyArray<{ readonly at: number; readonly text: string }>;
}

/** Octaves of jitter on a logarithmic axis that reaches beyond missed deadlines; null while nothing was counted. */
export function jitterPlot(haptics: Pick<HapticTiming, "jitter_histogram_us" | "period_us">): JitterPlot | null {
  const { jitter_histogram_us: octaves, period_us } = haptics;
  const counts = new Map<number, number>();
  for (const [end_us, count] of octaves) {
    const octave = Math.max(0, Math.round(Math.log2(end_us / FIRST_END_US)));
    if (count > 0) counts.set(octave, (counts.get(octave) ?? 0) + count);
  }
  const most = Math.max(0, ...counts.values());
  if (most === 0 || !(period_us > 0)) return null;
  const missed_us = MISSED_PERIODS * period_us;
  const nBars = Math.max(Math.max(...counts.keys()) + 1, Math.ceil(Math.log2(missed_us / FIRST_END_US)) + 2);
  // The first bar ends at FIRST_END_US; an octave is as wide as another.
  const at = (us: number): number => Math.min(1, Math.max(0, (1 + Math.log2(us / FIRST_END_US)) / nBars));
  const bars = [...counts].sort(([a], [b]) => a - b).map(([octave, count]) => ({
    from: octave / nBars,
    to: (octave + 1) / nBars,
    height: Math.log1p(count) / Math.log1p(most),
    isMissed: FIRST_END_US * 2 ** (octave - 1) >= missed_us,
  }));
  const texts: ReadonlyArray<readonly [number, string]> = [[1, "1 µs"], [10, "10"], [100, "100"], [1000, "1 ms"], [10_000, "10 ms"], [100_000, "100"]];
  const marks = texts.filter(([us]) => at(us) < 0.97).map(([us, text]) => ({ at: at(us), text }));
  return { bars, missedFrom: at(missed_us), marks };
}

const COLOURS = { bar: "#63b3e0", missed: "#ff6b5e", axis: "rgba(255,255,255,0.14)", text: "#7f8c98" };

export function drawJitter(canvas: HTMLCanvasElement, haptics: HapticTiming | null): void {
  const plot = haptics === null ? null : jitterPlot(haptics);
  const sheet = fitted(canvas);
  if (sheet === null || plot === null) return;
  const { context, width, height } = sheet;
  const area: PlotArea = { left: 8, top: 12, width: width - 16, height: height - 26 };
  const x = (share: number): number => area.left + share * area.width;
  const bottom = area.top + area.height;
  for (const { from, to, height: share, isMissed } of plot.bars) {
    context.fillStyle = isMissed ? COLOURS.missed : COLOURS.bar;
    // A single one is seen, too.
    const tall = Math.max(2, share * area.height);
    context.fillRect(x(from) + 0.5, bottom - tall, x(to) - x(from) - 1, tall);
  }
  context.strokeStyle = COLOURS.axis;
  context.lineWidth = 1;
  context.beginPath();
  context.moveTo(area.left, bottom + 0.5);
  context.lineTo(area.left + area.width, bottom + 0.5);
  context.stroke();
  context.font = "10px system-ui, sans-serif";
  context.fillStyle = COLOURS.text;
  context.textBaseline = "top";
  context.textAlign = "center";
  for (const { at, text } of plot.marks) context.fillText(text, x(at), bottom + 4);
  context.strokeStyle = COLOURS.missed;
  context.setLineDash([3, 2]);
  context.beginPath();
  context.moveTo(x(plot.missedFrom), area.top - 2);
  context.lineTo(x(plot.missedFrom), bottom);
  context.stroke();
  context.setLineDash([]);
  context.fillStyle = COLOURS.missed;
  context.textAlign = plot.missedFrom > 0.7 ? "right" : "left";
  context.fillText("missed", x(plot.missedFrom) + (plot.missedFrom > 0.7 ? -4 : 4), 0);
}
