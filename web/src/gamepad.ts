/**
 * A gamepad moves the instrument in the hand: left stick right, left, up, down; right stick up and down
 * into the screen and out of it; buttons as listed in PAD_BUTTONS. Standard mapping of the Gamepad API.
 */
import type { Action } from "./keys";

/** Speed of the tip with a stick at its end [m/s]: a slow hand. */
export const PAD_SPEED_M_PER_S = 0.05;
/** Sticks at rest are rarely at zero. */
export const PAD_DEAD_ZONE = 0.15;

/** How long a shake lasts, and how often it is renewed [ms]. */
const RUMBLE_MS = 120;
const RUMBLE_EVERY_MS = 50;

export interface PadState {
  readonly axes: readonly number[];
  readonly pressed: readonly boolean[];
}

/** What the buttons do when they go down, by their number in the standard mapping. */
export const PAD_BUTTONS: ReadonlyMap<number, Action> = new Map<number, Action>([
  [0, "trigger"],
  [1, "jaws"],
  [2, "cut"],
  [3, "tool_place"],
  [4, "undo"],
  [8, "reset_view"],
  [9, "pause"],
]);

/** A stick beyond its dead zone, from 0 there to 1 at its end; squared, so that small motions are fine. */
export function stick(value: number): number {
  const beyond = (Math.abs(Number.isFinite(value) ? value : 0) - PAD_DEAD_ZONE) / (1 - PAD_DEAD_ZONE);
  return beyond <= 0 ? 0 : Math.sign(value) * Math.min(1, beyond) ** 2;
}

/** Motion in `dt_s` seconds to the right, up and into the screen [m], and the actions of buttons that went down. */
export function readPad(
  now: PadState,
  before: PadState | null,
  dt_s: number,
): { readonly motion_m: readonly [number, number, number]; readonly actions: readonly Action[] } {
  const reach_m = PAD_SPEED_M_PER_S * dt_s;
  const [right, down, , forwardBack] = [0, 1, 2, 3].map((axis) => stick(now.axes[axis] ?? 0));
  const actions: Action[] = [];
  for (const [button, action] of PAD_BUTTONS) {
    if (now.pressed[button] === true && before !== null && before.pressed[button] !== true) actions.push(action);
  }
  const minus = (x: number): number => (x === 0 ? 0 : -x);
  return { motion_m: [right * reach_m, minus(down) * reach_m, minus(forwardBack) * reach_m], actions };
}

/** Looks at the first gamepad once a frame for as long as there is one. */
export class GamepadInput {
  private before: PadState | null = null;
  private last_ms: number | null = null;
  private running = false;
  private shaken_ms = 0;

  constructor(
    private readonly move: (motion_m: readonly [number, number, number]) => void,
    private readonly act: (action: Action) => void,
    /** How strongly it should shake, 0 to 1. */
    private readonly rumble: () => number = () => 0,
  ) {
    window.addEventListener("gamepadconnected", () => this.start());
  }

  private start(): void {
    if (this.running) return;
    this.running = true;
    requestAnimationFrame((now_ms) => this.frame(now_ms));
  }

  /** Renews the effect while there is something to feel; without news it ends by itself. */
  private shake(pad: Gamepad, now_ms: number): void {
    const strength = this.rumble();
    const isDue = now_ms - this.shaken_ms >= RUMBLE_EVERY_MS;
    if (strength === 0 || !isDue) return;
    this.shaken_ms = now_ms;
    // Not every browser has it, and it refuses while the page is hidden.
    void pad.vibrationActuator?.playEffect("dual-rumble", {
      duration: RUMBLE_MS,
      strongMagnitude: strength,
      weakMagnitude: strength / 2,
    }).catch(() => undefined);
  }

  private frame(now_ms: number): void {
    const pad = navigator.getGamepads().find((candidate) => candidate?.connected === true) ?? null;
    if (pad === null) {
      this.running = false;
      this.before = null;
      this.last_ms = null;
      return;
    }
    const dt_s = Math.min(0.1, Math.max(0, (now_ms - (this.last_ms ?? now_ms)) / 1000));
    this.last_ms = now_ms;
    const now = { axes: [...pad.axes], pressed: pad.buttons.map((button) => button.pressed) };
    const { motion_m, actions } = readPad(now, this.before, dt_s);
    this.before = now;
    this.shake(pad, now_ms);
    if (motion_m.some((x) => x !== 0)) this.move(motion_m);
    actions.forEach((action) => this.act(action));
    requestAnimationFrame((next_ms) => this.frame(next_ms));
  }
}
