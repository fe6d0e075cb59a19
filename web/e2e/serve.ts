/** Starts the program in GLISSON_PROGRAM, and ends it. */
import { spawn, type ChildProcess } from "node:child_process";

export const program = process.env.GLISSON_PROGRAM;

export interface ServedProgram {
  readonly url: string;
  /** Ends it as Ctrl-C does, and waits for that. */
  stop(): Promise<void>;
}

/** A verb that serves a page; its address when it answers. */
export async function serveProgram(verb: readonly string[], cwd?: string): Promise<ServedProgram> {
  const child: ChildProcess = spawn(program!, [...verb, "--no-open", "--port", "0"], { cwd });
  const stop = async (): Promise<void> => {
    child.removeAllListeners("exit");
    const gone = new Promise<void>((resolve) => (child.exitCode === null ? child.once("exit", () => resolve()) : resolve()));
    child.kill("SIGINT");
    await gone;
  };
  return new Promise((resolve, reject) => {
    let text = "";
    const hear = (data: Buffer): void => {
      text += data.toString();
      const url = /http:\/\/\S+/.exec(text)?.[0];
      if (url !== undefined) resolve({ url, stop });
    };
    child.stdout!.on("data", hear);
    child.stderr!.on("data", hear);
    child.on("exit", (code) => reject(new Error(`glisson ${verb.join(" ")} ended with ${code}: ${text}`)));
  });
}
