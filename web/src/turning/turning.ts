/** The list of what can be turned while the simulation runs: a field for each, with its unit, what the scene says, and why it cannot be. */
import { giveFocusBack } from "../keys";
import { text } from "../language";
import type { ClientMessage } from "../protocol";
import { shownValue, steppedValue, typedValue, unitOf, type Parameters, type ParameterState } from "./parameters";

interface Row {
  readonly field: HTMLInputElement;
  readonly note: HTMLElement;
  state: ParameterState;
}

const keyOf = ({ name, body }: Pick<ParameterState, "name" | "body">): string => `${name}:${body}`;

export class Turning {
  private readonly rows = new Map<string, Row>();
  private readonly list = document.createElement("div");
  private readonly back = document.createElement("button");
  private bodyNames: readonly string[] = [];
  private focusedBefore: Element | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly send: (message: ClientMessage) => void,
  ) {
    root.hidden = true;
    root.setAttribute("aria-label", text("turning_title"));
    const title = document.createElement("h2");
    title.textContent = text("turning_title");
    const about = document.createElement("p");
    about.textContent = text("turning_about");
    this.back.type = "button";
    this.back.textContent = text("turning_back");
    this.back.addEventListener("click", () => this.turnBack());
    root.append(title, about, this.list, this.back);
  }

  get open(): boolean {
    return !this.root.hidden;
  }

  set open(open: boolean) {
    if (open === this.open) return;
    this.root.hidden = !open;
    if (open) {
      this.focusedBefore = document.activeElement;
      [...this.rows.values()].find(({ field }) => !field.disabled)?.field.focus();
    } else {
      giveFocusBack(this.focusedBefore);
    }
  }

  /** Names of a scene's bodies; none for one organ. */
  begin(names: readonly string[]): void {
    if (names.join("\n") === this.bodyNames.join("\n")) return;
    this.bodyNames = names;
    this.rows.clear();
  }

  /** How they stand now. */
  show({ parameters }: Parameters): void {
    if (parameters.length !== this.rows.size || parameters.some((state) => !this.rows.has(keyOf(state)))) this.build(parameters);
    for (const state of parameters) {
      const row = this.rows.get(keyOf(state));
      if (row !== undefined) this.fill(row, state);
    }
    this.back.disabled = !parameters.some(isTurned);
  }

  private build(parameters: readonly ParameterState[]): void {
    this.rows.clear();
    this.list.replaceChildren(
      ...parameters.map((state) => {
        const line = document.createElement("label");
        line.className = "turning-row";
        line.dataset.parameter = keyOf(state);
        const name = document.createElement("span");
        const body = this.bodyNames[state.body];
        const isOfBody = parameters.some((other) => other.name === state.name && other.body !== state.body);
        name.textContent = isOfBody && body !== undefined ? `${text(`turning_${state.name}`)}, ${body}` : text(`turning_${state.name}`);
        const field = document.createElement("input");
        field.type = "text";
        field.inputMode = "decimal";
        field.autocomplete = "off";
        const unit = document.createElement("span");
        unit.textContent = unitOf(state.name);
        const note = document.createElement("small");
        line.append(name, field, unit, note);
        const row: Row = { field, note, state };
        field.addEventListener("change", () => this.take(row, typedValue(row.state, field.value)));
        field.addEventListener("keydown", (event) => {
          if (event.key !== "ArrowUp" && event.key !== "ArrowDown") return;
          event.preventDefault();
          this.take(row, steppedValue(row.state, event.key === "ArrowUp" ? 1 : -1));
        });
        this.rows.set(keyOf(state), row);
        return line;
      }),
    );
  }

  private take(row: Row, value: number | null): void {
    const { name, body, least, greatest } = row.state;
    if (value === null) {
      const [from, to] = [least, greatest].map((end) => shownValue(name, end));
      row.note.textContent = text("turning_range", { from, to, unit: unitOf(name) });
      row.field.setAttribute("aria-invalid", "true");
      return;
    }
    row.field.value = String(shownValue(name, value));
    this.send({ type: "turn", parameter: name, body, value });
  }

  private fill(row: Row, state: ParameterState): void {
    row.state = state;
    const { field, note } = row;
    const value = state.coming ?? state.value;
    field.removeAttribute("aria-invalid");
    field.value = String(shownValue(state.name, value));
    field.disabled = state.refusal !== null;
    note.textContent = noteOf(state);
  }

  private turnBack(): void {
    for (const { state } of this.rows.values()) {
      const { name, body, of_scene } = state;
      if (isTurned(state)) this.send({ type: "turn", parameter: name, body, value: of_scene });
    }
  }
}

function isTurned({ value, coming, of_scene, refusal }: ParameterState): boolean {
  return refusal === null && (coming ?? value) !== of_scene;
}

function noteOf({ name, value, of_scene, coming, refusal }: ParameterState): string {
  if (refusal !== null) return refusal;
  const shown = (number: number): string => `${shownValue(name, number)} ${unitOf(name)}`.trim();
  if (coming !== null) return text("turning_coming", { now: shown(value) });
  return value === of_scene ? "" : text("turning_of_scene", { value: shown(of_scene) });
}
