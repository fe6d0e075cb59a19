/** Which key does what: one table for the keyboard, the buttons and the help page. */

export type Action =
  | "pause"
  | "single_step"
  | "reset_view"
  | "reset_simulation"
  | "next_model"
  | "tilt_left"
  | "tilt_right"
  | "wireframe"
  | "contacts"
  | "forces"
  | "fixed_nodes"
  | "bodies"
  | "theatre"
  | "wipe"
  | "outside"
  | "screenshot"
  | "profiler"
  | "help"
  | "leave"
  | "tool_place"
  | "tool_left"
  | "tool_right"
  | "tool_up"
  | "tool_down"
  | "tool_deeper"
  | "tool_back"
  | "cut"
  | "clip"
  | "refine"
  | "undo"
  | "jaws"
  | "trigger"
  | "roll_left"
  | "roll_right"
  | "tool_1"
  | "tool_2"
  | "tool_3"
  | "tool_4";

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

export const BINDINGS: readonly Binding[] = [
  bind("Simulation", "pause", "Space", "pause or go on", plain(" ")),
  bind("Simulation", "single_step", "→ or .", "one step (while paused)", plain("arrowright", "."), true),
  bind("Simulation", "reset_simulation", "Shift R", "organ back to rest, instrument home", [{ key: "r", shift: true }]),
  bind("Simulation", "next_model", "M", "another model takes over within a second", plain("m")),
  bind("Simulation", "tilt_left", "Shift ←", "table 15° to the patient's left (scenes with gravity)", [{ key: "arrowleft", shift: true }], true),
  bind("Simulation", "tilt_right", "Shift →", "table 15° to the patient's right", [{ key: "arrowright", shift: true }], true),
  bind("View", "reset_view", "R or Backspace", "whole organ from the front", plain("r", "backspace")),
  bind("View", "wireframe", "W", "surface, surface with edges, edges", plain("w")),
  bind("View", "contacts", "C", "all contacts: points, normals, forces", plain("c")),
  bind("View", "forces", "F", "force arrow", plain("f")),
  bind("View", "fixed_nodes", "T", "fixed nodes", plain("t")),
  bind("View", "bodies", "Y", "hide one body more (of several); after the last all are shown", plain("y")),
  bind("View", "theatre", "N", "through the endoscope, or the organ from outside", plain("n")),
  bind("View", "wipe", "D", "wipe the endoscope's lens", plain("d")),
  bind("View", "outside", "Shift N", "picture from outside, beside that of the endoscope", [{ key: "n", shift: true }]),
  bind("Instrument", "tool_place", "G", "touch the organ at the middle of the view", plain("g")),
  bind("Instrument", "tool_left", "J", "left by 1 mm (Shift: 5 mm)", both("j"), true),
  bind("Instrument", "tool_right", "L", "right by 1 mm", both("l"), true),
  bind("Instrument", "tool_up", "I", "up by 1 mm", both("i"), true),
  bind("Instrument", "tool_down", "K", "down by 1 mm", both("k"), true),
  bind("Instrument", "tool_deeper", "U", "into the screen by 1 mm", both("u"), true),
  bind("Instrument", "tool_back", "O", "out of the screen by 1 mm", both("o"), true),
  bind("Instrument", "cut", "X", "cut away what the tip touches", plain("x"), true),
  bind("Instrument", "clip", "A", "set a clip on the vessel at the tip", plain("a")),
  bind("Instrument", "refine", "E", "make the mesh finer around the tip", plain("e")),
  bind("Instrument", "undo", "Z", "take the last cut back", plain("z"), true),
  bind("Instrument", "jaws", "B", "close or open the jaws", plain("b")),
  bind("Instrument", "trigger", "V", "current or blade on or off", plain("v")),
  bind("Instrument", "roll_left", "−", "roll by 5° to the left, as seen from the handle", plain("-"), true),
  bind("Instrument", "roll_right", "+", "to the right", [...both("+"), { key: "=", shift: false }], true),
  bind("Instrument", "tool_1", "1", "take the first instrument (of several)", plain("1")),
  bind("Instrument", "tool_2", "2", "the second", plain("2")),
  bind("Instrument", "tool_3", "3", "the third", plain("3")),
  bind("Instrument", "tool_4", "4", "the fourth", plain("4")),
  bind("Program", "screenshot", "S", "save the picture as PNG", plain("s")),
  bind("Program", "profiler", "P", "times of a frame and of the simulation", plain("p")),
  bind("Program", "help", "H or F1", "this page", plain("h", "f1", "?")),
  bind("Program", "leave", "Esc or Q", "close a page, or take the instrument off the organ", plain("escape", "q")),
];

export interface KeyPress {
  readonly key: string;
  readonly shiftKey: boolean;
  readonly ctrlKey: boolean;
  readonly altKey: boolean;
  readonly metaKey: boolean;
  readonly repeat: boolean;
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
  const at = (["tool_1", "tool_2", "tool_3", "tool_4"] as const).findIndex((name) => name === action);
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
