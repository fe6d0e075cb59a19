/** Which key of the player does what: one table for the keyboard, the buttons and the help page. */
import { button, type ButtonGroups } from "../button_bar";
import { bind, BINDINGS, plain, type Action, type Binding, type Chord } from "../keys";
import { keysIn, LANGUAGE, text } from "../language";
import type { TextKey } from "../texts_en";

export type PlayerAction =
  | "play" | "frame_back" | "frame_on" | "second_back" | "second_on" | "begin" | "end" | "slower" | "faster" | "moment_back" | "moment_on" | "bookmark" | "take_over" | "couple" | "align"
  | "reset_view" | "turn_left" | "turn_right" | "turn_up" | "turn_down" | "nearer" | "further" | "wireframe" | "forces" | "fixed_nodes"
  | "bodies" | "contacts" | "theatre" | "wipe" | "outside" | "detail" | "tool_1" | "tool_2" | "tool_3" | "tool_4" | "tool_5" | "screenshot" | "help" | "leave";

/** `<`, `>` and `*` need Shift on most keyboards, and not on all. */
const typed = (key: string) => [{ key, shift: false }, { key, shift: true }];

/** What the viewer has, in its words. */
function asInViewer(...actions: Array<Action & PlayerAction>): Array<Binding<PlayerAction>> {
  return actions.flatMap((action) => BINDINGS.filter((binding) => binding.action === action).map((binding) => ({ ...binding, action })));
}

/** One of the player, in the page's language. */
function own(group: "recording" | "view" | "instrument" | "page", action: PlayerAction, keys: string, chords: readonly Chord[], repeats = false): Binding<PlayerAction> {
  return bind(text(`group_${group}`), action, keysIn(LANGUAGE, keys), text(`replay_key_${action}` as TextKey), chords, repeats);
}

export const PLAYER_BINDINGS: ReadonlyArray<Binding<PlayerAction>> = [
  own("recording", "play", "Space", plain(" ")),
  own("recording", "frame_back", "← or ,", plain("arrowleft", ","), true),
  own("recording", "frame_on", "→ or .", plain("arrowright", "."), true),
  own("recording", "second_back", "Shift ← or Page Up", [{ key: "arrowleft", shift: true }, ...plain("pageup")], true),
  own("recording", "second_on", "Shift → or Page Down", [{ key: "arrowright", shift: true }, ...plain("pagedown")], true),
  own("recording", "begin", "Home", plain("home")),
  own("recording", "end", "End", plain("end")),
  own("recording", "slower", "<", typed("<")),
  own("recording", "faster", ">", typed(">")),
  own("recording", "moment_back", "[", plain("[")),
  own("recording", "moment_on", "]", plain("]")),
  own("recording", "bookmark", "*", typed("*")),
  own("recording", "align", "B", plain("b")),
  own("recording", "take_over", "A", plain("a")),
  ...asInViewer("reset_view"),
  own("view", "couple", "G", plain("g")),
  own("view", "turn_left", "J", plain("j"), true),
  own("view", "turn_right", "L", plain("l"), true),
  own("view", "turn_up", "I", plain("i"), true),
  own("view", "turn_down", "K", plain("k"), true),
  own("view", "nearer", "U", plain("u"), true),
  own("view", "further", "O", plain("o"), true),
  ...asInViewer("wireframe", "contacts", "forces", "fixed_nodes", "bodies", "theatre", "wipe", "outside", "detail"),
  own("instrument", "tool_1", "1", plain("1")),
  own("instrument", "tool_2", "2", plain("2")),
  own("instrument", "tool_3", "3", plain("3")),
  own("instrument", "tool_4", "4", plain("4")),
  own("instrument", "tool_5", "5", plain("5")),
  own("page", "screenshot", "S", plain("s")),
  own("page", "help", "H or F1", plain("h", "f1", "?")),
  own("page", "leave", "Esc or Q", plain("escape", "q")),
];

export const PLAYER_MOUSE: ReadonlyArray<readonly [string, string]> = [
  [text("replay_mouse_turn"), text("mouse_turn_does_alone")],
  [text("mouse_move"), text("mouse_move_does")],
  [text("mouse_zoom"), text("mouse_zoom_does")],
  [text("replay_mouse_curve"), text("replay_mouse_curve_does")],
];

export const PLAYER_BUTTONS: ButtonGroups<PlayerAction> = [
  [button("frame_back", text("replay_button_frame_back"), "←"), button("play", text("replay_button_play"), "␣"), button("frame_on", text("replay_button_frame_on"), "→")],
  [button("slower", text("replay_button_slower"), "<"), button("faster", text("replay_button_faster"), ">")],
  [button("moment_back", text("replay_button_moment_back"), "["), button("moment_on", text("replay_button_moment_on"), "]"), button("bookmark", text("replay_bookmark"), "*"), button("take_over", text("replay_button_take_over"), "A")],
  [button("couple", text("replay_button_couple"), "G"), button("align", text("replay_button_align"), "B")],
  [button("tool_1", "1", "1"), button("tool_2", "2", "2"), button("tool_3", "3", "3"), button("tool_4", "4", "4"), button("tool_5", "5", "5")],
  [button("reset_view", text("button_reset_view"), "R"), button("wireframe", text("button_wireframe"), "W"), button("fixed_nodes", text("button_fixed_nodes"), "T"), button("contacts", text("button_contacts"), "C"), button("forces", text("button_forces"), "F")],
  [button("theatre", text("button_theatre"), "N"), button("wipe", text("button_wipe"), "D"), button("outside", text("button_outside"), "⇧N")],
  [button("screenshot", text("button_screenshot"), "S"), button("help", text("button_help"), "H")],
];
