/** Brings a new patient in beside the page: does one thing after the other, and hears of nothing else meanwhile. */
import { nowAndThen, type Files } from "./calling";
import { PatientProgram } from "./patient_program";
import { reasonOf } from "../reason";

/** What the page asks of it. */
export type PatientAsk =
  | { readonly ask: "begin"; readonly module: WebAssembly.Module }
  | { readonly ask: "files"; readonly files: Files }
  | { readonly ask: "forget"; readonly folder: string }
  | { readonly ask: "step"; readonly name: string; readonly choice: string }
  | { readonly ask: "state" }
  | { readonly ask: "picture"; readonly name: string }
  | { readonly ask: "outlines"; readonly organ: string }
  | { readonly ask: "write"; readonly choice: string };

/** What it answers: nothing, JSON, a picture, or files. */
export type PatientAnswer = null | string | Uint8Array<ArrayBuffer> | Files;

/** From it: the answer to a question, or why there is none (`broke`: and why nothing can be asked of it any more); what a step is, and how far it is. */
export type FromPatientWorker =
  | { readonly answer: PatientAnswer }
  | { readonly error: string; readonly broke: boolean }
  | { readonly what: string }
  | { readonly share: number };

const post = (message: FromPatientWorker, transfer: Transferable[] = []): void => self.postMessage(message, { transfer });

let program: PatientProgram | null = null;
const hears = nowAndThen((share) => post({ share }));

async function answer(asked: PatientAsk): Promise<PatientAnswer> {
  if (asked.ask === "begin") {
    program = await PatientProgram.start(asked.module, hears);
    return null;
  }
  if (program === null) throw new Error("it was not started");
  switch (asked.ask) {
    case "files":
      program.addFiles(asked.files);
      return null;
    case "forget":
      program.takeFiles(asked.folder);
      return null;
    case "step":
      post({ what: program.prepare(asked.name, asked.choice) });
      program.run();
      return null;
    case "state":
      return program.state();
    case "picture":
      return program.picture(asked.name);
    case "outlines":
      return program.outlines(asked.organ);
    case "write":
      post({ what: program.prepare("start", asked.choice) });
      program.run();
      return program.takeScene();
  }
}

self.onmessage = ({ data }: MessageEvent<PatientAsk>): void => {
  answer(data).then(
    (answer) => post({ answer }, answer instanceof Uint8Array ? [answer.buffer] : []),
    (error: unknown) => post({ error: reasonOf(error), broke: program?.isBroken ?? true }),
  );
};
