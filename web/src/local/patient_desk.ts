/** The steps of the page's own Worker: nothing leaves the page. */
import { text } from "../language";
import { download } from "../download";
import { become } from "../page_parts";
import type { Desk } from "../patient/desk";
import type { Outline, PatientState, Step } from "../patient/state";
import { reasonOf } from "../reason";
import type { Files } from "./calling";
import { Ended, PatientLink } from "./patient_link";
import { withStep, type StepDone } from "./steps_done";

/** Files of an image, and the Worker's folder for them. */
interface Upload {
  readonly files: readonly File[];
  readonly folder: string;
}

/** A step that goes on, or is taken back. */
interface Job {
  what: string;
  readonly since_ms: number;
  share: number;
  readonly is_cancelled: boolean;
}

/** The scene's file among those that the program writes. */
const SCENE = "scene.toml";

/** The name that a file has in its folder: two may come from different folders. */
function nameIn(taken: ReadonlySet<string>, file: File): string {
  const name = file.name.split(/[\\/]/).pop()!.replace(/^\.+/, "") || "file";
  for (let number = 1; ; number++) {
    const free = number === 1 ? name : `${number}_${name}`;
    if (!taken.has(free)) return free;
  }
}

/**
 * A Worker hears nothing while it does a step. So one that is cancelled ends it, and another Worker does again what was done before; the same
 * where a step broke it, as for want of memory.
 */
export class WorkerDesk implements Desk {
  private link: PatientLink;
  private job: Job | null = null;
  private error: string | null = null;
  /** Files that came and were not read yet, by the numbers that they came with. */
  private readonly uploads = new Map<number, Upload>();
  private nUploads = 0;
  /** What the image was read from. */
  private openedFrom: Upload | null = null;
  private stepsDone: StepDone[] = [];
  private lastState: PatientState | null = null;
  /** Its own numbers: those of the Worker begin anew with it. */
  private version = 0;
  private imageNumber = 0;
  /** The scene that was written, to be simulated. */
  private scene: Files | null = null;
  /** Comes when nothing is done again any more. */
  private again: Promise<void> = Promise.resolve();

  /** `simulatorWith`: the page of a simulation with these files, of which the scene has this name. */
  constructor(
    private readonly newWorker: () => Worker,
    private readonly module: Promise<WebAssembly.Module>,
    private readonly simulatorWith: (files: Files, scene: string) => Promise<string>,
  ) {
    this.link = this.newLink();
  }

  private newLink(): PatientLink {
    return new PatientLink(this.newWorker(), this.module, {
      what: (what) => {
        if (this.job?.is_cancelled === false) this.job.what = what;
      },
      share: (share) => {
        if (this.job !== null) this.job.share = share;
      },
      broke: (reason) => this.broke(reason),
    });
  }

  /** Whether something would be lost with the page. */
  get hasImage(): boolean {
    return this.openedFrom !== null;
  }

  private beginJob(what: string, is_cancelled = false): Job {
    const job = { what, since_ms: performance.now(), share: 0, is_cancelled };
    this.job = job;
    return job;
  }

  private endJob(job: Job): void {
    if (this.job === job) this.job = null;
  }

  /** That a Worker was ended is told by who ended it. */
  private tell(error: unknown): void {
    if (!(error instanceof Ended)) this.error = reasonOf(error);
  }

  private broke(reason: string): void {
    // What is done again breaks the next Worker, too: nothing is left of it.
    if (this.job?.is_cancelled === true) [this.openedFrom, this.stepsDone] = [null, []];
    this.beginAgain();
    this.error = reason;
  }

  /** Has another Worker do again what was done. */
  private beginAgain(): void {
    this.link.end();
    this.link = this.newLink();
    const job = this.beginJob(this.job?.what ?? text("patient_beginning"), true);
    this.again = this.doAgain(this.link)
      .catch((error: unknown) => this.tell(error))
      .finally(() => {
        this.version += 1;
        this.endJob(job);
      });
  }

  private async doAgain(link: PatientLink): Promise<void> {
    if (this.openedFrom !== null) await handOver(link, this.openedFrom);
    for (const { name, choice } of this.stepsDone) await link.ask({ ask: "step", name, choice: JSON.stringify(choice) });
    await this.forgetUnneeded(link, []);
  }

  async state(): Promise<PatientState> {
    // What is asked while a step goes on is answered after it.
    if (this.job === null || this.lastState === null) this.lastState = await stateOf(this.link);
    const { job, error, version, imageNumber } = this;
    const running = job && { what: job.what, seconds: (performance.now() - job.since_ms) / 1e3, share: job.share, is_cancelled: job.is_cancelled };
    return { ...this.lastState, version, image_number: imageNumber, job: running, error, started: this.scene !== null, can_leave: false };
  }

  async post(name: Step, choice: object): Promise<void> {
    if (name === "cancel") {
      if (this.job?.is_cancelled === false) this.beginAgain();
      return;
    }
    const job = this.newJob();
    this.doStep(name, choice)
      .catch((error: unknown) => this.tell(error))
      .finally(() => this.endJob(job));
  }

  /** @throws Error where something goes on */
  private newJob(): Job {
    if (this.scene !== null) throw new Error(text("patient_starting"));
    if (this.job !== null) throw new Error(text("patient_still", { what: this.job.what }));
    this.error = null;
    return this.beginJob(text("patient_beginning"));
  }

  private async doStep(name: Step, choice: object): Promise<void> {
    if (name === "open") {
      await this.open(choice as { upload?: number; series?: number });
    } else if (name === "start") {
      this.scene = await this.written(choice);
    } else {
      await this.link.ask({ ask: "step", name, choice: JSON.stringify(choice) });
      this.stepsDone = withStep(this.stepsDone, { name, choice });
      this.version += 1;
    }
  }

  private async written(choice: object): Promise<Files> {
    return (await this.link.ask({ ask: "write", choice: JSON.stringify(choice) })) as Files;
  }

  /** Reads files that came, or another series of those that were read. */
  private async open({ upload, series }: { upload?: number; series?: number }): Promise<void> {
    const { link } = this;
    const sent = upload === undefined ? undefined : this.uploads.get(upload);
    const from = sent ?? this.openedFrom;
    const choice = { folder: `/${from?.folder ?? ""}`, series };
    // Those of earlier ones that were refused go, too.
    this.uploads.clear();
    try {
      if (sent !== undefined) await handOver(link, sent, (words, share) => this.job !== null && ([this.job.what, this.job.share] = [words, share]));
      await link.ask({ ask: "step", name: "open", choice: JSON.stringify(choice) });
    } catch (error) {
      if (sent !== undefined) await link.ask({ ask: "forget", folder: sent.folder });
      throw error;
    }
    const before = this.openedFrom;
    [this.openedFrom, this.stepsDone] = [from, withStep([], { name: "open", choice })];
    await this.forgetUnneeded(link, sent !== undefined && before !== null ? [before] : []);
    this.version += 1;
    this.imageNumber += 1;
  }

  /** What is not read again need not be there twice. */
  private async forgetUnneeded(link: PatientLink, uploads: Upload[]): Promise<void> {
    const { series } = await stateOf(link);
    if (series.length === 0 && this.openedFrom !== null) uploads.push(this.openedFrom);
    for (const { folder } of uploads) await link.ask({ ask: "forget", folder });
  }

  async send(files: readonly File[], tell: (done: number) => void): Promise<object> {
    this.nUploads += 1;
    this.uploads.set(this.nUploads, { files, folder: `incoming-${this.nUploads}` });
    tell(files.length);
    return { upload: this.nUploads };
  }

  async picture(name: string): Promise<string> {
    await this.again;
    const png = (await this.link.ask({ ask: "picture", name: name.split("?")[0]! })) as Uint8Array<ArrayBuffer>;
    return URL.createObjectURL(new Blob([png], { type: "image/png" }));
  }

  async outlines(organ: string): Promise<readonly Outline[]> {
    await this.again;
    return JSON.parse((await this.link.ask({ ask: "outlines", organ })) as string) as readonly Outline[];
  }

  async goOn(): Promise<void> {
    const { scene } = this;
    try {
      const page = await this.simulatorWith(scene!, SCENE);
      this.link.end();
      become(page);
    } catch (error) {
      this.scene = null;
      this.tell(error);
    }
  }

  async isOver(): Promise<boolean> {
    return false;
  }

  silence(error: unknown): string {
    return reasonOf(error);
  }

  async save(choice: object): Promise<void> {
    const job = this.newJob();
    try {
      const page = await this.simulatorWith(await this.written(choice), SCENE);
      download(new Blob([page], { type: "text/html" }), "patient.html");
    } finally {
      this.endJob(job);
    }
  }
}

async function stateOf(link: PatientLink): Promise<PatientState> {
  return JSON.parse((await link.ask({ ask: "state" })) as string) as PatientState;
}

/** Gives files to a Worker, one by one: a long scan need not be there twice. */
async function handOver(link: PatientLink, { files, folder }: Upload, tell: (words: string, share: number) => void = () => {}): Promise<void> {
  const names = new Set<string>();
  for (const [number, file] of files.entries()) {
    tell(text("patient_sending", { done: number + 1, n: files.length }), number / files.length);
    const name = nameIn(names, file);
    names.add(name);
    const bytes = new Uint8Array(await file.arrayBuffer());
    await link.ask({ ask: "files", files: new Map([[`${folder}/${name}`, bytes]]) }, [bytes.buffer]);
  }
}
