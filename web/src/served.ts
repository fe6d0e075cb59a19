/** What is served at this page's address now: the start page, the page for a new patient, or a simulation's viewer. */

/** What is being started. */
export interface Making {
  readonly what: string;
  readonly seconds: number;
  readonly share: number;
  readonly is_cancelled: boolean;
}

export type Served =
  | { readonly page: "start"; readonly job: Making | null; readonly error: string | null; readonly is_ready: boolean }
  | { readonly page: "viewer" | "patient" };

/** Null while nothing answers: between two pages nobody listens for a moment. */
export async function fetchServed(): Promise<Served | null> {
  try {
    const answer = await fetch("api/page", { cache: "no-store" });
    return answer.ok ? ((await answer.json()) as Served) : null;
  } catch {
    return null;
  }
}

/** Loads the page that is served here now. */
export function openServed(): void {
  window.location.replace("./");
}
