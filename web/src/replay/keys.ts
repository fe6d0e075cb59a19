/** Which key of the player does what: one table for the keyboard, the buttons and the help page. */
import { button, type ButtonGroups } from "../button_bar";
import { bind, BINDINGS, plain, type Action, type Binding } from "../keys";

export type PlayerAction =
  | "play" | "frame_back" | "frame_on" | "second_back" | "second_on" | "begin" | "end" | "slower" | "faster" | "moment_back" | "moment_on"
  | "reset_view" | "turn_left" | "turn_right" | "turn_up" | "turn_down" | "nearer" | "further" | "wireframe" | "forces" | "fixed_nodes"
  | "bodies" | "theatre" | "wipe" | "outside" | "detail" | "tool_1" | "tool_2" | "tool_3" | "tool_4" | "screenshot" | "help" | "leave";

/** `<` and `>` need Shift on most keyboards, and not on all. */
const typed = (key: string) => [{ key, shift: false }, { key, shift: true }];

/** What the viewer has, in its words. */
function asInViewer(...actions: Array<Action & PlayerAction>): Array<Binding<PlayerAction>> {
  return actions.flatMap((action) => BINDINGS.filter((binding) => binding.action === action).map((binding) => ({ ...binding, action })));
}

export const PLAYER_BINDINGS: ReadonlyArray<Binding<PlayerAction>> = [
  bind("Recording", "play", "Space", "play or pause", plain(" ")),
  bind("Recording", "frame_back", "← or ,", "one frame back", plain("arrowleft", ","), true),
  bind("Recording", "frame_on", "→ or .", "one frame on", plain("arrowright", "."), true),
  bind("Recording", "second_back", "Shift ← or Page Up", "one second back", [{ key: "arrowleft", shift: true }, ...plain("pageup")], true),
  bind("Recording", "second_on", "Shift → or Page Down", "one second on", [{ key: "arrowright", shift: true }, ...plain("pagedown")], true),
  bind("Recording", "begin", "Home", "to the beginning", plain("home")),
  bind("Recording", "end", "End", "to the end", plain("end")),
  bind("Recording", "slower", "<", "slower, down to a tenth of real time", typed("<")),
  bind("Recording", "faster", ">", "faster, up to eight times real time", typed(">")),
  bind("Recording", "moment_back", "[", "to the moment before", plain("[")),
  bind("Recording", "moment_on", "]", "to the next moment that went wrong", plain("]")),
  ...asInViewer("reset_view"),
  bind("View", "turn_left", "J", "turn the view to the left", plain("j"), true),
  bind("View", "turn_right", "L", "to the right", plain("l"), true),
  bind("View", "turn_up", "I", "upwards", plain("i"), true),
  bind("View", "turn_down", "K", "downwards", plain("k"), true),
  bind("View", "nearer", "U", "nearer", plain("u"), true),
  bind("View", "further", "O", "further away", plain("o"), true),
  ...asInViewer("wireframe", "forces", "fixed_nodes", "bodies", "theatre", "wipe", "outside", "detail"),
  bind("Instrument", "tool_1", "1", "force of the first instrument (of several)", plain("1")),
  bind("Instrument", "tool_2", "2", "of the second", plain("2")),
  bind("Instrument", "tool_3", "3", "of the third", plain("3")),
  bind("Instrument", "tool_4", "4", "of the fourth", plain("4")),
  bind("Page", "screenshot", "S", "save the picture as PNG", plain("s")),
  bind("Page", "help", "H or F1", "this page", plain("h", "f1", "?")),
  bind("Page", "leave", "Esc or Q", "close this page", plain("escape", "q")),
];

export const PLAYER_MOUSE: ReadonlyArray<readonly [string, string]> = [
  ["Left drag", "turn the view"],
  ["Shift + left, or middle", "move the view"],
  ["Wheel", "zoom"],
  ["The curve below", "to that time"],
];

export const PLAYER_BUTTONS: ButtonGroups<PlayerAction> = [
  [button("frame_back", "− Frame", "←"), button("play", "Play", "␣"), button("frame_on", "+ Frame", "→")],
  [button("slower", "Slower", "<"), button("faster", "Faster", ">")],
  [button("moment_back", "− Moment", "["), button("moment_on", "+ Moment", "]")],
  [button("tool_1", "1", "1"), button("tool_2", "2", "2"), button("tool_3", "3", "3"), button("tool_4", "4", "4")],
  [button("reset_view", "View", "R"), button("wireframe", "Edges", "W"), button("fixed_nodes", "Fixed", "T"), button("forces", "Force", "F")],
  [button("theatre", "Endoscope", "N"), button("wipe", "Wipe lens", "D"), button("outside", "Outside", "⇧N")],
  [button("screenshot", "Picture", "S"), button("help", "Help", "H")],
];
