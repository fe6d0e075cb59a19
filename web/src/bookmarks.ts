/** A moment is marked while it happens; a field below the messages gives it a text, and goes away by itself. */
import { text } from "./language";
import type { ClientMessage } from "./protocol";
import { timeText } from "./replay/timeline";

/** A field that nobody writes in goes after so long [ms]. */
const FIELD_GOES_MS = 12_000;
/** Letters of a text at most, as the server allows. */
const LONGEST_TEXT = 120;

export class LiveBookmarks {
  private field: HTMLElement | null = null;
  private going = 0;

  constructor(
    private readonly root: HTMLElement,
    private readonly send: (message: ClientMessage) => boolean,
  ) {}

  /** Marks a moment. */
  set(time_s: number): void {
    if (!this.send({ type: "bookmark", time_s })) return;
    this.close();
    const field = document.createElement("label");
    field.className = "message bookmark-field";
    const words = document.createElement("span");
    words.textContent = text("bookmark_at", { time: timeText(time_s) });
    const name = document.createElement("input");
    Object.assign(name, { type: "text", maxLength: LONGEST_TEXT, placeholder: text("bookmark_text") });
    // After it nothing takes the keyboard away from the simulation.
    name.addEventListener("keydown", ({ key }) => {
      if (key === "Enter" && name.value.trim() !== "") this.send({ type: "bookmark", time_s, text: name.value.trim() });
      if (key === "Enter" || key === "Escape") this.close();
    });
    name.addEventListener("focus", () => window.clearTimeout(this.going));
    name.addEventListener("blur", () => this.goSoon());
    field.append(words, name);
    this.root.append(field);
    this.field = field;
    this.goSoon();
  }

  private goSoon(): void {
    window.clearTimeout(this.going);
    this.going = window.setTimeout(() => this.close(), FIELD_GOES_MS);
  }

  private close(): void {
    window.clearTimeout(this.going);
    const { field } = this;
    this.field = null;
    field?.remove();
  }
}
