/** Which key does what: one table for the keyboard, the buttons and the help page. */
import { TOOL_ACTIONS, type Action } from "./actions";
import { keysIn, LANGUAGE, text } from "./language";

export { type Action };

export interface Chord {
  /** `KeyboardEvent.key`, letters in lower case. */
  readonly key: string;
  readonly shift: boolean;
}

export interface Binding<A extends string = Action> {
  readonly action: A;
  readonly chords: readonly Chord[];
  /** What the help page calls the keys. */
  readonly keys: string;
  readonly does: string;
  /** Its heading on the help page. */
  readonly group: string;
  /** Held down, the key repeats. */
  readonly repeats: boolean;
}

export const plain = (...keys: string[]): Chord[] => keys.map((key) => ({ key, shift: false }));
/** With and without Shift (five times the way with it). */
const both = (key: string): Chord[] => [
  { key, shift: false },
  { key, shift: true },
];

export function bind<A extends string>(
  group: string,
  action: A,
  keys: string,
  does: string,
  chords: readonly Chord[],
  repeats = false,
): Binding<A> {
  return { group, action, keys, does, chords, repeats };
}

/** One of the viewer, in the page's language. */
function own(group: "simulation" | "view" | "instrument" | "class" | "program", action: Action, keys: string, chords: readonly Chord[], repeats = false): Binding {
  return bind(text(`group_${group}`), action, keysIn(LANGUAGE, keys), text(`key_${action}`), chords, repeats);
}

export const BINDINGS: readonly Binding[] = [
  own("simulation", "pause", "Space", plain(" ")),
  own("simulation", "single_step", "→ or .", plain("arrowright", "."), true),
  own("simulation", "slow_motion", "< or ,", [...both("<"), ...plain(",")]),
  own("simulation", "reset_simulation", "Shift R", [{ key: "r", shift: true }]),
  own("simulation", "next_model", "M", plain("m")),
  own("simulation", "turning", "Shift M", [{ key: "m", shift: true }]),
  own("simulation", "tilt_left", "Shift ←", [{ key: "arrowleft", shift: true }], true),
  own("simulation", "tilt_right", "Shift →", [{ key: "arrowright", shift: true }], true),
  own("view", "reset_view", "R or Backspace", plain("r", "backspace")),
  own("view", "wireframe", "W", plain("w")),
  own("view", "contacts", "C", plain("c")),
  own("view", "forces", "F", plain("f")),
  own("view", "fixed_nodes", "T", plain("t")),
  own("view", "bodies", "Y", plain("y")),
  own("view", "field", "Shift C", [{ key: "c", shift: true }]),
  own("view", "plane", "Shift X", [{ key: "x", shift: true }]),
  own("view", "plane_deeper", "Page ↓", plain("pagedown"), true),
  own("view", "plane_back", "Page ↑", plain("pageup"), true),
  own("view", "theatre", "N", plain("n")),
  own("view", "wipe", "D", plain("d")),
  own("view", "outside", "Shift N", [{ key: "n", shift: true }]),
  own("view", "detail", "Shift T", [{ key: "t", shift: true }]),
  own("view", "stereo", "Shift D", [{ key: "d", shift: true }]),
  own("view", "headset", "Shift V", [{ key: "v", shift: true }]),
  own("instrument", "tool_place", "G", plain("g")),
  own("instrument", "tool_left", "J", both("j"), true),
  own("instrument", "tool_right", "L", both("l"), true),
  own("instrument", "tool_up", "I", both("i"), true),
  own("instrument", "tool_down", "K", both("k"), true),
  own("instrument", "tool_deeper", "U", both("u"), true),
  own("instrument", "tool_back", "O", both("o"), true),
  own("instrument", "cut", "X", plain("x"), true),
  own("instrument", "clip", "A", plain("a")),
  own("instrument", "refine", "E", plain("e")),
  own("instrument", "undo", "Z", plain("z"), true),
  own("instrument", "jaws", "B", plain("b")),
  own("instrument", "trigger", "V", plain("v")),
  own("instrument", "roll_left", "−", plain("-"), true),
  own("instrument", "roll_right", "+", [...both("+"), { key: "=", shift: false }], true),
  own("instrument", "tool_1", "1", plain("1")),
  own("instrument", "tool_2", "2", plain("2")),
  own("instrument", "tool_3", "3", plain("3")),
  own("instrument", "tool_4", "4", plain("4")),
  own("instrument", "tool_5", "5", plain("5")),
  own("class", "take_over", "Shift B", [{ key: "b", shift: true }]),
  own("class", "draw", "Shift W", [{ key: "w", shift: true }]),
  own("class", "mark_tip", "Shift Y", [{ key: "y", shift: true }]),
  own("class", "erase", "Shift Z", [{ key: "z", shift: true }]),
  own("program", "panel", "Shift P", [{ key: "p", shift: true }]),
  own("program", "plot", "Shift F", [{ key: "f", shift: true }]),
  own("program", "plot_next", "Shift G", [{ key: "g", shift: true }]),
  own("program", "plot_save", "Shift A", [{ key: "a", shift: true }]),
  own("program", "devices", "Shift E", [{ key: "e", shift: true }]),
  own("program", "screenshot", "S", plain("s")),
  own("program", "bookmark", "*", both("*")),
  own("program", "sound", "Shift S", [{ key: "s", shift: true }]),
  own("program", "profiler", "P", plain("p")),
  own("program", "help", "H or F1", plain("h", "f1", "?")),
  own("program", "start_page", "Shift Q", [{ key: "q", shift: true }]),
  own("program", "leave", "Esc or Q", plain("escape", "q")),
];

export interface KeyPress {
  readonly key: string;
  readonly shiftKey: boolean;
  readonly ctrlKey: boolean;
  readonly altKey: boolean;
  readonly metaKey: boolean;
  readonly repeat: boolean;
}

/** Keys that move a slider or tick a box. */
const OF_SLIDERS = /^( |Arrow.*|Home|End|Page.*)$/;

/** Whether a key press is for the part of the page that has the focus: it presses a button, or chooses from a list. */
export function isForPart({ target, key }: Pick<KeyboardEvent, "target" | "key">): boolean {
  const isTyped = target instanceof HTMLInputElement && target.type === "text";
  if (target instanceof HTMLSelectElement || isTyped) return key !== "Escape";
  // Page keys scroll what is too long.
  if (target instanceof HTMLElement && target.matches("[tabindex]") && target.scrollHeight > target.clientHeight && key.startsWith("Page")) return true;
  if (target instanceof HTMLInputElement) return OF_SLIDERS.test(key);
  return target instanceof HTMLButtonElement && (key === " " || key === "Enter");
}

/** The keyboard goes back to where it was before something was opened, at once, and not when what was closed is found to be hidden. */
export function giveFocusBack(to: Element | null): void {
  if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  if (to instanceof HTMLElement) to.focus();
}

/** The viewer's action of a key press, or null. */
export function actionOf(press: KeyPress): Action | null {
  return actionIn(press, BINDINGS);
}

/** The action that `bindings` have for a key press, or null: keys with Ctrl, Alt or Meta belong to the browser. */
export function actionIn<A extends string>(press: KeyPress, bindings: ReadonlyArray<Binding<A>>): A | null {
  if (press.ctrlKey || press.altKey || press.metaKey) return null;
  const key = press.key.toLowerCase();
  // Shift is part of typing "?", not of the chord.
  const shift = press.shiftKey && key !== "?";
  const binding = bindings.find((b) => b.chords.some((c) => c.key === key && c.shift === shift));
  if (binding === undefined || (press.repeat && !binding.repeats)) return null;
  return binding.action;
}

/** Number of the instrument that a key takes, from 0; null for other actions. */
export function toolNumber(action: string): number | null {
  const at = TOOL_ACTIONS.findIndex((name) => name === action);
  return at < 0 ? null : at;
}

/** One press of a movement key moves the instrument by this much [m]. */
export const TOOL_STEP_M = 0.001;
export const TOOL_STEP_WITH_SHIFT_M = 0.005;

/** One press of a roll key turns the instrument about its shaft by this much [rad]. */
const ROLL_STEP_RAD = (5 * Math.PI) / 180;

/** Angle about the shaft of a roll key [rad], or null for other actions; the shaft's direction is towards the handle. */
export function rollOf(action: Action): number | null {
  if (action === "roll_left") return ROLL_STEP_RAD;
  return action === "roll_right" ? -ROLL_STEP_RAD : null;
}

/** Direction of a movement key on the screen (right, up, into), or null for other actions. */
export function toolDirection(action: Action): readonly [number, number, number] | null {
  switch (action) {
    case "tool_left":
      return [-1, 0, 0];
    case "tool_right":
      return [1, 0, 0];
    case "tool_up":
      return [0, 1, 0];
    case "tool_down":
      return [0, -1, 0];
    case "tool_deeper":
      return [0, 0, 1];
    case "tool_back":
      return [0, 0, -1];
    default:
      return null;
  }
}
