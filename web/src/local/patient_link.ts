/** What the page asks of the Worker that brings a patient in: one question after the other, each with its answer. */
import type { FromPatientWorker, PatientAnswer, PatientAsk } from "./patient_worker";

/** What is told while a step goes on, and that nothing can be asked any more. */
export interface LinkEvents {
  what(what: string): void;
  share(share: number): void;
  broke(reason: string): void;
}

/** The Worker was ended: there is nobody to answer. */
export class Ended extends Error {}

interface Waiting {
  readonly resolve: (answer: PatientAnswer) => void;
  readonly reject: (reason: Error) => void;
}

export class PatientLink {
  /** Questions that were not answered, in turn. */
  private waiting: Waiting[] = [];
  private isOver = false;

  private readonly ready: Promise<unknown>;

  constructor(private readonly worker: Worker, module: Promise<WebAssembly.Module>, private readonly events: LinkEvents) {
    worker.onmessage = ({ data }: MessageEvent<FromPatientWorker>) => this.hear(data);
    worker.onerror = (event) => this.breakOff(event.message || "the page's Worker did not start");
    worker.onmessageerror = () => this.breakOff("an answer of the page's Worker could not be received");
    this.ready = module.then((module) => this.post({ ask: "begin", module }, []));
    // Who asks is told.
    this.ready.catch(() => {});
  }

  private hear(said: FromPatientWorker): void {
    if ("share" in said) {
      this.events.share(said.share);
    } else if ("what" in said) {
      this.events.what(said.what);
    } else if ("answer" in said) {
      this.waiting.shift()?.resolve(said.answer);
    } else if (said.broke) {
      this.breakOff(said.error);
    } else {
      this.waiting.shift()?.reject(new Error(said.error));
    }
  }

  private breakOff(reason: string): void {
    if (this.isOver) return;
    this.end();
    this.events.broke(reason);
  }

  private post(asked: PatientAsk, transfer: Transferable[]): Promise<PatientAnswer> {
    if (this.isOver) return Promise.reject(new Ended());
    return new Promise((resolve, reject) => {
      this.waiting.push({ resolve, reject });
      this.worker.postMessage(asked, transfer);
    });
  }

  /** Asks, once the Worker has begun. @throws Error with its words, or why it did not begin; Ended where it was ended */
  async ask(asked: PatientAsk, transfer: Transferable[] = []): Promise<PatientAnswer> {
    await this.ready;
    return this.post(asked, transfer);
  }

  /** Ends the Worker, whatever it does; nothing that was asked is answered. */
  end(): void {
    this.isOver = true;
    this.worker.terminate();
    for (const { reject } of this.waiting.splice(0)) reject(new Ended());
  }
}
