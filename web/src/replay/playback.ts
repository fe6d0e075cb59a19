/** Where a recording is played, and how fast: a clock without a clock, times come in as arguments. */

/** Speeds to choose from, as multiples of real time. */
export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8] as const;

export class Playback {
  time_s: number;
  playing = false;
  private speedNumber = SPEEDS.indexOf(1);

  constructor(
    private readonly begin_s: number,
    private readonly end_s: number,
    before?: Playback,
  ) {
    this.time_s = begin_s;
    // As fast as before, and going on.
    if (before !== undefined) [this.speedNumber, this.playing] = [before.speedNumber, before.playing];
  }

  get speed(): number {
    return SPEEDS[this.speedNumber];
  }

  /** Plays or stands; from the end it begins anew. */
  toggle(): void {
    if (!this.playing && this.time_s >= this.end_s) this.time_s = this.begin_s;
    this.playing = !this.playing;
  }

  /** So many speeds faster. */
  faster(by: number): void {
    this.speedNumber = Math.min(SPEEDS.length - 1, Math.max(0, this.speedNumber + by));
  }

  jump(time_s: number): void {
    this.time_s = Math.min(this.end_s, Math.max(this.begin_s, time_s));
  }

  /** `dt_s` seconds went by; at the end it stands. */
  advance(dt_s: number): void {
    if (!this.playing) return;
    this.jump(this.time_s + dt_s * this.speed);
    if (this.time_s >= this.end_s) this.playing = false;
  }
}

/** The place before or after `time_s` in ascending `times_s`; null where there is none. */
export function neighbour(times_s: readonly number[], time_s: number, forward: boolean): number | null {
  // Who has just jumped to one is at it.
  const slack_s = 0.02;
  const next = forward ? times_s.find((t) => t > time_s + slack_s) : times_s.findLast((t) => t < time_s - slack_s);
  return next ?? null;
}
