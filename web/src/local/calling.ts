/** The program in WebAssembly (crates/glisson-web) and the files that it sees: in a Worker, or in Node for tests. */
import { ConsoleStdout, Directory, File, PreopenDirectory, WASI, type Inode } from "@bjorn3/browser_wasi_shim";

/** What every program gives. */
export interface Calls {
  readonly memory: WebAssembly.Memory;
  glisson_room(bytes: number): number;
  glisson_answer(): number;
  glisson_answer_bytes(): number;
}

const ERROR = -1;

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

/** What the program says of itself, such as the words of a panic. */
export class ProgramError extends Error {}

/** Puts files into a folder, with those that their paths name. */
function put(root: Directory, files: Files): void {
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
}

/** A place in the program's memory, which JavaScript takes for negative from 2 GiB on. */
const unsigned = (place: number): number => place >>> 0;

/** Hears how far long work is, 0 to 1, while it goes on. */
export type HearsShare = (share: number) => void;

/** How often it is told how far work is [ms]. */
const TELL_MS = 100;

/** Tells it now and then. */
export function nowAndThen(tell: HearsShare): HearsShare {
  let toldAt_ms = 0;
  return (share) => {
    const now_ms = performance.now();
    if (now_ms - toldAt_ms < TELL_MS) return;
    toldAt_ms = now_ms;
    tell(share);
  };
}

/** A program that was started, and its files. */
export interface Started<C extends Calls> {
  readonly calls: C;
  readonly root: Directory;
  /** What it printed, line by line. */
  readonly said: readonly string[];
}

export async function started<C extends Calls>(module: WebAssembly.Module, files: Files, hears: HearsShare = () => {}): Promise<Started<C>> {
  const said: string[] = [];
  const line = () => ConsoleStdout.lineBuffered((words) => said.push(words));
  const root = new PreopenDirectory("/", new Map<string, Inode>());
  put(root.dir, files);
  const wasi = new WASI([], [], [line(), line(), line(), root], { debug: false });
  const imports = { wasi_snapshot_preview1: wasi.wasiImport, env: absent, page: { glisson_progress: hears } };
  const instance = await WebAssembly.instantiate(module, imports);
  wasi.initialize(instance as Parameters<WASI["initialize"]>[0]);
  return { calls: instance.exports as unknown as C, root: root.dir, said };
}

/** Calls a program, and takes what it answers. */
export class Calling<C extends Calls> {
  /** What broke the program, which nothing can be done with after that. */
  private broke: ProgramError | null = null;

  constructor(private readonly program: Started<C>) {}

  get isBroken(): boolean {
    return this.broke !== null;
  }

  /** Calls; a trap of the program comes with its last words, then and whenever it is called again. */
  protected call<T>(call: (calls: C) => T): T {
    if (this.broke !== null) throw this.broke;
    try {
      return call(this.program.calls);
    } catch (error) {
      // From the panic that it told last on, or that there is no memory.
      const { said } = this.program;
      const from = said.findLastIndex((line) => /panicked|allocation/.test(line));
      this.broke = new ProgramError(from < 0 ? String(error) : said.slice(from).join(" "));
      throw this.broke;
    }
  }

  /** Text for the next call. */
  protected put(text: string): void {
    const bytes = new TextEncoder().encode(text);
    const at = unsigned(this.call((calls) => calls.glisson_room(bytes.length)));
    new Uint8Array(this.program.calls.memory.buffer, at, bytes.length).set(bytes);
  }

  protected answer(): Uint8Array<ArrayBuffer> {
    const { calls } = this.program;
    const [at, n] = [calls.glisson_answer(), calls.glisson_answer_bytes()].map(unsigned);
    return new Uint8Array(calls.memory.buffer as ArrayBuffer, at, n).slice();
  }

  protected text(): string {
    return new TextDecoder().decode(this.answer());
  }

  /** Calls what may answer an error. @throws ProgramError with its words */
  protected tryTo(call: (calls: C) => number): number {
    const kind = this.call(call);
    if (kind === ERROR) throw new ProgramError(this.text());
    return kind;
  }

  /** Puts files where the program sees them. */
  addFiles(files: Files): void {
    put(this.program.root, files);
  }

  /** The files in a folder, by their paths in it, and it is empty then. */
  takeFiles(folder: string): Files {
    const at = this.program.root.contents.get(folder);
    this.program.root.contents.delete(folder);
    const entries = at instanceof Directory ? [...at.contents] : [];
    return new Map(entries.flatMap(([name, entry]) => (entry instanceof File ? [[name, entry.data] as const] : [])));
  }
}
