/** What the program offers, and how it is asked to start something (crates/glisson-view/src/start). */

export interface TaskOffer {
  readonly name: string;
  readonly title: string;
  readonly about: string;
  readonly stages: readonly string[];
  readonly time_limit_s: number;
  /** Levels and the one that is usual; patients that it may be done with. */
  readonly levels: readonly string[];
  readonly level: string | null;
  readonly patients: readonly number[];
  readonly has_demonstration: boolean;
}

export interface SceneOffer {
  readonly file: string;
  readonly name: string | null;
  /** Title of its task. */
  readonly task: string | null;
  /** Why it cannot be read. */
  readonly error: string | null;
}

/** A session that was cut off. */
export interface SessionOffer {
  readonly session: string;
  readonly title: string;
  readonly time_s: number;
}

/** What the program can be asked for. */
export type Wanted = "task" | "scene" | "session" | "set_aside" | "patient" | "cancel";

export interface Offers {
  readonly tasks: readonly TaskOffer[];
  readonly sessions: readonly SessionOffer[];
  readonly scenes: readonly SceneOffer[];
  readonly folders: readonly string[];
  /** There may be more scenes. */
  readonly is_cut: boolean;
}

/** @throws Error with the program's words. */
export async function fetchOffers(): Promise<Offers> {
  const answer = await fetch("api/start", { cache: "no-store" });
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return (await answer.json()) as Offers;
}

/** Asks to start something. @throws Error with the program's words where it does not. */
export async function begin(what: Wanted, choice: object): Promise<void> {
  const headers = { "Content-Type": "application/json" };
  const answer = await fetch(`api/start/${what}`, { method: "POST", headers, body: JSON.stringify(choice) });
  if (!answer.ok) throw new Error((await answer.text()).trim());
}
