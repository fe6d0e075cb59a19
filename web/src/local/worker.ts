/** The simulation of a page that has it in itself: steps beside the page, and says and hears what a server would. */
import { nowAndThen, type Files } from "./calling";
import { Program, type Message } from "./program";
import { reasonOf } from "../reason";

/** With a scene, whose paths instruments may follow, or with a recorded session from a step on; each is named among the files. */
export type Beginning =
  | { readonly scene: string; readonly demonstrates: boolean }
  | { readonly session: string; readonly step: number };

/** How it begins: the program, and the files that it sees. */
export interface Start {
  readonly module: WebAssembly.Module;
  readonly files: Files;
  readonly begins: Beginning;
  /** Whether the page is hidden. */
  readonly hidden: boolean;
}

/** To the Worker: how it begins, a message to the simulation, that what came was taken, whether the page is hidden, to keep the session, or to report on the task. */
export type ToWorker =
  | { readonly start: Start }
  | { readonly message: string }
  | { readonly taken: true }
  | { readonly hidden: boolean }
  | { readonly keep: true }
  | { readonly report: true };

/** From it: how much of the scene is made, that it is open, what the simulation says, how its session goes on (`kept`: as it was asked for), the task's report or why there is none, or why it ended. */
export type FromWorker =
  | { readonly share: number }
  | { readonly opened: true }
  | { readonly says: readonly Message[] }
  | { readonly session: Uint8Array; readonly from: number; readonly kept: boolean }
  | { readonly report: string }
  | { readonly unreported: string }
  | { readonly failed: string };

/** States under way to a page that has not taken them yet, at most. */
const MOST_UNTAKEN = 2;
/** How often the page gets what was recorded [ms]. */
const KEEP_MS = 1000;

const post = (message: FromWorker, transfer: Transferable[] = []): void => self.postMessage(message, { transfer });

let program: Program | null = null;
let nUntaken = 0;
let keptAt_ms = 0;
/** Whether the page asked for a pause. */
let isPaused = false;
let isHidden = false;
/** Whether a turn is to come. */
let isScheduled = false;

/** A task as soon as what has come was heard: a timer would wait for some milliseconds. */
const soon = new MessageChannel();
soon.port1.onmessage = turn;

function schedule(wait_ms: number): void {
  if (isScheduled) return;
  isScheduled = true;
  if (wait_ms < 0.5) soon.port2.postMessage(null);
  else setTimeout(turn, wait_ms);
}

/** `kept`: the page asked for it, and is answered also where there is nothing new. */
function keepSession(program: Program, kept: boolean): void {
  const { bytes, from } = program.recorded();
  if (bytes.length > 0 || kept) post({ session: bytes, from, kept }, [bytes.buffer]);
}

function fail(error: unknown): void {
  if (program !== null) keepSession(program, false);
  program = null;
  post({ failed: reasonOf(error) });
}

/** Does something with the simulation; what goes wrong ends it. */
function attempt(act: (program: Program) => void): void {
  if (program === null) return;
  try {
    act(program);
  } catch (error) {
    fail(error);
  }
}

function turn(): void {
  isScheduled = false;
  if (isHidden) return;
  attempt((program) => {
    const wait_ms = program.turn();
    tell(program);
    const now_ms = performance.now();
    if (now_ms - keptAt_ms > KEEP_MS) {
      keptAt_ms = now_ms;
      keepSession(program, false);
    }
    schedule(wait_ms);
  });
}

function tell(program: Program): void {
  if (nUntaken >= MOST_UNTAKEN) return;
  const says = [...program.messages()];
  if (says.length === 0) return;
  nUntaken += 1;
  post({ says }, says.filter((message) => typeof message !== "string"));
}

async function start({ module, files, begins, hidden }: Start): Promise<void> {
  // It may change while the scene is made.
  isHidden = hidden;
  const making = nowAndThen((share) => post({ share }));
  const fresh = await Program.start(module, files, (share) => {
    if (program === null) making(share);
  });
  if ("scene" in begins) fresh.open(begins.scene, begins.demonstrates);
  else {
    fresh.takeOver(begins.session, begins.step);
    isPaused = true;
  }
  program = fresh;
  post({ opened: true });
  hide(isHidden);
}

function hear(program: Program, message: string): void {
  const { type, paused } = JSON.parse(message) as { type: string; paused?: boolean };
  if (type === "pause") isPaused = paused === true;
  else if (type === "single_step") isPaused = true;
  program.hear(message);
}

const pause = (paused: boolean): string => JSON.stringify({ type: "pause", paused });

/** That there is none yet ends nothing. */
function reportOf(program: Program): FromWorker {
  try {
    return { report: program.report() };
  } catch (error) {
    if (program.isBroken) throw error;
    return { unreported: reasonOf(error) };
  }
}

/** Browsers slow a hidden page down as they like: time stands still, and what was recorded is kept. */
function hide(hidden: boolean): void {
  isHidden = hidden;
  attempt((program) => {
    if (hidden) {
      program.hear(pause(true));
      program.turn();
      program.keep();
      keepSession(program, false);
    } else {
      // With the clock as it is now.
      program.turn();
      program.hear(pause(isPaused));
      schedule(0);
    }
  });
}

self.onmessage = ({ data }: MessageEvent<ToWorker>): void => {
  if ("start" in data) start(data.start).catch(fail);
  else if ("taken" in data) nUntaken -= 1;
  else if ("hidden" in data) hide(data.hidden);
  else if ("keep" in data) {
    attempt((program) => {
      program.keep();
      keepSession(program, true);
    });
  } else if ("report" in data) attempt((program) => post(reportOf(program)));
  else attempt((program) => hear(program, data.message));
};
self.onmessageerror = () => fail(new Error("a message to the simulation could not be received"));
