/** Carries messages between the page and the simulation in its Worker. */
import type { Carrier, CarrierEvents } from "../connection";
import { text } from "../language";
import type { FromWorker, Start, ToWorker } from "./worker";
import { reasonOf } from "../reason";

export interface WorkerEvents {
  /** So much of the scene is made, 0 to 1. */
  making(share: number): void;
  /** The scene is made. */
  opened(): void;
  /** The simulation cannot begin, or go on. */
  failed(reason: string): void;
  /** What was recorded from this byte on. */
  recorded(session: Uint8Array, from: number): void;
}

export class WorkerCarrier implements Carrier {
  private isOpen = false;
  private waiting: (() => void)[] = [];
  private readers: { readonly read: (report: string) => void; readonly fail: (error: Error) => void }[] = [];

  /** `start` is asked for once the page listens. */
  constructor(private readonly worker: Worker, private readonly start: () => Promise<Start>, private readonly events: WorkerEvents) {}

  private tell(message: ToWorker, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  private fail(reason: string): void {
    this.isOpen = false;
    this.answerWaiting();
    this.failReaders(reason);
    this.events.failed(reason);
  }

  private failReaders(reason: string): void {
    for (const { fail } of this.readers.splice(0)) fail(new Error(reason));
  }

  private answerWaiting(): void {
    for (const answer of this.waiting.splice(0)) answer();
  }

  open(events: CarrierEvents): void {
    this.worker.onerror = (event) => this.fail(event.message || "its Worker did not start");
    this.worker.onmessageerror = () => this.fail("a message of its Worker could not be received");
    this.worker.onmessage = ({ data }: MessageEvent<FromWorker>) => {
      if ("share" in data) {
        this.events.making(data.share);
      } else if ("opened" in data) {
        this.isOpen = true;
        this.events.opened();
        events.opened();
      } else if ("says" in data) {
        this.hear(data.says, events);
      } else if ("session" in data) {
        if (data.session.length > 0) this.events.recorded(data.session, data.from);
        if (data.kept) this.answerWaiting();
      } else if ("report" in data) {
        for (const { read } of this.readers.splice(0)) read(data.report);
      } else if ("unreported" in data) {
        this.failReaders(data.unreported);
      } else {
        this.fail(data.failed);
      }
    };
    this.start()
      .then((start) => this.tell({ start }, [...start.files.values()].map((bytes) => bytes.buffer)))
      .catch((error: unknown) => this.fail(reasonOf(error)));
  }

  /** What goes wrong with a message of the page's is told by the page, and the others are heard all the same. */
  private hear(says: readonly (string | ArrayBuffer)[], events: CarrierEvents): void {
    for (const message of says) {
      try {
        events.message(message);
      } catch (error) {
        reportError(error);
      }
    }
    this.tell({ taken: true });
  }

  /** The page cannot be seen now, or can again: time stands still meanwhile. */
  hide(hidden: boolean): void {
    this.tell({ hidden });
  }

  /** Comes when all that happened up to now was recorded. */
  keep(): Promise<void> {
    if (!this.isOpen) return Promise.resolve();
    this.tell({ keep: true });
    return new Promise((resolve) => this.waiting.push(resolve));
  }

  report(): Promise<string> {
    if (!this.isOpen) return Promise.reject(new Error(text("local_over")));
    this.tell({ report: true });
    return new Promise((read, fail) => this.readers.push({ read, fail }));
  }

  send(message: string): boolean {
    if (this.isOpen) this.tell({ message });
    return this.isOpen;
  }

  /** Its Worker is its own. */
  async isElsewhere(): Promise<boolean> {
    return false;
  }
}
