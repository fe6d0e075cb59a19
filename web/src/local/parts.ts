/** What `glisson export` put into the page beside the page itself. */
import { text } from "../language";
import { bytesOfBase64 } from "../replay/page";
import type { Files } from "./program";
import { unfused } from "./unfused";

/** A scene and its files, compressed each. */
export interface Exported {
  /** Name of the scene's file. */
  readonly scene: string;
  readonly files: Files;
}

/** Undoes gzip. @throws where it is none */
export async function unpacked(packed: Uint8Array): Promise<Uint8Array> {
  const stream = new Blob([packed as BlobPart]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The letters of an element, which are not needed any more then. */
function taken(id: string): string {
  const element = document.getElementById(id);
  const letters = element?.textContent?.trim() ?? "";
  element?.remove();
  return letters;
}

/** The simulation's program, compiled. @throws Error where the browser does not take it */
export async function programInPage(): Promise<WebAssembly.Module> {
  const program = await unpacked(bytesOfBase64(taken("program")));
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
