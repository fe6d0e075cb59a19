/** Starts the program in GLISSON_PROGRAM, and ends it. */
import { spawn, type ChildProcess } from "node:child_process";

export const program = process.env.GLISSON_PROGRAM;

export interface ServedProgram {
  readonly url: string;
  /** Of who teaches, where the page has one. */
  readonly teacherUrl: Promise<string>;
  /** Ends it as Ctrl-C does, and waits for that. */
  stop(): Promise<void>;
}

/** A scene that is made at once. */
export const BLOCK = `glisson_scene = 1
name = "a block"
[simulation]
time_step = "4 ms"
[organ]
box = { min = ["-5 cm", "0 cm", "-5 cm"], max = ["5 cm", "4 cm", "5 cm"] }
edge = "15 mm"
tissue = "liver"
model = "precomputed"
[[organ.fixed]]
furthest = { direction = [0, 1, 0], fraction = 0.2 }
[tool]
tip_radius = "5 mm"
home_tip = [0, "-40 mm", 0]
home_shaft = [0, -1, 0]
`;

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
    let tell: (url: string) => void;
    const teacherUrl = new Promise<string>((told) => (tell = told));
    const hear = (data: Buffer): void => {
      text += data.toString();
      const [url, ofTeacher] = [...text.matchAll(/(http:\/\/\S+)\s/g)].map((match) => match[1]);
      if (url !== undefined) resolve({ url, teacherUrl, stop });
      if (ofTeacher !== undefined) tell(ofTeacher);
    };
    child.stdout!.on("data", hear);
    child.stderr!.on("data", hear);
    child.on("exit", (code) => reject(new Error(`glisson ${verb.join(" ")} ended with ${code}: ${text}`)));
  });
}
