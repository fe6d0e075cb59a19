/** The way back to the start page: it ends the simulation, so it is asked for twice. */
import { text } from "./language";
import { fetchServed, openServed } from "./served";

/** The second time has to come within so long [ms]. */
export const SURE_MS = 4000;

export interface LeavingEvents {
  /** Sends the wish; false where the connection is lost. */
  leave(): boolean;
  notice(words: string): void;
  /** The button says something else. */
  changed(): void;
}

export class Leaving {
  private asked_ms = -Infinity;

  constructor(private readonly events: LeavingEvents) {}

  /** Once asked, and not yet too long ago. */
  isAsked(now_ms: number): boolean {
    return now_ms - this.asked_ms < SURE_MS;
  }

  press(canLeave: boolean, now_ms: number): void {
    if (!canLeave) {
      this.events.notice(text("end_nowhere"));
    } else if (!this.isAsked(now_ms)) {
      this.asked_ms = now_ms;
      this.events.notice(text("end_again"));
      setTimeout(() => this.events.changed(), SURE_MS);
    } else {
      this.asked_ms = -Infinity;
      if (this.events.leave()) this.events.notice(text("ending"));
    }
  }
}

/** Whether another page is served at this address, which is then loaded; null while nothing answers. */
export async function goesElsewhere(): Promise<boolean | null> {
  const served = await fetchServed();
  if (served === null) return null;
  if (served.page === "viewer") return false;
  openServed();
  return true;
}
