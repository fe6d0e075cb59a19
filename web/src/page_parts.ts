/** What pages of one file have in them beside themselves, in elements of their own, and how one becomes another. */
import { base64OfBytes } from "./base64";

/** Undoes gzip. @throws where it is none */
export async function unpacked(packed: Uint8Array): Promise<Uint8Array> {
  const stream = new Blob([packed as BlobPart]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Base64 of what gzip makes of bytes. */
export async function packed(bytes: Uint8Array): Promise<string> {
  const stream = new Blob([bytes as BlobPart]).stream().pipeThrough(new CompressionStream("gzip"));
  return base64OfBytes(new Uint8Array(await new Response(stream).arrayBuffer()));
}

/** The letters of an element, which are not needed in the page any more then. */
export function taken(id: string): string {
  const element = document.getElementById(id);
  const letters = element?.textContent?.trim() ?? "";
  element?.remove();
  return letters;
}

/** A page with letters in an element that has nothing in it. @throws Error where there is no such element */
export function filled(page: string, id: string, letters: string): string {
  const begin = `<script id="${id}" type="application/octet-stream">`;
  const at = page.indexOf(begin);
  if (at < 0) throw new Error(`the page has no element ${id}`);
  return page.slice(0, at + begin.length) + letters + page.slice(at + begin.length);
}

/** Puts another page in the place of this one, with what the browser keeps for it. */
export function become(page: string): void {
  // Of the player: it would keep its recording.
  Reflect.deleteProperty(window, "glissonReplay");
  document.open();
  document.write(page);
  document.close();
}
