/** Who does the steps that the page asks for: a server, or the page's own Worker. */
import type { Outline, PatientState, Step } from "./state";

export interface Desk {
  state(): Promise<PatientState>;
  /** Begins a step, or cancels the one that runs. @throws Error with the words of who refuses it */
  post(step: Step, choice: object): Promise<void>;
  /** Takes the files of an image; answers what "open" is asked with. */
  send(files: readonly File[], tell: (done: number) => void): Promise<object>;
  /** Where a picture is found. */
  picture(name: string): Promise<string>;
  /** The outlines that an organ was made from. */
  outlines(organ: string): Promise<readonly Outline[]>;
  /** What comes after this page takes its place as soon as it is there. */
  goOn(): Promise<void>;
  /** Whether something else is in this page's place, where nothing is heard. */
  isOver(): Promise<boolean>;
  /** What is said where nothing is heard. */
  silence(error: unknown): string;
  /** Saves the simulation as a file, where that can be. */
  readonly save?: (choice: object) => Promise<void>;
}
