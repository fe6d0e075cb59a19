/** Force over simulated time: a bounded history; scales, and what all plots draw with. */

/** The plot shows this much simulated time [s]. */
export const PLOT_SPAN_S = 10;
const MAX_SAMPLES = 2048;

export interface Sample {
  readonly time_s: number;
  readonly force_n: number;
}

/** Samples of the last {@link PLOT_SPAN_S}; time that runs backwards (a reset) begins anew. */
export class ForceHistory {
  private samples: Sample[] = [];
  private largest_n = 0;

  add(sample: Sample): void {
    const last = this.samples.at(-1);
    if (last !== undefined && sample.time_s < last.time_s) this.clear();
    if (last !== undefined && sample.time_s === last.time_s) this.samples.pop();
    this.samples.push(sample);
    this.largest_n = Math.max(this.largest_n, sample.force_n);
    const oldest = sample.time_s - PLOT_SPAN_S;
    let drop = Math.max(0, this.samples.length - MAX_SAMPLES);
    // One sample before the window stays, so that the line reaches the plot's edge.
    while (drop + 1 < this.samples.length && this.samples[drop + 1].time_s < oldest) drop++;
    if (drop > 0) this.samples.splice(0, drop);
  }

  clear(): void {
    this.samples = [];
    this.largest_n = 0;
  }

  all(): readonly Sample[] {
    return this.samples;
  }

  /** Largest force since the start or the last reset, also when it has left the plot [N]. */
  get peak_n(): number {
    return this.largest_n;
  }
}

/** The smallest of 1, 2, 5 times a power of ten that is at least `value`; `floor`, itself such a number, for values below it. */
export function niceCeiling(value: number, floor = 0.01): number {
  if (!(value > floor)) return floor;
  const power = Math.pow(10, Math.floor(Math.log10(value)));
  for (const factor of [1, 2, 5, 10]) {
    // Relative slack for what rounding adds to a product such as 2 * 0.1.
    if (factor * power * (1 + 1e-12) >= value) return factor * power;
  }
  return 10 * power;
}

export interface PlotArea {
  readonly left: number;
  readonly top: number;
  readonly width: number;
  readonly height: number;
}

/**
 * Length of the force arrow for a newton [m/N]: 1, 2 or 5 times a power of ten, such that the largest force so far is at
 * most 6 cm long; at most 10 cm for a newton.
 */
export function arrowScale_m_per_n(largest_n: number): number {
  const longest_m = 0.06;
  const wanted = longest_m / Math.max(largest_n, 0.6);
  const power = Math.pow(10, Math.floor(Math.log10(wanted)));
  const factor = [5, 2, 1].find((f) => f * power <= wanted * (1 + 1e-12)) ?? 1;
  return factor * power;
}

/** A line through `points` [CSS pixels] and the fill between it and the plot's floor. */
export function drawCurve(
  context: CanvasRenderingContext2D,
  points: ReadonlyArray<readonly [number, number]>,
  area: PlotArea,
  colour = "#ffb45e",
  isFilled = true,
): void {
  if (points.length === 0) return;
  context.beginPath();
  points.forEach(([x, y], i) => (i === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  context.lineJoin = "round";
  context.stroke();
  if (!isFilled) return;
  context.lineTo(points[points.length - 1][0], area.top + area.height);
  context.lineTo(points[0][0], area.top + area.height);
  context.closePath();
  const fill = context.createLinearGradient(0, area.top, 0, area.top + area.height);
  fill.addColorStop(0, "rgba(255,180,94,0.32)");
  fill.addColorStop(1, "rgba(255,180,94,0.02)");
  context.fillStyle = fill;
  context.fill();
}

/** An empty canvas in CSS pixels, as fine as the screen; null where there is nothing to draw on. */
export function fitted(
  canvas: HTMLCanvasElement,
): { readonly context: CanvasRenderingContext2D; readonly width: number; readonly height: number } | null {
  const context = canvas.getContext("2d");
  if (context === null) return null;
  const ratio = Math.max(1, window.devicePixelRatio);
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}
