/** What the server tells about its loops, and about who controls. */
import { text } from "./language";
import { SlowMotion } from "./slow_motion";
import { rumble, type Feel } from "./feel";
import type { Parameters } from "./turning/parameters";
import { fail, fieldsOf, numberAt, stringAt, type Fields } from "./fields";

/** Whether this viewer controls, and whether anybody does. */
export interface Role {
  readonly type: "role";
  readonly role: "controller" | "viewer";
  readonly control_is_taken: boolean;
  /** Who has each instrument in the hand. */
  readonly instruments: readonly Holder[];
}

/** Who controls, or who takes it that is offered; this page, or another one that took it. */
const HOLDERS = ["controller", "offered", "this", "another"] as const;
export type Holder = (typeof HOLDERS)[number];

/** Whether this page may move an instrument without taking control from anybody. */
export function mayMove(role: Role | null, tool: number): boolean {
  if (role === null) return true;
  const holder = role.instruments[tool] ?? "controller";
  return role.role === "controller" ? holder !== "another" : holder === "this";
}

export interface HapticTiming {
  readonly rate_hz: number;
  readonly deadlines: number;
  readonly missed_deadlines: number;
  /** 50 % and 99.9 % of the intervals between two ticks are off by no more than this. */
  readonly jitter_p50_us: number;
  readonly jitter_p999_us: number;
  readonly motion_to_force_p50_us: number;
  readonly tick_p50_us: number;
  readonly tick_p99_us: number;
  readonly tick_p999_us: number;
  /** Time from one deadline to the next. */
  readonly period_us: number;
  /** Ends of octaves [us] and how many intervals are off by so much. */
  readonly jitter_histogram_us: readonly (readonly [number, number])[];
  readonly model_age_p50_ms: number;
  readonly model_age_max_ms: number;
  /** How the loop is scheduled, in words. */
  readonly scheduling: string;
}

/** What the simulation's steps take, and how often displays get a state. */
export interface StepTiming {
  readonly steps: number;
  readonly p50_us: number;
  readonly p99_us: number;
  readonly p999_us: number;
  /** What a step may take in real time: the scene's time step. */
  readonly budget_us: number;
  readonly over_budget: number;
  readonly frame_p50_ms: number;
  readonly frame_p999_ms: number;
  /** What the server aims at. */
  readonly frame_budget_ms: number;
}

/** Where the loop is that gives forces to hands: at the machine with `--role haptics`, which knows its times, or here. */
const HAPTICS_AT = ["nowhere", "here", "other_machine"] as const;
export type HapticsAt = (typeof HAPTICS_AT)[number];

export interface Timing {
  readonly type: "timing";
  readonly times_given_up: number;
  readonly left_out_s: number;
  /** How thoroughly steps are computed: full, reduced or least. */
  readonly effort: string;
  /** Simulated seconds in a second that were asked for. */
  readonly speed: number;
  readonly steps: StepTiming;
  /** Null without a force-feedback device at this machine. */
  readonly haptics: HapticTiming | null;
  readonly haptics_at: HapticsAt;
}

export function decodeRole(fields: Fields): Role {
  const role = stringAt(fields, "role", "role");
  if (role !== "controller" && role !== "viewer") fail(`role "${role.slice(0, 40)}"; allowed: controller, viewer`);
  return { type: "role", role, control_is_taken: fields.control_is_taken === true, instruments: holdersAt(fields) };
}

function holdersAt({ instruments }: Fields): Holder[] {
  // Recordings and earlier servers have none.
  if (!Array.isArray(instruments)) return [];
  return instruments.map((found) => HOLDERS.find((holder) => holder === found) ?? fail(`role: instruments has "${String(found).slice(0, 40)}"; allowed: ${HOLDERS.join(", ")}`));
}

export function decodeTiming(fields: Fields): Timing {
  const simulation = fieldsOf(fields.simulation, "timing.simulation");
  return {
    type: "timing",
    times_given_up: numberAt(simulation, "times_given_up", "timing.simulation", 0),
    left_out_s: numberAt(simulation, "left_out_s", "timing.simulation", 0),
    effort: stringAt(simulation, "effort", "timing.simulation"),
    speed: simulation.speed === undefined ? 1 : numberAt(simulation, "speed", "timing.simulation", 0.01),
    steps: decodeSteps(simulation),
    haptics: fields.haptics === null ? null : decodeHaptics(fieldsOf(fields.haptics, "timing.haptics")),
    haptics_at: decodePlace(stringAt(fields, "haptics_at", "timing")),
  };
}

/** A figure of a histogram that a part of the message has. */
function figureOf(fields: Fields, place: string): (histogram: string, name: string) => number {
  return (histogram, name) => numberAt(fieldsOf(fields[histogram], `${place}.${histogram}`), name, `${place}.${histogram}`, 0);
}

function decodeSteps(simulation: Fields): StepTiming {
  const place = "timing.simulation";
  const at = figureOf(simulation, place);
  return {
    steps: numberAt(simulation, "steps", place, 0),
    p50_us: at("step_us", "p50"),
    p99_us: at("step_us", "p99"),
    p999_us: at("step_us", "p999"),
    budget_us: numberAt(simulation, "step_budget_us", place, 0),
    over_budget: numberAt(simulation, "steps_over_budget", place, 0),
    frame_p50_ms: at("frame_ms", "p50"),
    frame_p999_ms: at("frame_ms", "p999"),
    frame_budget_ms: numberAt(simulation, "frame_budget_ms", place, 0),
  };
}

function decodePlace(found: string): HapticsAt {
  return HAPTICS_AT.find((place) => place === found) ?? fail(`haptics_at "${found.slice(0, 40)}"; allowed: ${HAPTICS_AT.join(", ")}`);
}

function histogramAt(value: unknown, place: string): [number, number][] {
  if (!Array.isArray(value) || value.length > 64) fail(`${place} must be an array of at most 64 pairs`);
  return value.map((pair: unknown) => {
    if (!Array.isArray(pair) || pair.length !== 2 || !pair.every((x) => typeof x === "number" && x >= 0)) {
      fail(`${place} must hold pairs of numbers that are not negative`);
    }
    return [pair[0], pair[1]];
  });
}

/** `▁▃█▂ 1 to 64 us`: counts of octaves, the tallest one full. */
export function histogramText(histogram: HapticTiming["jitter_histogram_us"]): string {
  if (histogram.length === 0) return "nothing counted yet";
  const most = Math.max(1, ...histogram.map(([, count]) => count));
  const bars = "▁▂▃▄▅▆▇█";
  // By the logarithm: what is rare matters most.
  const height = (count: number): number => Math.min(7, Math.ceil((7 * Math.log1p(count)) / Math.log1p(most)));
  const us = (end: number): string => (end < 10 ? end.toFixed(1) : end.toFixed(0));
  return `${histogram.map(([, count]) => bars[height(count)]).join("")} ${us(histogram[0][0])} to ${us(histogram[histogram.length - 1][0])} us`;
}

function decodeHaptics(haptics: Fields): HapticTiming {
  const place = "timing.haptics";
  const at = figureOf(haptics, place);
  return {
    rate_hz: numberAt(haptics, "rate_hz", place, 0),
    deadlines: numberAt(haptics, "deadlines", place, 0),
    missed_deadlines: numberAt(haptics, "missed_deadlines", place, 0),
    jitter_p50_us: at("jitter_us", "p50"),
    jitter_p999_us: at("jitter_us", "p999"),
    motion_to_force_p50_us: at("motion_to_force_us", "p50"),
    tick_p50_us: at("tick_us", "p50"),
    tick_p99_us: at("tick_us", "p99"),
    tick_p999_us: at("tick_us", "p999"),
    period_us: numberAt(haptics, "period_us", place, 0),
    jitter_histogram_us: histogramAt(haptics.jitter_histogram_us, `${place}.jitter_histogram_us`),
    model_age_p50_ms: at("local_model_age_ms", "p50"),
    model_age_max_ms: at("local_model_age_ms", "max"),
    scheduling: stringAt(haptics, "scheduling", place),
  };
}

/** For the panel: `1000 Hz, 0.00 % missed`. */
export function hapticsText(haptics: HapticTiming): string {
  const missed = (100 * haptics.missed_deadlines) / Math.max(1, haptics.deadlines);
  return text("value_missed", { rate: haptics.rate_hz.toFixed(0), percent: missed.toFixed(2) });
}

/** For the panel: `3 µs, 99.9 % 41`. */
export function jitterText(haptics: HapticTiming): string {
  return `${haptics.jitter_p50_us.toFixed(0)} µs, 99.9 % ${haptics.jitter_p999_us.toFixed(0)}`;
}

/** For the panel: what a tick takes of its period, `4 of 1000 us, 99.9 % 7`. */
export function tickText(haptics: HapticTiming): string {
  const [tick, period, most] = [haptics.tick_p50_us, haptics.period_us, haptics.tick_p999_us].map((us) => us.toFixed(0));
  return text("value_tick", { tick, period, most });
}

/** For the panel where no loop tells its times; null without news. */
export function whereHapticsAre(timing: Timing | null): string | null {
  if (timing === null) return null;
  return text(`value_${timing.haptics_at}`);
}

/** What steps take of their budget, how many took longer, and how often a state is published; two lines. */
function stepLines(steps: StepTiming): string[] {
  if (steps.steps === 0) return ["  a step      none yet"];
  const over = ((100 * steps.over_budget) / steps.steps).toFixed(2);
  return [
    `  a step      ${steps.p50_us.toFixed(0)} us, 99 % ${steps.p99_us.toFixed(0)} us, 99.9 % ${steps.p999_us.toFixed(0)} us, of ${steps.budget_us.toFixed(0)} us; ${over} % took longer`,
    `  published   every ${steps.frame_p50_ms.toFixed(1)} ms, 99.9 % ${steps.frame_p999_ms.toFixed(1)} ms; wanted ${steps.frame_budget_ms.toFixed(0)} ms`,
  ];
}

/** Lines for the times (key P). */
export function timingLines(timing: Timing | null): string[] {
  if (timing === null) return [];
  const lines = [
    `steps         ${timing.effort} effort; fell behind ${timing.times_given_up} times, ${timing.left_out_s.toFixed(1)} s left out`,
    ...stepLines(timing.steps),
  ];
  const { haptics } = timing;
  if (haptics !== null) {
    lines.push(
      `haptics       ${hapticsText(haptics)} (${haptics.missed_deadlines} of ${haptics.deadlines})`,
      `  jitter      ${haptics.jitter_p50_us.toFixed(0)} us, 99.9 % ${haptics.jitter_p999_us.toFixed(0)} us; ${haptics.scheduling}`,
      `  histogram   ${histogramText(haptics.jitter_histogram_us)} (logarithmic)`,
      `  tick        ${haptics.tick_p50_us.toFixed(1)} us, 99 % ${haptics.tick_p99_us.toFixed(1)} us, 99.9 % ${haptics.tick_p999_us.toFixed(1)} us, of ${haptics.period_us.toFixed(0)} us`,
      `  force       ${haptics.motion_to_force_p50_us.toFixed(0)} us after the motion`,
      `  model       ${haptics.model_age_p50_ms.toFixed(1)} ms old, at most ${haptics.model_age_max_ms.toFixed(1)} ms`,
    );
  } else {
    lines.push(`haptics       ${whereHapticsAre(timing) ?? ""}`);
  }
  return lines;
}

/** The newest of each. */
export class LoopNews {
  role: Role | null = null;
  readonly slowMotion = new SlowMotion();
  timing: Timing | null = null;
  /** Null where no page is a device. */
  feel: Feel | null = null;
  parameters: Parameters | null = null;
  /** What else hears of them. */
  turned: (parameters: Parameters) => void = () => undefined;
  /** What to do when a connection brings some. */
  readonly events = {
    role: (role: Role): void => {
      this.role = role;
      this.changed();
    },
    timing: (timing: Timing): void => {
      this.timing = timing;
      this.slowMotion.hear(timing);
      this.changed();
    },
    parameters: (parameters: Parameters): void => {
      this.parameters = parameters;
      this.turned(parameters);
      this.changed();
    },
    feel: (feel: Feel): void => {
      this.feel = feel;
      this.felt(feel);
      this.changed();
    },
  };

  constructor(
    private readonly changed: () => void,
    private readonly felt: (feel: Feel) => void,
  ) {}

  /** Size of gravity, which may have been turned; null until the server told it. */
  get gravity_m_per_s2(): number | null {
    return this.parameters?.parameters.find(({ name }) => name === "gravity")?.value ?? null;
  }

  /** How strongly a gamepad shakes that moves this instrument, 0 to 1; only the page in control holds one. */
  rumble(tool: number): number {
    const isOurs = this.role?.role === "controller" || this.role?.instruments[tool] === "this";
    return isOurs ? rumble(this.feel, tool) : 0;
  }
}
