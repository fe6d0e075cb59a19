/** The simulation's program: in a Worker, or in Node for tests. */
import { Directory } from "@bjorn3/browser_wasi_shim";
import { Calling, ProgramError, started, type Calls, type Files, type HearsShare } from "./calling";
import { RecordingFile } from "./recording";

/** What the program gives. */
interface SimulationCalls extends Calls {
  glisson_open(demonstrates: number): number;
  glisson_take_over(step: number): number;
  glisson_hear(): number;
  glisson_turn(): number;
  glisson_tell(): number;
  glisson_next_message(): number;
  glisson_keep(): number;
  glisson_report(): number;
  glisson_open_run(): number;
  glisson_run(steps: number): number;
  glisson_arithmetic(): number;
  glisson_replay(): number;
}

const NOTHING = 0;
const FRAME = 2;

/** Where a session is recorded: the program writes into this file until it ends. */
const [SESSIONS, SESSION] = ["sessions", "session.jsonl"] as const;
const PARTIAL = `${SESSION}.partial`;

/** A message of the simulation to the page, as from a server. */
export type Message = string | ArrayBuffer;

export class Program extends Calling<SimulationCalls> {
  private readonly recording = new RecordingFile();

  static async start(module: WebAssembly.Module, files: Files, hears?: HearsShare): Promise<Program> {
    const running = await started<SimulationCalls>(module, files, hears);
    const program = new Program(running);
    running.root.contents.set(SESSIONS, new Directory(new Map([[PARTIAL, program.recording]])));
    return program;
  }

  /** Opens a scene file and records its session. */
  open(scene: string, demonstrates: boolean): void {
    this.put(`/${scene}\n/${SESSIONS}/${SESSION}`);
    this.tryTo((calls) => calls.glisson_open(demonstrates ? 1 : 0));
  }

  /** Goes on with a recorded session from a step on, and records it anew. */
  takeOver(session: string, step: number): void {
    this.put(`/${session}\n/${SESSIONS}/${SESSION}`);
    this.tryTo((calls) => calls.glisson_take_over(step));
  }

  /** A message of the page. */
  hear(message: string): void {
    this.put(message);
    this.tryTo((calls) => calls.glisson_hear());
  }

  /** Goes on until the clock is reached or a frame is due; how long there is nothing to do then [ms]. */
  turn(): number {
    const wait_ms = this.call((calls) => calls.glisson_turn());
    if (wait_ms < 0) throw new ProgramError(this.text());
    return wait_ms;
  }

  /** What the simulation says since it was asked last. */
  *messages(): Generator<Message> {
    this.tryTo((calls) => calls.glisson_tell());
    for (;;) {
      const kind = this.tryTo((calls) => calls.glisson_next_message());
      if (kind === NOTHING) return;
      yield kind === FRAME ? this.answer().buffer : this.text();
    }
  }

  /** Has all that happened recorded; what a trap left is recorded already. */
  keep(): void {
    this.tryTo((calls) => calls.glisson_keep());
  }

  /** The report of the task, as a page. */
  report(): string {
    this.tryTo((calls) => calls.glisson_report());
    return this.text();
  }

  /** What was recorded since it was taken last, and from which byte of the session on. */
  recorded(): { readonly bytes: Uint8Array; readonly from: number } {
    return this.recording.take();
  }

  /** Opens a scene without a page. */
  openRun(scene: string): void {
    this.put(`/${scene}`);
    this.tryTo((calls) => calls.glisson_open_run());
  }

  /** Makes steps of it along its paths; answers the hash of the state then. */
  run(steps: number): string {
    this.tryTo((calls) => calls.glisson_run(steps));
    return this.text();
  }

  /** How it rounds: "web_fused" or "web_separate". */
  arithmetic(): string {
    this.tryTo((calls) => calls.glisson_arithmetic());
    return this.text();
  }

  /** Replays a session: steps, hash of the state, hash that was recorded, first step that differs, check-points; "-" for what there is not. */
  replay(session: string): string[] {
    this.put(`/${session}`);
    this.tryTo((calls) => calls.glisson_replay());
    return this.text().split(" ");
  }
}
