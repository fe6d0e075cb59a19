import { bytesOfBase64 } from "../base64";
import { text } from "../language";
import { become, filled, taken, unpacked } from "../page_parts";

/** The fixed parts of replay.html. */
export interface ReplayPage {
  readonly scene: HTMLCanvasElement;
  readonly orientation: HTMLCanvasElement;
  readonly panel: HTMLElement;
  readonly messages: HTMLElement;
  readonly bodies: HTMLElement;
  readonly story: HTMLElement;
  readonly bookmarks: HTMLElement;
  readonly contacts: HTMLElement;
  readonly transport: HTMLElement;
  readonly timeline: HTMLElement;
  readonly toolbar: HTMLElement;
  readonly hint: HTMLElement;
  readonly outside: HTMLElement;
  /** What two recordings are called, above their pictures. */
  readonly names: readonly HTMLElement[];
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
    bookmarks: part("bookmarks"),
    contacts: part("contacts"),
    transport: part("transport"),
    timeline: part("timeline"),
    toolbar: part("toolbar"),
    hint: part("hint"),
    outside: part("outside"),
    names: [part("name-a"), part("name-b")],
  };
}

/** Makes room for a second picture, and what belongs to it. */
export function partsBeside(page: ReplayPage): ReplayPage {
  document.body.classList.add("pair");
  const scene = document.createElement("canvas");
  scene.id = "scene-beside";
  scene.tabIndex = 0;
  scene.setAttribute("aria-label", text("replay_scene_beside"));
  page.scene.after(scene);
  const outside = document.createElement("div");
  outside.id = "outside-beside";
  outside.hidden = true;
  outside.setAttribute("role", "img");
  outside.setAttribute("aria-label", text("outside_label"));
  page.outside.after(outside);
  for (const name of page.names) name.hidden = false;
  // What touches is counted for the first one alone.
  return { ...page, scene, outside, contacts: document.createElement("div") };
}

/** The recordings that `glisson export` put into the page: none, one, or two to be compared. */
export function recordingsInPage(): Uint8Array[] {
  const letters = ["recording", "recording-beside"].map(taken);
  return letters.filter((some) => some !== "").map(bytesOfBase64);
}

/** The simulator of what was recorded, where the page has it: takes the page's place with the simulation at a step. */
export function simulatorInPage(): ((step: number) => Promise<void>) | null {
  const letters = taken("simulator");
  if (letters === "") return null;
  let isTaken = false;
  return async (step) => {
    if (isTaken) return;
    isTaken = true;
    const page = new TextDecoder().decode(await unpacked(bytesOfBase64(letters)));
    become(filled(page, "take-over", String(step)));
  };
}
