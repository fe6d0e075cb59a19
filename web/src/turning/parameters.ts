/** What can be turned while the simulation runs, as the server tells it (docs/protocol.md), and how it is shown: in units that people use. */
import { fail, fieldsOf, numberAt, stringAt, type Fields } from "../fields";

/** Their order is that of the page. */
export const PARAMETERS = [
  "young_modulus",
  "poisson_ratio",
  "mass_damping",
  "stiffness_damping",
  "hand_stiffness",
  "hand_return_time",
  "hand_greatest_force",
  "gravity",
  "time_step",
] as const;
export type ParameterName = (typeof PARAMETERS)[number];

export interface ParameterState {
  readonly name: ParameterName;
  readonly body: number;
  /** In SI, as the rest. */
  readonly value: number;
  readonly of_scene: number;
  /** What will hold in a moment; null where that is what holds. */
  readonly coming: number | null;
  readonly least: number;
  readonly greatest: number;
  /** Why it cannot be turned; null where it can. */
  readonly refusal: string | null;
}

export interface Parameters {
  readonly type: "parameters";
  /** The first organ's, in words. */
  readonly material: string;
  readonly parameters: readonly ParameterState[];
}

export function decodeParameters(fields: Fields): Parameters {
  const list = fields.parameters;
  if (!Array.isArray(list)) return fail("parameters: parameters is not a list");
  const states = list.map((item: unknown, i): ParameterState | null => {
    const place = `parameters[${i}]`;
    const state = fieldsOf(item, place);
    const found = stringAt(state, "name", place);
    // One of a later server is passed over.
    const name = PARAMETERS.find((known) => known === found);
    if (name === undefined) return null;
    return {
      name,
      body: numberAt(state, "body", place, 0),
      value: numberAt(state, "value", place),
      of_scene: numberAt(state, "of_scene", place),
      coming: state.coming === null ? null : numberAt(state, "coming", place),
      least: numberAt(state, "least", place),
      greatest: numberAt(state, "greatest", place),
      refusal: state.refusal === null ? null : stringAt(state, "refusal", place),
    };
  });
  return { type: "parameters", material: stringAt(fields, "material", "parameters"), parameters: states.filter((state) => state !== null) };
}

/** Unit on the page, and how many of it an SI unit is. */
const UNITS: Readonly<Record<ParameterName, readonly [unit: string, perSi: number]>> = {
  young_modulus: ["kPa", 1e-3],
  poisson_ratio: ["", 1],
  mass_damping: ["1/s", 1],
  stiffness_damping: ["ms", 1e3],
  hand_stiffness: ["N/mm", 1e-3],
  hand_return_time: ["ms", 1e3],
  hand_greatest_force: ["N", 1],
  gravity: ["m/s²", 1],
  time_step: ["ms", 1e3],
};

export const unitOf = (name: ParameterName): string => UNITS[name][0];

/** A value in the page's unit, to four figures. */
export function shownValue(name: ParameterName, value: number): number {
  return Number((value * UNITS[name][1]).toPrecision(4));
}

/** What was typed, in SI; null for what is no number, or out of the range. */
export function typedValue(state: Pick<ParameterState, "name" | "least" | "greatest">, typed: string): number | null {
  const number = Number(typed.trim().replace(",", "."));
  if (typed.trim() === "" || !Number.isFinite(number)) return null;
  // Not through a product that is a little off: 2.5 kPa is 2500 Pa.
  const value = Number((number / UNITS[state.name][1]).toPrecision(12));
  return value >= state.least && value <= state.greatest ? value : null;
}

/** What ↑ and ↓ make of a value: a tenth more or less to two figures, or a hundredth of it for a plain number; within the range. */
export function steppedValue(state: ParameterState, direction: 1 | -1): number {
  const now = state.coming ?? state.value;
  const wanted = state.name === "poisson_ratio" ? now + 0.01 * direction : stepped(now, direction, state.greatest);
  return Math.min(state.greatest, Math.max(state.least, Number(wanted.toPrecision(4))));
}

function stepped(now: number, direction: 1 | -1, greatest: number): number {
  // Zero has no tenth.
  if (now === 0) return direction > 0 ? greatest / 1000 : 0;
  const wanted = direction > 0 ? now * 1.1 : now / 1.1;
  return Number(wanted.toPrecision(2)) === Number(now.toPrecision(2)) ? wanted : Number(wanted.toPrecision(2));
}
