/** The program glisson, which is in GLISSON_PROGRAM, as a server. */
import { spawn, type ChildProcess } from "node:child_process";

export interface RunningProgram {
  readonly program: ChildProcess;
  readonly url: string;
  /** Of who teaches. */
  readonly teacherUrl: string;
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

/** The program in a folder of its own; its address when it answers. */
export async function serve(folder: string, command: readonly string[]): Promise<RunningProgram> {
  const child = spawn(process.env.GLISSON_PROGRAM!, [...command, "--no-open", "--port", "0"], { cwd: folder });
  return new Promise((resolve, reject) => {
    let text = "";
    const addresses = (): RegExpMatchArray[] => [...text.matchAll(/(http:\/\/\S+)\s/g)];
    const hear = (data: Buffer): void => {
      text += data.toString();
      const [url, teacherUrl] = addresses().map((match) => match[1]);
      if (teacherUrl !== undefined) resolve({ program: child, url, teacherUrl });
    };
    child.stdout.on("data", hear);
    child.stderr.on("data", hear);
    child.on("exit", (code) => reject(new Error(`glisson ${command[0]} ended with ${code}: ${text}`)));
  });
}

/** Ends it as Ctrl-C does. */
export async function stop(program: ChildProcess): Promise<void> {
  program.removeAllListeners("exit");
  const ended = new Promise((resolve) => program.once("exit", resolve));
  program.kill("SIGINT");
  await ended;
}
