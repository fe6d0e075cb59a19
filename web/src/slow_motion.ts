/** Slow motion: how fast simulated time passes, as the server was asked or, once a second, as it says. */
import type { Timing } from "./timing";

/** Simulated seconds in a second; after the last one real time comes again. */
export const SPEEDS: readonly number[] = [1, 0.5, 0.25, 0.1];

/** What the server says may be from before it was asked, for so long [ms]. */
export const SETTLING_MS = 500;

export class SlowMotion {
  speed = 1;
  private asked_ms = -Infinity;

  /** The next slower speed, or real time again. */
  next(now_ms = performance.now()): number {
    this.asked_ms = now_ms;
    this.speed = SPEEDS.find((speed) => speed < this.speed) ?? SPEEDS[0];
    return this.speed;
  }

  /** The server may have refused, and another page may have asked. */
  hear({ speed }: Pick<Timing, "speed">, now_ms = performance.now()): void {
    if (now_ms - this.asked_ms >= SETTLING_MS) this.speed = speed;
  }
}
