/** The simulation's program (crates/glisson-web) and the files that it sees: in a Worker, or in Node for tests. */
import { ConsoleStdout, Directory, File, PreopenDirectory, WASI, type Inode } from "@bjorn3/browser_wasi_shim";
import { RecordingFile } from "./recording";

/** What the program gives and takes. */
interface Calls {
  readonly memory: WebAssembly.Memory;
  glisson_room(bytes: number): number;
  glisson_answer(): number;
  glisson_answer_bytes(): number;
  glisson_open(demonstrates: number): number;
  glisson_hear(): number;
  glisson_turn(): number;
  glisson_tell(): number;
  glisson_next_message(): number;
  glisson_keep(): number;
  glisson_open_run(): number;
  glisson_run(steps: number): number;
  glisson_arithmetic(): number;
  glisson_replay(): number;
}

const ERROR = -1;
const NOTHING = 0;
const FRAME = 2;

/** Threads cannot be started: "not supported", as a C library without them answers. */
const ENOTSUP = 58;

/** What the C library of some toolchains lacks: it is only asked for where a thread is started, or a path without links is wanted. */
const absent = {
  realpath: () => 0,
  pthread_attr_init: () => 0,
  pthread_attr_setstacksize: () => 0,
  pthread_attr_destroy: () => 0,
  pthread_create: () => ENOTSUP,
  pthread_join: () => ENOTSUP,
  pthread_detach: () => ENOTSUP,
};

/** Files by their paths, without a slash at the beginning. */
export type Files = ReadonlyMap<string, Uint8Array>;

/** Where a session is recorded: the program writes into this file until it ends. */
const [SESSIONS, SESSION] = ["sessions", "session.jsonl"] as const;
const PARTIAL = `${SESSION}.partial`;

/** What the program says of itself, such as the words of a panic. */
export class ProgramError extends Error {}

function folderOf(files: Files): Map<string, Inode> {
  const root = new Directory(new Map());
  for (const [path, data] of files) {
    const parts = path.split("/");
    const name = parts.pop()!;
    let at = root;
    for (const part of parts) {
      const next = at.contents.get(part) ?? new Directory(new Map());
      at.contents.set(part, next);
      at = next as Directory;
    }
    at.contents.set(name, new File(data));
  }
  return root.contents;
}

/** A place in the program's memory, which JavaScript takes for negative from 2 GiB on. */
const unsigned = (place: number): number => place >>> 0;

/** A message of the simulation to the page, as from a server. */
export type Message = string | ArrayBuffer;

export class Program {
  private constructor(
    private readonly calls: Calls,
    private readonly recording: RecordingFile,
    private readonly said: string[],
  ) {}

  /** `said`: what the program prints, line by line. */
  static async start(module: WebAssembly.Module, files: Files): Promise<Program> {
    const said: string[] = [];
    const hears = () => ConsoleStdout.lineBuffered((line) => said.push(line));
    const recording = new RecordingFile();
    const root = new PreopenDirectory("/", folderOf(files));
    root.dir.contents.set(SESSIONS, new Directory(new Map([[PARTIAL, recording]])));
    const wasi = new WASI([], [], [hears(), hears(), hears(), root], { debug: false });
    const instance = await WebAssembly.instantiate(module, { wasi_snapshot_preview1: wasi.wasiImport, env: absent });
    wasi.initialize(instance as Parameters<WASI["initialize"]>[0]);
    return new Program(instance.exports as unknown as Calls, recording, said);
  }

  /** Calls; a trap of the program, which nothing can be done with after it, comes with its last words. */
  private call<T>(call: (calls: Calls) => T): T {
    try {
      return call(this.calls);
    } catch (error) {
      // From the panic that it told last on, or that there is no memory.
      const from = this.said.findLastIndex((line) => /panicked|allocation/.test(line));
      throw new ProgramError(from < 0 ? String(error) : this.said.slice(from).join(" "));
    }
  }

  private put(text: string): void {
    const bytes = new TextEncoder().encode(text);
    const at = unsigned(this.call((calls) => calls.glisson_room(bytes.length)));
    new Uint8Array(this.calls.memory.buffer, at, bytes.length).set(bytes);
  }

  private answer(): Uint8Array {
    const [at, n] = [this.calls.glisson_answer(), this.calls.glisson_answer_bytes()].map(unsigned);
    return new Uint8Array(this.calls.memory.buffer, at, n).slice();
  }

  private text(): string {
    return new TextDecoder().decode(this.answer());
  }

  private orThrow(kind: number): void {
    if (kind === ERROR) throw new ProgramError(this.text());
  }

  /** Opens a scene file and records its session. */
  open(scene: string, demonstrates: boolean): void {
    this.put(`/${scene}\n/${SESSIONS}/${SESSION}`);
    this.orThrow(this.call((calls) => calls.glisson_open(demonstrates ? 1 : 0)));
  }

  /** A message of the page. */
  hear(message: string): void {
    this.put(message);
    this.orThrow(this.call((calls) => calls.glisson_hear()));
  }

  /** Goes on until the clock is reached or a frame is due; how long there is nothing to do then [ms]. */
  turn(): number {
    const wait_ms = this.call((calls) => calls.glisson_turn());
    if (wait_ms < 0) throw new ProgramError(this.text());
    return wait_ms;
  }

  /** What the simulation says since it was asked last. */
  *messages(): Generator<Message> {
    this.orThrow(this.call((calls) => calls.glisson_tell()));
    for (;;) {
      const kind = this.call((calls) => calls.glisson_next_message());
      this.orThrow(kind);
      if (kind === NOTHING) return;
      yield kind === FRAME ? (this.answer().buffer as ArrayBuffer) : this.text();
    }
  }

  /** Has all that happened recorded; what a trap left is recorded already. */
  keep(): void {
    this.orThrow(this.call((calls) => calls.glisson_keep()));
  }

  /** What was recorded since it was taken last, and from which byte of the session on. */
  recorded(): { readonly bytes: Uint8Array; readonly from: number } {
    return this.recording.take();
  }

  /** Opens a scene without a page. */
  openRun(scene: string): void {
    this.put(`/${scene}`);
    this.orThrow(this.call((calls) => calls.glisson_open_run()));
  }

  /** Makes steps of it along its paths; answers the hash of the state then. */
  run(steps: number): string {
    this.orThrow(this.call((calls) => calls.glisson_run(steps)));
    return this.text();
  }

  /** How it rounds: "web_fused" or "web_separate". */
  arithmetic(): string {
    this.orThrow(this.call((calls) => calls.glisson_arithmetic()));
    return this.text();
  }

  /** Replays a session: steps, hash of the state, hash that was recorded, first step that differs, check-points; "-" for what there is not. */
  replay(session: string): string[] {
    this.put(`/${session}`);
    this.orThrow(this.call((calls) => calls.glisson_replay()));
    return this.text().split(" ");
  }
}
