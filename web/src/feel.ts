/** What a hand would feel that this page holds as a device (`glisson serve --device viewer`). */
import { fail, fieldsOf, numberAt, vec3At, type Fields, type Vec3 } from "./fields";

export interface FeltHand {
  /** Number of the instrument. */
  readonly tool: number;
  /** In the patient frame [N]. */
  readonly force_n: Vec3;
  /** Whether a page in control holds it; otherwise it stays where it was left. */
  readonly is_held: boolean;
}

export interface Feel {
  readonly type: "feel";
  /** The largest force that is told [N]. */
  readonly greatest_force_n: number;
  readonly hands: readonly FeltHand[];
}

const MOST_HANDS = 4;

export function decodeFeel(fields: Fields): Feel {
  const { hands } = fields;
  if (!Array.isArray(hands) || hands.length > MOST_HANDS) fail(`feel.hands must be an array of at most ${MOST_HANDS}`);
  return {
    type: "feel",
    greatest_force_n: numberAt(fields, "greatest_force_n", "feel", 0),
    hands: hands.map((item: unknown, i) => {
      const place = `feel.hands[${i}]`;
      const hand = fieldsOf(item, place);
      return { tool: numberAt(hand, "tool", place, 0), force_n: vec3At(hand, "force_n", place), is_held: hand.is_held === true };
    }),
  };
}

/** The hand that holds an instrument as a device; null where none does. */
export function handOf(feel: Feel | null, tool: number): FeltHand | null {
  return feel?.hands.find((hand) => hand.tool === tool) ?? null;
}

/** A gamepad shakes as strongly as it can from this force on [N]: a choice, a firm push into an organ. */
export const FULL_RUMBLE_N = 3;
/** Below this share it would only be heard. */
const LEAST_RUMBLE = 0.03;

/** How strongly a gamepad shakes, 0 to 1. */
export function rumble(feel: Feel | null, tool: number): number {
  const hand = handOf(feel, tool);
  if (hand === null || !hand.is_held) return 0;
  const share = Math.min(1, Math.hypot(...hand.force_n) / FULL_RUMBLE_N);
  return share < LEAST_RUMBLE ? 0 : share;
}
