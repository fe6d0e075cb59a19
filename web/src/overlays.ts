/** What lies over the picture: help page, messages, connection banner, buttons; and saving a file. */
import { ButtonBar, button, type ButtonGroups } from "./button_bar";
import type { ConnectionState } from "./connection";
import { TOOL_ACTIONS } from "./actions";
import { download } from "./download";
import { BINDINGS, type Action, type Binding } from "./keys";
import { languageChoice, text } from "./language";
import type { Stereo } from "./theatre/stereo";
import type { Page } from "./page";

function element(name: string, className: string, words = ""): HTMLElement {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = words;
  return node;
}

const MOUSE: ReadonlyArray<readonly [string, string]> = (["push", "deeper", "turn", "move", "zoom", "endoscope", "fingers"] as const).map(
  (what) => [text(`mouse_${what}`), text(`mouse_${what}_does`)],
);

/** Lines of the help page under their heading. */
export type HelpGroup = readonly [title: string, lines: ReadonlyArray<readonly [string, string]>];

/** The help page's groups of a table of keys, in its order. */
export function helpOf(bindings: ReadonlyArray<Binding<string>>): HelpGroup[] {
  const titles = [...new Set(bindings.map(({ group }) => group))];
  return titles.map((title) => [title, bindings.filter((b) => b.group === title).map((b) => [b.keys, b.does])]);
}

export class Help {
  private readonly root: HTMLElement;

  constructor(parent: HTMLElement, groups: readonly HelpGroup[] = [[text("group_mouse"), MOUSE], ...helpOf(BINDINGS)]) {
    this.root = element("div", "overlay help");
    this.root.setAttribute("role", "dialog");
    this.root.setAttribute("aria-label", text("help_label"));
    this.root.hidden = true;
    const page = element("div", "help-page");
    // Keys scroll it.
    page.tabIndex = 0;
    page.append(element("h1", "", text("help_title")));
    const columns = element("div", "help-columns");
    for (const [title, lines] of groups) columns.append(this.group(title, lines));
    page.append(languageChoice(), columns, element("p", "help-foot", text("help_foot")));
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

  error(words: string): void {
    this.show(words, "error");
  }

  notice(words: string): void {
    this.show(words, "news");
  }

  private show(words: string, kind: "error" | "news"): void {
    const known = this.shown.get(words);
    if (known !== undefined) {
      known.count += 1;
      known.node.dataset.count = `× ${known.count}`;
      return;
    }
    if (kind === "error") console.error(words);
    const node = element("div", "message");
    node.dataset.kind = kind;
    node.setAttribute("role", kind === "error" ? "alert" : "status");
    node.append(element("span", "", words));
    const close = element("button", "", "×");
    close.setAttribute("aria-label", text("close_message"));
    close.addEventListener("click", () => {
      node.remove();
      this.shown.delete(words);
    });
    node.append(close);
    this.root.append(node);
    this.shown.set(words, { node, count: 1 });
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
  page.link.textContent = text(({ connecting: "connecting", open: "connected", lost: "disconnected" } as const)[state]);
  page.link.dataset.state = state;
  page.banner.hidden = state !== "lost";
  page.banner.textContent = text("connection_lost", { n: attempt });
}

const GROUPS = [
  // What a hand without a keyboard needs: shown from the first touch on.
  [["tool_1", "1"], ["tool_2", "2"], ["tool_3", "3"], ["tool_4", "4"], ["tool_5", "5"]],
  [["tool_place", "G"], ["jaws", "B"], ["trigger", "V"], ["clip", "A"], ["undo", "Z"]],
  [["tool_deeper", "U"], ["tool_back", "O"], ["roll_left", "−"], ["roll_right", "+"]],
  [["pause", "␣"], ["single_step", "→"], ["slow_motion", "<"], ["reset_simulation", "⇧R"], ["next_model", "M"], ["turning", "⇧M"]],
  [["reset_view", "R"], ["wireframe", "W"], ["fixed_nodes", "T"], ["contacts", "C"], ["forces", "F"], ["field", "⇧C"], ["plane", "⇧X"]],
  [["theatre", "N"], ["wipe", "D"], ["outside", "⇧N"], ["stereo", "⇧D"], ["headset", "⇧V"]],
  [["cut", "X"]],
  [["panel", "⇧P"], ["bookmark", "*"], ["screenshot", "S"], ["sound", "⇧S"], ["profiler", "P"], ["devices", "⇧E"], ["help", "H"]],
  [["start_page", "⇧Q"]],
] as const;

/** So many of them are the hand's. */
const N_HAND_GROUPS = 3;

const BUTTONS: ButtonGroups<Action> = GROUPS.map((group) => group.map(([action, key]) => button<Action>(action, text(`button_${action}`), key)));

/** What of the picture is switched on. */
export interface ShownParts {
  readonly style: number;
  readonly contacts: boolean;
  readonly forces: boolean;
  readonly fixedNodes: boolean;
  readonly profiler: boolean;
  /** All measurements instead of the force alone. */
  readonly panel: boolean;
  readonly plot: boolean;
  readonly sound: boolean;
}

/** What of the theatre view is switched on. */
export interface ShownTheatre {
  /** Number of the endoscope; null for a scene without. */
  readonly endoscope: number | null;
  readonly on: boolean;
  readonly showsOutside: boolean;
  readonly stereo: Stereo;
}

/** The button that shows what is folded away where there is little room, and folds it again. */
function unfolding(root: HTMLElement): HTMLElement {
  const group = element("div", "button-group unfold");
  const more = element("button", "", text("button_more"));
  more.setAttribute("aria-pressed", "false");
  more.addEventListener("click", () => more.setAttribute("aria-pressed", String(root.classList.toggle("unfolded"))));
  group.append(more);
  return group;
}

export class Toolbar extends ButtonBar<Action> {
  constructor(root: HTMLElement, run: (action: Action) => void) {
    super(root, BUTTONS, BINDINGS, run);
    const hand = [...root.children].slice(0, N_HAND_GROUPS);
    for (const group of hand) group.classList.add("of-hand");
    hand[N_HAND_GROUPS - 1].after(unfolding(root));
    const touched = (): void => document.body.classList.add("touched");
    if (window.matchMedia("(pointer: coarse)").matches) touched();
    window.addEventListener("pointerdown", ({ pointerType }) => pointerType === "touch" && touched(), true);
    // Until one is found.
    this.offer("headset", false);
  }

  /** The instruments of a scene have their names on their buttons. */
  begin(tools: ReadonlyArray<{ readonly name: string }>): void {
    TOOL_ACTIONS.forEach((action, tool) => {
      this.offer(action, tool < tools.length);
      this.name(action, tools[tool]?.name);
    });
  }

  /** Shows the instrument in the hand, and how it is. */
  showHand(chosen: number, { jaw, trigger }: { readonly jaw: number; readonly trigger: number }): void {
    TOOL_ACTIONS.forEach((action, tool) => this.set(action, tool === chosen));
    this.set("jaws", jaw <= 0.5);
    this.set("trigger", trigger > 0.5);
  }

  /** Shows all switches as on or off. */
  show(paused: boolean, help: boolean, shown: ShownParts, theatre: ShownTheatre, leaving: "offered" | "asked" | null, speed: number, lab: Readonly<Partial<Record<Action, boolean>>>): void {
    for (const [action, on] of Object.entries(lab)) this.set(action as Action, on);
    this.set("pause", paused, text(paused ? "button_go_on" : "button_pause"));
    this.set("slow_motion", speed < 1, speed < 1 ? text("button_slow_at", { speed }) : text("button_slow_motion"));
    this.set("wireframe", shown.style !== 0);
    this.set("contacts", shown.contacts);
    this.set("forces", shown.forces);
    this.set("fixed_nodes", shown.fixedNodes);
    this.set("profiler", shown.profiler);
    this.set("sound", shown.sound);
    this.set("stereo", theatre.stereo !== "off");
    this.set("panel", shown.panel);
    this.set("help", help);
    this.set("theatre", theatre.on);
    this.set("outside", theatre.showsOutside);
    this.name("start_page", text(leaving === "asked" ? "button_end_it" : "button_start_page"));
    this.offer("start_page", leaving !== null);
    this.offer("theatre", theatre.endoscope !== null);
    for (const action of ["wipe", "outside", "stereo"] as const) this.offer(action, theatre.on);
  }
}

/** Saves a picture of a step when it is drawn; true if it was. */
export async function savePicture(picture: Promise<Blob>, step: number, messages: Messages): Promise<boolean> {
  try {
    download(await picture, `glisson-step-${String(step).padStart(6, "0")}.png`);
    return true;
  } catch (error) {
    messages.error(text("not_saved", { why: error instanceof Error ? error.message : String(error) }));
    return false;
  }
}
