/** The program that brings a new patient in, step by step. */
import { Calling, started, type Calls, type Files, type HearsShare } from "./calling";

interface PatientCalls extends Calls {
  glisson_patient(): number;
  glisson_patient_prepare(): number;
  glisson_patient_run(): number;
  glisson_patient_picture(): number;
  glisson_patient_outlines(): number;
}

/** Where it writes the scene and its files. */
const SCENES = "patient";

export class PatientProgram extends Calling<PatientCalls> {
  static async start(module: WebAssembly.Module, hears: HearsShare): Promise<PatientProgram> {
    return new PatientProgram(await started<PatientCalls>(module, new Map(), hears));
  }

  private asked(text: string, call: (calls: PatientCalls) => number): void {
    this.put(text);
    this.tryTo(call);
  }

  /** How far the patient is, in JSON. */
  state(): string {
    this.tryTo((calls) => calls.glisson_patient());
    return this.text();
  }

  /** Has a step ready; answers what is said while it goes on. */
  prepare(name: string, choice: string): string {
    this.asked(`${name}\n${choice}`, (calls) => calls.glisson_patient_prepare());
    return this.text();
  }

  /** Does it. */
  run(): void {
    this.tryTo((calls) => calls.glisson_patient_run());
  }

  /** A picture, as PNG. */
  picture(name: string): Uint8Array<ArrayBuffer> {
    this.asked(name, (calls) => calls.glisson_patient_picture());
    return this.answer();
  }

  /** The outlines of an organ, in JSON. */
  outlines(organ: string): string {
    this.asked(organ, (calls) => calls.glisson_patient_outlines());
    return this.text();
  }

  /** The scene that was written, and its files. */
  takeScene(): Files {
    return this.takeFiles(SCENES);
  }
}
