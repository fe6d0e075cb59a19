/** One clock for one recording, whose time it is, or for two beside each other. */
import { frameIn } from "./recording";

/** Where two recordings lie on the clock: from their beginnings on, or from the first motion of each one's task. */
export type Beginning = "recording" | "task";

/** What the clock has to know of a recording. */
export interface Timed {
  readonly begin_s: number;
  readonly end_s: number;
  readonly rate_hz: number;
  readonly times_s: readonly number[];
  readonly story: { readonly began_s: number | null } | null;
}

export class Clock {
  beginning: Beginning = "recording";
  /** Times at which there is a frame [s]. */
  frames_s: readonly number[] = [];

  constructor(private readonly recordings: readonly Timed[]) {
    this.beginWith(this.canBeginWithTask ? "task" : "recording");
  }

  get isPair(): boolean {
    return this.recordings.length > 1;
  }

  /** Whether both have a task that was begun. */
  get canBeginWithTask(): boolean {
    return this.isPair && this.recordings.every(({ story }) => story?.began_s != null);
  }

  beginWith(beginning: Beginning): void {
    this.beginning = beginning;
    const { recordings } = this;
    if (!this.isPair) {
      this.frames_s = recordings[0].times_s;
      return;
    }
    const begin_s = Math.min(...recordings.map((recording, i) => recording.begin_s - this.start_s(i)));
    const end_s = Math.max(...recordings.map((recording, i) => recording.end_s - this.start_s(i)));
    const rate_hz = Math.max(...recordings.map((recording) => recording.rate_hz));
    this.frames_s = Array.from({ length: Math.floor((end_s - begin_s) * rate_hz + 1e-6) + 1 }, (_, i) => begin_s + i / rate_hz);
  }

  get begin_s(): number {
    return this.frames_s[0];
  }

  get end_s(): number {
    return this.frames_s[this.frames_s.length - 1];
  }

  /** The time of a recording at which the clock is at nought [s]. */
  start_s(recording: number): number {
    if (!this.isPair) return 0;
    const { begin_s, story } = this.recordings[recording];
    return this.beginning === "task" ? (story?.began_s ?? begin_s) : begin_s;
  }

  /** The time of a recording [s] at a time of the clock. */
  timeIn(recording: number, clock_s: number): number {
    const { begin_s, end_s } = this.recordings[recording];
    return Math.min(end_s, Math.max(begin_s, clock_s + this.start_s(recording)));
  }

  frameAt(clock_s: number): number {
    return frameIn(this.frames_s, clock_s);
  }
}
