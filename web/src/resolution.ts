/**
 * How sharply to draw when the processor does the drawing: coarser while the picture moves and frames are late, full
 * while it moves and they are not, and once finer than the screen (smooth edges) when it has come to rest.
 * Pure: times come in as arguments.
 */

/** Pixels of the picture to CSS pixels, from sharp to coarse, while something moves. */
const LEVELS = [1, 0.75, 0.55] as const;
export const REST_RATIO = 2;
/** So long nothing may change before the sharp picture is drawn [ms]. */
export const REST_AFTER_MS = 400;
const LATE_MS = 40;
const EARLY_MS = 22;
/** Frames that are looked at before the level changes. */
const WINDOW = 12;
/** A longer gap is a pause, not a late frame [ms]. */
const PAUSE_MS = 350;

export class Resolution {
  private level = 0;
  private intervals: number[] = [];
  private last_ms: number | null = null;

  /** Ratio for a frame drawn at `now_ms` because something moved. */
  moving(now_ms: number): number {
    const interval = this.last_ms === null ? Infinity : now_ms - this.last_ms;
    this.last_ms = now_ms;
    if (interval < PAUSE_MS) this.intervals.push(interval);
    if (this.intervals.length >= WINDOW) {
      const mean = this.intervals.reduce((sum, x) => sum + x, 0) / this.intervals.length;
      this.intervals = [];
      if (mean > LATE_MS && this.level < LEVELS.length - 1) this.level += 1;
      else if (mean < EARLY_MS && this.level > 0) this.level -= 1;
    }
    return LEVELS[this.level];
  }
}
