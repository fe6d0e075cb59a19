/** Parts of the page of input devices. */
import { ACTIONS, type Action } from "../actions";
import { text } from "../language";

export function element<K extends keyof HTMLElementTagNameMap>(name: K, className = "", words = ""): HTMLElementTagNameMap[K] {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = words;
  return node;
}

export function pressButton(words: string, pressed: () => void): HTMLButtonElement {
  const button = element("button", "devices-button", words);
  button.type = "button";
  button.addEventListener("click", pressed);
  return button;
}

/** A list to choose from: its values are texts. */
export function choice(label: string, options: ReadonlyArray<readonly [value: string, words: string]>, value: string, chosen: (value: string) => void): HTMLSelectElement {
  const select = element("select");
  select.setAttribute("aria-label", label);
  for (const [option, words] of options) select.append(new Option(words, option));
  select.value = value;
  select.addEventListener("change", () => chosen(select.value));
  return select;
}

/** Which instrument: by its number, or the one in the hand. */
export function instrumentChoice(label: string, names: readonly string[], now: number | null, chosen: (tool: number | null) => void): HTMLSelectElement {
  const options: Array<readonly [string, string]> = [["", text("devices_in_hand")]];
  // One that a kept mapping names and this scene has not is there, too.
  const count = Math.max(names.length, (now ?? -1) + 1);
  for (let tool = 0; tool < count; tool++) options.push([String(tool), `${tool + 1}: ${names[tool] ?? text("devices_not_there")}`]);
  return choice(label, options, now === null ? "" : String(now), (value) => chosen(value === "" ? null : Number(value)));
}

/** What is done: all that keys can do, or nothing. */
export function actionChoice(label: string, now: Action | null, chosen: (action: Action | null) => void): HTMLSelectElement {
  const options = ACTIONS.filter((action) => action !== "leave" && action !== "devices").map((action) => [action, text(`key_${action}`)] as const);
  return choice(label, [["", text("devices_nothing")], ...options], now ?? "", (value) => chosen(value === "" ? null : (value as Action)));
}

/** A number by a slider, with its value in words. */
export function slider(label: string, range: readonly [least: number, greatest: number, step: number], now: number, words: (value: number) => string, chosen: (value: number) => void): HTMLElement {
  const line = element("label", "devices-line");
  const input = element("input");
  input.type = "range";
  [input.min, input.max, input.step] = range.map(String);
  input.value = String(now);
  const shown = element("output", "", words(now));
  input.addEventListener("input", () => {
    shown.textContent = words(Number(input.value));
    chosen(Number(input.value));
  });
  line.append(element("span", "", label), input, shown);
  return line;
}

export function check(label: string, now: boolean, chosen: (on: boolean) => void): HTMLElement {
  const line = element("label", "devices-check");
  const input = element("input");
  input.type = "checkbox";
  input.checked = now;
  input.addEventListener("change", () => chosen(input.checked));
  line.append(input, label);
  return line;
}
