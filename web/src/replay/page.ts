/** The fixed parts of replay.html. */
export interface ReplayPage {
  readonly scene: HTMLCanvasElement;
  readonly orientation: HTMLCanvasElement;
  readonly panel: HTMLElement;
  readonly messages: HTMLElement;
  readonly bodies: HTMLElement;
  readonly story: HTMLElement;
  readonly transport: HTMLElement;
  readonly timeline: HTMLElement;
  readonly toolbar: HTMLElement;
  readonly hint: HTMLElement;
  readonly outside: HTMLElement;
}

function part<T extends HTMLElement>(id: string): T {
  const node = document.getElementById(id);
  if (node === null) throw new Error(`replay.html has no element "${id}"`);
  return node as T;
}

/** @throws Error naming a part that the page does not have. */
export function findReplayPage(): ReplayPage {
  return {
    scene: part("scene"),
    orientation: part("orientation"),
    panel: part("panel"),
    messages: part("messages"),
    bodies: part("bodies"),
    story: part("story"),
    transport: part("transport"),
    timeline: part("timeline"),
    toolbar: part("toolbar"),
    hint: part("hint"),
    outside: part("outside"),
  };
}

/** Letters of base64 that are decoded at once: whole groups of four. */
const PORTION = 1 << 20;

/** Decodes base64. @throws Error if it is none */
export function bytesOfBase64(text: string): Uint8Array {
  const bytes = new Uint8Array(Math.floor((text.length * 3) / 4));
  let n = 0;
  for (let at = 0; at < text.length; at += PORTION) {
    const portion = atob(text.slice(at, at + PORTION));
    for (let i = 0; i < portion.length; i++) bytes[n++] = portion.charCodeAt(i);
  }
  return bytes.subarray(0, n);
}

/** The recording that `glisson export` put into the page; null for none. */
export function recordingInPage(): Uint8Array | null {
  const element = document.getElementById("recording");
  const text = element?.textContent?.trim() ?? "";
  // The letters are not needed any more.
  element?.remove();
  return text === "" ? null : bytesOfBase64(text);
}
