/** Buttons that do what keys do, in groups. */
import type { Binding } from "./keys";

export interface ButtonSpec<A extends string> {
  readonly action: A;
  readonly label: string;
  readonly key: string;
}

export type ButtonGroups<A extends string> = ReadonlyArray<ReadonlyArray<ButtonSpec<A>>>;

export const button = <A extends string>(action: A, label: string, key: string): ButtonSpec<A> => ({ action, label, key });

function element(name: string, className: string, text = ""): HTMLElement {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = text;
  return node;
}

/** A button that is held down repeats what it does after this time, and then so often [ms]: about as keys do. */
const REPEATS_AFTER_MS = 400;
const REPEATS_EVERY_MS = 80;

/** Runs again and again while `node` is held; answers whether it did, for the click that ends it. */
function repeatWhileHeld(node: HTMLElement, run: () => void): () => boolean {
  let timer: ReturnType<typeof setTimeout> | undefined;
  let repeated = false;
  const again = (): void => {
    repeated = true;
    run();
    timer = setTimeout(again, REPEATS_EVERY_MS);
  };
  node.addEventListener("pointerdown", () => {
    repeated = false;
    clearTimeout(timer);
    timer = setTimeout(again, REPEATS_AFTER_MS);
  });
  for (const end of ["pointerup", "pointerleave", "pointercancel"]) node.addEventListener(end, () => clearTimeout(timer));
  // A finger that is held would open the browser's own menu.
  node.addEventListener("contextmenu", (event) => event.preventDefault());
  return () => repeated;
}

export class ButtonBar<A extends string> {
  private readonly buttons = new Map<A, HTMLElement>();

  constructor(root: HTMLElement, groups: ButtonGroups<A>, bindings: ReadonlyArray<Binding<A>>, run: (action: A) => void) {
    for (const group of groups) {
      const box = element("div", "button-group");
      for (const { action, label, key } of group) {
        const node = element("button", "");
        node.append(element("span", "button-label", label), element("kbd", "", key));
        node.dataset.action = action;
        const binding = bindings.find((b) => b.action === action);
        node.title = binding?.does ?? label;
        const repeated = binding?.repeats === true ? repeatWhileHeld(node, () => run(action)) : () => false;
        node.addEventListener("click", (event) => {
          if (event.detail === 0 || !repeated()) run(action);
          // After a mouse click the space bar should pause again, not press this button.
          if (event.detail > 0) node.blur();
        });
        this.buttons.set(action, node);
        box.append(node);
      }
      root.append(box);
    }
  }

  /** Shows or hides a button, and a group of which nothing is left. */
  offer(action: A, offered: boolean): void {
    const node = this.buttons.get(action);
    if (node !== undefined && node.hidden === offered) node.hidden = !offered;
    const group = node?.parentElement;
    if (group != null) group.hidden = Array.from(group.children).every((child) => (child as HTMLElement).hidden);
  }

  /** Shows a switch as on or off. */
  set(action: A, on: boolean, label?: string): void {
    const node = this.buttons.get(action);
    if (node === undefined) return;
    if (node.getAttribute("aria-pressed") !== String(on)) node.setAttribute("aria-pressed", String(on));
    this.name(action, label);
  }

  /** Gives a button another label. */
  name(action: A, label?: string): void {
    const text = this.buttons.get(action)?.querySelector(".button-label");
    if (label !== undefined && text != null && text.textContent !== label) text.textContent = label;
  }
}
