/** Gamepads move instruments, each as it is mapped (`input_devices/mapping.ts`): two of them, or one beside the pointer, two instruments at once. */
import type { Action } from "./actions";
import { readPad, USUAL_PAD, type PadMapping, type PadState } from "./input_devices/mapping";

/** How long a shake lasts, and how often it is renewed [ms]. */
const RUMBLE_MS = 120;
const RUMBLE_EVERY_MS = 50;

/** What gamepads do; `tool` is null for the instrument in the hand. */
export interface PadEvents {
  move(motion_m: readonly [number, number, number], tool: number | null): void;
  roll(by_rad: number, tool: number | null): void;
  act(action: Action, tool: number | null): void;
  /** How strongly one that moves this instrument should shake, 0 to 1. */
  rumble(tool: number | null): number;
  /** How a gamepad of such a name is mapped (`namesOf`). */
  mapping(name: string): PadMapping | undefined;
}

interface Known {
  before: PadState;
  shaken_ms: number;
}

export function stateOf(pad: Gamepad): PadState {
  return { axes: [...pad.axes], pressed: pad.buttons.map((button) => button.pressed) };
}

/** The gamepads that are there. */
export function connectedPads(): Gamepad[] {
  return navigator.getGamepads().filter((pad): pad is Gamepad => pad?.connected === true);
}

/** What each gamepad is kept by: its model, and a number from the second one of a model on, which stays as long as it is connected. */
export class PadNames {
  private readonly known = new Map<number, { readonly id: string; readonly name: string }>();

  /** The names of all that are connected now. */
  of(pads: ReadonlyArray<{ readonly id: string; readonly index: number }>): string[] {
    for (const [index, { id }] of this.known) {
      if (!pads.some((pad) => pad.index === index && pad.id === id)) this.known.delete(index);
    }
    return pads.map(({ id, index }) => {
      const taken = new Set([...this.known.values()].map(({ name }) => name));
      let n = 1;
      const named = (): string => (n === 1 ? id : `${id} (${n})`);
      while (taken.has(named())) n += 1;
      const name = this.known.get(index)?.name ?? named();
      this.known.set(index, { id, name });
      return name;
    });
  }
}

/** Those of this page. */
export const padNames = new PadNames();

/** Looks at all gamepads once a frame for as long as there is one. */
export class GamepadInput {
  private readonly known = new Map<number, Known>();
  private last_ms: number | null = null;
  private running = false;
  /** They are tried out, and move nothing. */
  isTried = false;

  constructor(private readonly events: PadEvents) {
    window.addEventListener("gamepadconnected", () => this.start());
  }

  private start(): void {
    if (this.running) return;
    this.running = true;
    requestAnimationFrame((now_ms) => this.frame(now_ms));
  }

  /** Renews the effect while there is something to feel; without news it ends by itself. */
  private shake(pad: Gamepad, known: Known, strength: number, now_ms: number): void {
    if (strength === 0 || now_ms - known.shaken_ms < RUMBLE_EVERY_MS) return;
    known.shaken_ms = now_ms;
    // Not every browser has it, and it refuses while the page is hidden.
    void pad.vibrationActuator?.playEffect("dual-rumble", {
      duration: RUMBLE_MS,
      strongMagnitude: strength,
      weakMagnitude: strength / 2,
    }).catch(() => undefined);
  }

  private frame(now_ms: number): void {
    const pads = connectedPads();
    if (pads.length === 0) {
      this.running = false;
      this.known.clear();
      this.last_ms = null;
      return;
    }
    const dt_s = Math.min(0.1, Math.max(0, (now_ms - (this.last_ms ?? now_ms)) / 1000));
    this.last_ms = now_ms;
    for (const index of this.known.keys()) if (!pads.some((pad) => pad.index === index)) this.known.delete(index);
    const names = padNames.of(pads);
    pads.forEach((pad, i) => this.read(pad, names[i], dt_s, now_ms));
    requestAnimationFrame((next_ms) => this.frame(next_ms));
  }

  private read(pad: Gamepad, name: string, dt_s: number, now_ms: number): void {
    const now = stateOf(pad);
    const known = this.known.get(pad.index);
    const mapping = this.events.mapping(name) ?? USUAL_PAD;
    const { motion_m, roll_rad, actions } = readPad(now, known?.before ?? null, dt_s, mapping);
    const next = { before: now, shaken_ms: known?.shaken_ms ?? 0 };
    this.known.set(pad.index, next);
    if (this.isTried) return;
    const { instrument } = mapping;
    this.shake(pad, next, this.events.rumble(instrument), now_ms);
    if (motion_m.some((x) => x !== 0)) this.events.move(motion_m, instrument);
    if (roll_rad !== 0) this.events.roll(roll_rad, instrument);
    for (const action of actions) this.events.act(action, instrument);
  }
}
