/** What input devices do: which instrument a gamepad moves, by which sticks and buttons, and what keys that are foot pedals do. Kept for each device. */
import { ACTIONS, TOOL_ACTIONS, type Action } from "../actions";

export const MOTIONS = ["right", "up", "into", "roll"] as const;
export type Motion = (typeof MOTIONS)[number];

/** A stick's axis; null: none. */
export interface AxisUse {
  readonly axis: number | null;
  readonly inverted: boolean;
}

export interface PadMapping {
  /** Number of the instrument that it moves; null: the one in the hand, as pointer and keys do. */
  readonly instrument: number | null;
  /** Sticks at rest are rarely at zero. */
  readonly deadZone: number;
  /** Speed of the tip with a stick at its end [m/s]. */
  readonly speed_m_per_s: number;
  readonly axes: Readonly<Record<Motion, AxisUse>>;
  /** What the buttons do when they go down, by their number. */
  readonly buttons: Readonly<Record<number, Action>>;
}

/** Of a gamepad that nobody mapped, in the standard mapping of the Gamepad API: a slow hand. */
export const USUAL_PAD: PadMapping = {
  instrument: null,
  deadZone: 0.15,
  speed_m_per_s: 0.05,
  axes: {
    right: { axis: 0, inverted: false },
    up: { axis: 1, inverted: true },
    into: { axis: 3, inverted: true },
    roll: { axis: null, inverted: false },
  },
  buttons: { 0: "trigger", 1: "jaws", 2: "cut", 3: "tool_place", 4: "undo", 8: "reset_view", 9: "pause" },
};

export const DEAD_ZONES = { least: 0, greatest: 0.9 } as const;
export const SPEEDS_M_PER_S = { least: 0.005, greatest: 0.3 } as const;

/** A key that is a foot pedal. */
export interface Pedal {
  readonly action: Action;
  readonly instrument: number | null;
  /** Trigger and jaws: as long as it is pressed, as pedals of an operating room do; else each press turns them. */
  readonly whileHeld: boolean;
}

/** By `KeyboardEvent.code`. */
export type Pedals = Readonly<Record<string, Pedal>>;
export type PadMappings = Readonly<Record<string, PadMapping>>;

const MOST_DEVICES = 16;
const MOST_NUMBER = 64;

const isRecord = (value: unknown): value is Record<string, unknown> => typeof value === "object" && value !== null && !Array.isArray(value);
const actionOf = (value: unknown): Action | null => ACTIONS.find((action) => action === value) ?? null;
const within = (value: unknown, least: number, greatest: number, usual: number): number =>
  typeof value === "number" && value >= least && value <= greatest ? value : usual;
const numberOrNull = (value: unknown, most: number): number | null =>
  typeof value === "number" && Number.isInteger(value) && value >= 0 && value < most ? value : null;

function axisOf(value: unknown, usual: AxisUse): AxisUse {
  if (!isRecord(value)) return usual;
  return { axis: numberOrNull(value.axis, MOST_NUMBER), inverted: value.inverted === true };
}

function padOf(value: unknown): PadMapping {
  if (!isRecord(value)) return USUAL_PAD;
  const axes = isRecord(value.axes) ? value.axes : {};
  const buttons: Record<number, Action> = {};
  const kept = isRecord(value.buttons) ? value.buttons : USUAL_PAD.buttons;
  for (const [number, found] of Object.entries(kept)) {
    const action = actionOf(found);
    if (action !== null && numberOrNull(Number(number), MOST_NUMBER) !== null) buttons[Number(number)] = action;
  }
  return {
    instrument: numberOrNull(value.instrument, TOOL_ACTIONS.length),
    deadZone: within(value.deadZone, DEAD_ZONES.least, DEAD_ZONES.greatest, USUAL_PAD.deadZone),
    speed_m_per_s: within(value.speed_m_per_s, SPEEDS_M_PER_S.least, SPEEDS_M_PER_S.greatest, USUAL_PAD.speed_m_per_s),
    axes: {
      right: axisOf(axes.right, USUAL_PAD.axes.right),
      up: axisOf(axes.up, USUAL_PAD.axes.up),
      into: axisOf(axes.into, USUAL_PAD.axes.into),
      roll: axisOf(axes.roll, USUAL_PAD.axes.roll),
    },
    buttons,
  };
}

/** What of kept mappings is understood. */
export function padsOf(value: unknown): PadMappings {
  if (!isRecord(value)) return {};
  return Object.fromEntries(Object.entries(value).slice(0, MOST_DEVICES).map(([id, pad]) => [id, padOf(pad)]));
}

/** What of kept pedals is understood. */
export function pedalsOf(value: unknown): Pedals {
  if (!isRecord(value)) return {};
  const pedals: Record<string, Pedal> = {};
  for (const [code, found] of Object.entries(value).slice(0, MOST_DEVICES)) {
    const action = isRecord(found) ? actionOf(found.action) : null;
    if (action === null || !isRecord(found)) continue;
    pedals[code] = { action, instrument: numberOrNull(found.instrument, TOOL_ACTIONS.length), whileHeld: found.whileHeld === true };
  }
  return pedals;
}

/** A stick beyond its dead zone, from 0 there to 1 at its end; squared, so that small motions are fine. */
export function stick(value: number, deadZone: number): number {
  const beyond = (Math.abs(Number.isFinite(value) ? value : 0) - deadZone) / (1 - deadZone);
  return beyond <= 0 ? 0 : Math.sign(value) * Math.min(1, beyond) ** 2;
}

export interface PadState {
  readonly axes: readonly number[];
  readonly pressed: readonly boolean[];
}

export interface PadReading {
  /** To the right, up and into the screen [m]. */
  readonly motion_m: readonly [number, number, number];
  /** Of buttons that went down. */
  readonly actions: readonly Action[];
  readonly roll_rad: number;
}

/** A stick at its end turns the instrument about its shaft so fast [rad/s]. */
const ROLL_RAD_PER_S = Math.PI / 2;

/** What a gamepad says in `dt_s` seconds. */
export function readPad(now: PadState, before: PadState | null, dt_s: number, { axes, deadZone, speed_m_per_s, buttons }: PadMapping): PadReading {
  const of = (motion: Motion): number => {
    const { axis, inverted } = axes[motion];
    const way = axis === null ? 0 : stick(now.axes[axis] ?? 0, deadZone);
    return inverted && way !== 0 ? -way : way;
  };
  const reach_m = speed_m_per_s * dt_s;
  const actions: Action[] = [];
  for (const [number, action] of Object.entries(buttons)) {
    const button = Number(number);
    if (now.pressed[button] === true && before !== null && before.pressed[button] !== true) actions.push(action);
  }
  return { motion_m: [of("right") * reach_m, of("up") * reach_m, of("into") * reach_m], roll_rad: of("roll") * ROLL_RAD_PER_S * dt_s, actions };
}
