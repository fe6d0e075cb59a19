/** What is in the page beside the page itself: the program, and what `glisson export` put into it. */
import { text } from "../language";
import { bytesOfBase64 } from "../base64";
import { filled, packed, taken, unpacked } from "../page_parts";
import type { Files } from "./calling";
import { unfused } from "./unfused";

/** A scene, or a recorded session, and its files. */
export interface Exported {
  /** Name of the file that it begins with: of a session's, where the page has a step of it to begin with. */
  readonly scene: string;
  readonly files: Files;
}

/** The program's letters: they are taken out of the page, and may go into another one. */
export const programLetters = (): string => taken("program");

/** The program, compiled. @throws Error where the browser does not take it */
export async function compiled(letters: string): Promise<WebAssembly.Module> {
  const program = await unpacked(bytesOfBase64(letters));
  for (const bytes of [program, unfused(program)]) {
    if (WebAssembly.validate(bytes as BufferSource)) return WebAssembly.compile(bytes as BufferSource);
  }
  throw new Error(text("local_no_simd"));
}

/** The scene in the page. @throws where it has none */
export async function sceneInPage(): Promise<Exported> {
  const { scene, files } = JSON.parse(taken("scene-files")) as { scene: string; files: Record<string, string> };
  const all = Object.entries(files).map(async ([name, letters]) => [name, await unpacked(bytesOfBase64(letters))] as const);
  return { scene, files: new Map(await Promise.all(all)) };
}

/** The step of the session to begin with, where the page has one. */
export function stepInPage(): number | null {
  const step = taken("take-over");
  return step === "" ? null : Number(step);
}

/** The page of a simulation, which is in this one without the program and a scene. */
export async function emptySimulator(): Promise<string> {
  return new TextDecoder().decode(await unpacked(bytesOfBase64(taken("simulator"))));
}

/** The page of a simulation with a program and a scene, as `glisson export` makes it. */
export async function simulatorWith(empty: string, program: string, { scene, files }: Exported): Promise<string> {
  const letters = await Promise.all([...files].map(async ([name, bytes]) => [name, await packed(bytes)] as const));
  // Names may hold what would end the element.
  const exported = JSON.stringify({ scene, files: Object.fromEntries(letters) }).replaceAll("<", "\\u003c");
  return filled(filled(empty, "program", program), "scene-files", exported);
}
