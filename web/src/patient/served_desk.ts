/** The steps of a server (crates/glisson-view/src/patient/api.rs). */
import { text } from "../language";
import { fetchServed, openServed } from "../served";
import type { Desk } from "./desk";
import type { Outline, PatientState, Step } from "./state";

const API = "/api/patient/";
/** How often it is looked for what comes after this page [ms]. */
const LOOK_MS = 250;

/** @throws Error with the server's words. */
async function asked(path: string, init?: RequestInit): Promise<Response> {
  const response = await fetch(API + path, init);
  if (!response.ok) throw new Error((await response.text()).trim() || `the server answers ${response.status}`);
  return response;
}

export class ServedDesk implements Desk {
  async state(): Promise<PatientState> {
    return (await asked("state")).json() as Promise<PatientState>;
  }

  async post(step: Step, choice: object): Promise<void> {
    await asked(step, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(choice) });
  }

  async send(files: readonly File[], tell: (done: number) => void): Promise<object> {
    const { upload } = (await (await asked("files", { method: "POST" })).json()) as { upload: number };
    for (const [number, file] of files.entries()) {
      await asked(`files/${upload}/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
      tell(number + 1);
    }
    return { upload };
  }

  async picture(name: string): Promise<string> {
    return `${API}pictures/${name}`;
  }

  async outlines(organ: string): Promise<readonly Outline[]> {
    return (await asked(`outlines/${encodeURIComponent(organ)}`)).json() as Promise<readonly Outline[]>;
  }

  /** Another page is served at this address in a moment. */
  async goOn(): Promise<void> {
    while (!(await this.isOver())) await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    openServed();
  }

  /** Another page may have started the simulation, or gone back. */
  async isOver(): Promise<boolean> {
    const served = await fetchServed();
    return served !== null && served.page !== "patient";
  }

  silence(): string {
    return text("patient_silent");
  }
}
