/** Keys, pedals and gamepads: what they ask for goes to the viewer; pointers are `controls.ts`. */
import { TOOL_ACTIONS, type Action } from "../actions";
import type { Connection } from "../connection";
import { GamepadInput } from "../gamepad";
import type { HandMotion } from "../hand_motion";
import type { Hands } from "../hands";
import { actionOf, isForPart } from "../keys";
import type { LoopNews } from "../timing";
import { Devices, type DevicesNow } from "./dialog";
import type { Pedal } from "./mapping";

export interface InputEvents {
  /** `tool`: of which instrument; that in the hand where it is not told. */
  run(action: Action, shift: boolean, tool?: number): void;
  now(): DevicesNow;
  changed(): void;
}

export class Inputs {
  readonly devices: Devices;

  constructor(
    connection: () => Connection,
    private readonly hands: Hands,
    private readonly motion: HandMotion,
    news: LoopNews,
    private readonly events: InputEvents,
  ) {
    const tool = (number: number | null): number | undefined => (number !== null && hands.has(number) ? number : undefined);
    const pads = new GamepadInput({
      move: (motion_m, number) => motion.nudge(motion_m, 1, tool(number)),
      roll: (by_rad, number) => motion.roll(by_rad, tool(number)),
      act: (action, number) => events.run(action, false, tool(number)),
      rumble: (number) => news.rumble(number ?? hands.chosen),
      mapping: (name) => this.devices.pads[name],
    });
    this.devices = new Devices(document.body, () => events.now(), (message) => {
      connection().send(message);
      // Who takes an instrument has it in the hand.
      if (message.type === "hold" && message.held) events.run(TOOL_ACTIONS[message.tool], false);
    }, (open) => {
      pads.isTried = open;
      events.changed();
    });
    window.addEventListener("keydown", (event) => this.key(event, true));
    window.addEventListener("keyup", (event) => this.key(event, false));
  }

  private key(event: KeyboardEvent, isDown: boolean): void {
    if (isForPart(event)) return;
    const pedal = this.devices.pedals[event.code];
    if (pedal !== undefined && !this.devices.open && !event.ctrlKey && !event.altKey && !event.metaKey) {
      event.preventDefault();
      if (!event.repeat) this.pedal(pedal, isDown);
      return;
    }
    const action = isDown ? actionOf(event) : null;
    if (action === null) return;
    event.preventDefault();
    this.events.run(action, event.shiftKey);
  }

  private pedal({ action, instrument, whileHeld }: Pedal, isDown: boolean): void {
    const tool = instrument !== null && this.hands.has(instrument) ? instrument : this.hands.chosen;
    if (whileHeld && (action === "trigger" || action === "jaws")) {
      this.hands.hold(action, isDown, tool);
      this.motion.wake();
    } else if (isDown) {
      this.events.run(action, false, tool);
    }
  }
}
