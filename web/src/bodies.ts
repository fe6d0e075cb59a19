/** The list of a scene's bodies: each can be hidden and shown, by pointer or keyboard. */
import { text } from "./language";
import type { BodyInfo } from "./protocol";

export class BodyList {
  private hidden = new Set<number>();
  private buttons: HTMLButtonElement[] = [];

  constructor(
    private readonly root: HTMLElement,
    private readonly changed: (hidden: ReadonlySet<number>) => void,
  ) {
    root.setAttribute("role", "group");
    root.setAttribute("aria-label", text("bodies_label"));
    root.hidden = true;
  }

  /** Lists the bodies of a new scene, all shown; nothing for one organ. */
  begin(bodies: readonly BodyInfo[]): void {
    this.hidden = new Set();
    this.buttons = bodies.map((body, number) => this.button(body, number));
    this.root.replaceChildren(...this.buttons);
    this.root.hidden = bodies.length === 0;
    this.show();
  }

  private button({ name, color, is_rigid, n_tetrahedra }: BodyInfo, number: number): HTMLButtonElement {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.title = text(is_rigid ? "body_rigid" : "body_soft", { n: n_tetrahedra });
    if (color !== null) button.style.borderLeft = `0.5em solid ${color}`;
    button.addEventListener("click", (event) => {
      this.toggle(number);
      // After a mouse click the space bar should pause again, not press this button.
      if (event.detail > 0) button.blur();
    });
    return button;
  }

  private toggle(number: number): void {
    if (!this.hidden.delete(number)) this.hidden.add(number);
    this.show();
  }

  /** Key Y: hides one body after the other, the first organ last; then all are shown again. */
  hideNext(): void {
    const order = [...this.buttons.keys()].reverse();
    const next = order.find((number) => !this.hidden.has(number) && number > 0);
    if (next === undefined) this.hidden = new Set();
    else this.hidden.add(next);
    this.show();
  }

  private show(): void {
    this.buttons.forEach((button, number) => button.setAttribute("aria-pressed", String(!this.hidden.has(number))));
    this.changed(new Set(this.hidden));
  }
}
