/** What lies over the picture: help page, messages, connection banner, buttons; and saving a file. */
import { ButtonBar, button, type ButtonGroups } from "./button_bar";
import type { ConnectionState } from "./connection";
import { BINDINGS, type Action, type Binding } from "./keys";
import type { Page } from "./page";

function element(name: string, className: string, text = ""): HTMLElement {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = text;
  return node;
}

const MOUSE: ReadonlyArray<readonly [string, string]> = [
  ["Left drag on the organ", "push: presses 5 mm in, then follows the pointer"],
  ["Wheel while pushing", "deeper and shallower, 1 mm a notch"],
  ["Left drag beside the organ", "turn the view (Alt + left or right button: anywhere)"],
  ["Shift + left, or middle", "move the view"],
  ["Wheel", "zoom"],
  ["Through the endoscope", "what turns the view pivots the endoscope about its trocar, what moves it rolls it; the wheel pushes it in. With the endoscope in the hand, left drag does so anywhere"],
];

/** Lines of the help page under their heading. */
export type HelpGroup = readonly [title: string, lines: ReadonlyArray<readonly [string, string]>];

/** The help page's groups of a table of keys, in its order. */
export function helpOf(bindings: ReadonlyArray<Binding<string>>): HelpGroup[] {
  const titles = [...new Set(bindings.map(({ group }) => group))];
  return titles.map((title) => [title, bindings.filter((b) => b.group === title).map((b) => [b.keys, b.does])]);
}

export class Help {
  private readonly root: HTMLElement;

  constructor(parent: HTMLElement, groups: readonly HelpGroup[] = [["Mouse", MOUSE], ...helpOf(BINDINGS)]) {
    this.root = element("div", "overlay help");
    this.root.setAttribute("role", "dialog");
    this.root.setAttribute("aria-label", "Help");
    this.root.hidden = true;
    const page = element("div", "help-page");
    page.append(element("h1", "", "Mouse and keys"));
    const columns = element("div", "help-columns");
    for (const [title, lines] of groups) columns.append(this.group(title, lines));
    page.append(columns, element("p", "help-foot", "Esc closes this page. Research software: not for use on patients."));
    this.root.append(page);
    this.root.addEventListener("click", (event) => {
      if (event.target === this.root) this.open = false;
    });
    parent.append(this.root);
  }

  private group(title: string, lines: ReadonlyArray<readonly [string, string]>): HTMLElement {
    const group = element("div", "help-group");
    group.append(element("h2", "", title));
    for (const [keys, does] of lines) {
      const line = element("div", "help-line");
      line.append(element("kbd", "", keys), element("span", "", does));
      group.append(line);
    }
    return group;
  }

  get open(): boolean {
    return !this.root.hidden;
  }

  set open(open: boolean) {
    this.root.hidden = !open;
  }
}

/** Messages in the page: what is wrong, also written to the console, and what is good to know. The same again only counts up. */
export class Messages {
  private readonly shown = new Map<string, { node: HTMLElement; count: number }>();

  constructor(private readonly root: HTMLElement) {}

  error(text: string): void {
    this.show(text, "error");
  }

  notice(text: string): void {
    this.show(text, "news");
  }

  private show(text: string, kind: "error" | "news"): void {
    const known = this.shown.get(text);
    if (known !== undefined) {
      known.count += 1;
      known.node.dataset.count = `× ${known.count}`;
      return;
    }
    if (kind === "error") console.error(text);
    const node = element("div", "message");
    node.dataset.kind = kind;
    node.setAttribute("role", kind === "error" ? "alert" : "status");
    node.append(element("span", "", text));
    const close = element("button", "", "×");
    close.setAttribute("aria-label", "Close this message");
    close.addEventListener("click", () => {
      node.remove();
      this.shown.delete(text);
    });
    node.append(close);
    this.root.append(node);
    this.shown.set(text, { node, count: 1 });
    // The oldest goes when there are too many.
    if (this.shown.size > 4) {
      const [oldest, { node: gone }] = this.shown.entries().next().value!;
      gone.remove();
      this.shown.delete(oldest);
    }
  }

  texts(): string[] {
    return [...this.shown.keys()];
  }
}

/** The connection's state: a lamp in the panel, and a banner when it is lost. */
export function showConnection(page: Pick<Page, "link" | "banner">, state: ConnectionState, attempt: number): void {
  page.link.textContent = { connecting: "connecting…", open: "connected", lost: "disconnected" }[state];
  page.link.dataset.state = state;
  page.banner.hidden = state !== "lost";
  page.banner.textContent = `Connection to the simulator lost. Trying again (${attempt})…`;
}

const BUTTONS: ButtonGroups<Action> = [
  [button("pause", "Pause", "␣"), button("single_step", "Step", "→"), button("reset_simulation", "Reset", "⇧R"), button("next_model", "Model", "M")],
  [
    button("reset_view", "View", "R"),
    button("wireframe", "Edges", "W"),
    button("fixed_nodes", "Fixed", "T"),
    button("contacts", "Contacts", "C"),
    button("forces", "Force", "F"),
  ],
  [button("theatre", "Endoscope", "N"), button("wipe", "Wipe lens", "D"), button("outside", "Outside", "⇧N")],
  [button("cut", "Cut", "X")],
  [button("screenshot", "Picture", "S"), button("profiler", "Times", "P"), button("help", "Help", "H")],
];

/** What of the picture is switched on. */
export interface ShownParts {
  readonly style: number;
  readonly contacts: boolean;
  readonly forces: boolean;
  readonly fixedNodes: boolean;
  readonly profiler: boolean;
}

/** What of the theatre view is switched on. */
export interface ShownTheatre {
  /** Number of the endoscope; null for a scene without. */
  readonly endoscope: number | null;
  readonly on: boolean;
  readonly showsOutside: boolean;
}

export class Toolbar extends ButtonBar<Action> {
  constructor(root: HTMLElement, run: (action: Action) => void) {
    super(root, BUTTONS, BINDINGS, run);
  }

  /** Shows all switches as on or off. */
  show(paused: boolean, help: boolean, shown: ShownParts, theatre: ShownTheatre): void {
    this.set("pause", paused, paused ? "Go on" : "Pause");
    this.set("wireframe", shown.style !== 0);
    this.set("contacts", shown.contacts);
    this.set("forces", shown.forces);
    this.set("fixed_nodes", shown.fixedNodes);
    this.set("profiler", shown.profiler);
    this.set("help", help);
    this.set("theatre", theatre.on);
    this.set("outside", theatre.showsOutside);
    this.offer("theatre", theatre.endoscope !== null);
    for (const action of ["wipe", "outside"] as const) this.offer(action, theatre.on);
  }
}

/** Saves a picture of a step when it is drawn; true if it was. */
export async function savePicture(picture: Promise<Blob>, step: number, messages: Messages): Promise<boolean> {
  try {
    download(await picture, `glisson-step-${String(step).padStart(6, "0")}.png`);
    return true;
  } catch (error) {
    messages.error(`The picture was not saved: ${error instanceof Error ? error.message : String(error)}`);
    return false;
  }
}

/** Offers `content` as a file to save. */
function download(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
