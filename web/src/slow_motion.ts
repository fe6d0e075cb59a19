/** Slow motion: how fast simulated time passes, as the server was asked or, once a second, as it says. */
import type { Timing } from "./timing";

/** Simulated seconds in a second; after the last one real time comes again. */
export const SPEEDS: readonly number[] = [1, 0.5, 0.25, 0.1];

export class SlowMotion {
  speed = 1;

  /** The next slower speed, or real time again. */
  next(): number {
    this.speed = SPEEDS.find((speed) => speed < this.speed) ?? SPEEDS[0];
    return this.speed;
  }

  /** The server may have refused, and another page may have asked. */
  hear({ speed }: Pick<Timing, "speed">): void {
    this.speed = speed;
  }
}
