/** The fixed parts of index.html. */

export interface Page {
  readonly scene: HTMLCanvasElement;
  readonly orientation: HTMLCanvasElement;
  readonly panel: HTMLElement;
  readonly link: HTMLElement;
  readonly banner: HTMLElement;
  readonly messages: HTMLElement;
  readonly profiler: HTMLElement;
  readonly toolbar: HTMLElement;
  readonly bodies: HTMLElement;
  readonly contacts: HTMLElement;
  readonly hint: HTMLElement;
  readonly task: HTMLElement;
  readonly outside: HTMLElement;
  readonly turning: HTMLElement;
  readonly inside: HTMLElement;
  readonly classroom: HTMLElement;
}

function part<T extends HTMLElement>(id: string): T {
  const node = document.getElementById(id);
  if (node === null) throw new Error(`index.html has no element "${id}"`);
  return node as T;
}

/** @throws Error naming a part that the page does not have. */
export function findPage(): Page {
  return {
    scene: part("scene"),
    orientation: part("orientation"),
    panel: part("panel"),
    link: part("link"),
    banner: part("banner"),
    messages: part("messages"),
    profiler: part("profiler"),
    toolbar: part("toolbar"),
    bodies: part("bodies"),
    contacts: part("contacts"),
    hint: part("hint"),
    task: part("task"),
    outside: part("outside"),
    turning: part("turning"),
    inside: part("inside"),
    classroom: part("classroom"),
  };
}
