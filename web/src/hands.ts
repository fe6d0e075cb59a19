/** What this page asks of the instruments: one hand for each, one of them moved by the pointer and the keys. */
import type { ToolPose } from "./drag";
import { text } from "./language";
import type { Messages } from "./overlays";
import type { ClientMessage, Hello, SnapshotHeader, Vec3 } from "./protocol";
import { ToolDriver } from "./tool_driver";

interface Hand {
  readonly driver: ToolDriver;
  /** How far the jaws are open at home. */
  readonly homeJaw: number;
  jaw: number;
  trigger: number;
  /** Angle about the shaft that was asked for [rad]; null until then: it stays as the server has it. */
  roll_rad: number | null;
  /** Jaws or trigger changed since the last message. */
  unsent: boolean;
}

const newHand = (homeJaw: number): Hand => ({
  driver: new ToolDriver(),
  homeJaw,
  jaw: homeJaw,
  trigger: 0,
  roll_rad: null,
  unsent: false,
});

export class Hands {
  private hands: Hand[] = [newHand(0)];
  /** Whether each is an endoscope. */
  private looks: boolean[] = [false];
  /** Number of the instrument that pointer and keys move. */
  chosen = 0;

  /** A scene; the hands stay where they are if it has as many (another model took over). */
  begin(hello: Hello): void {
    if (this.hands.length !== hello.tools.length) this.hands = hello.tools.map((tool) => newHand(tool.home_jaw));
    else this.hands = this.hands.map((hand, i) => ({ ...hand, homeJaw: hello.tools[i].home_jaw }));
    this.looks = hello.tools.map(({ optics }) => optics !== null);
    this.chosen = Math.min(this.chosen, hello.tools.length - 1);
  }

  get driver(): ToolDriver {
    return this.hands[this.chosen].driver;
  }

  /** The instrument of a second pointer: the next one after that in the hand that is no endoscope and may be moved; null if there is none. */
  second(mayMove: (tool: number) => boolean): number | null {
    const n = this.hands.length;
    const others = Array.from({ length: n - 1 }, (_, i) => (this.chosen + 1 + i) % n);
    return others.find((tool) => !this.looks[tool] && mayMove(tool)) ?? null;
  }

  /** Whether some hand pushes. */
  get pushing(): boolean {
    return this.hands.some(({ driver }) => driver.pushing);
  }

  /** How that in the hand is asked to be. */
  get state(): { readonly jaw: number; readonly trigger: number } {
    return this.hands[this.chosen];
  }

  driverOf(tool: number): ToolDriver {
    return this.hands[tool].driver;
  }

  get settled(): boolean {
    return this.hands.every(({ driver }) => driver.settled);
  }

  /** All instruments are where the server says. */
  forget(): void {
    this.hands = this.hands.map(({ homeJaw }) => newHand(homeJaw));
  }

  /** Closes or opens the jaws of an instrument, or switches it on or off. */
  press(what: "jaws" | "trigger", tool = this.chosen): void {
    const hand = this.hands[tool];
    this.hold(what, what === "jaws" ? hand.jaw > 0.5 : hand.trigger <= 0.5, tool);
  }

  /** The jaws of an instrument are closed, or it is on: as long as a pedal is pressed, say. */
  hold(what: "jaws" | "trigger", isHeld: boolean, tool = this.chosen): void {
    const hand = this.hands[tool];
    if (what === "jaws") hand.jaw = isHeld ? 0 : 1;
    else hand.trigger = isHeld ? 1 : 0;
    hand.unsent = true;
  }

  /** Whether there is an instrument of that number. */
  has(tool: number): boolean {
    return tool < this.hands.length;
  }

  /** Turns an instrument about its shaft; `shown_rad` is how it is turned as shown. */
  roll(tool: number, by_rad: number, shown_rad: number): void {
    this.hands[tool].roll_rad = (this.hands[tool].roll_rad ?? shown_rad) + by_rad;
    this.hands[tool].unsent = true;
  }

  /** Takes another instrument; false if there is none of that number. */
  choose(tool: number, messages: Messages): boolean {
    const { length } = this.hands;
    if (tool < length) this.chosen = tool;
    else messages.error(text("no_instrument", { n: tool + 1, m: length }));
    return tool < length;
  }

  /** What the server is told about an instrument that should be at `pose`. */
  message(tool: number, pose: ToolPose, header: SnapshotHeader | null): ClientMessage {
    const { jaw, trigger, roll_rad } = this.hands[tool];
    const [tip_m, shaft] = [pose.tip_m, pose.shaft].map((v): Vec3 => [v.x, v.y, v.z]);
    return { type: "tool", tool, tip_m, shaft, roll_rad: roll_rad ?? header?.tools[tool]?.roll_rad ?? 0, jaw, trigger };
  }

  /** One frame of `dt_s`: the poses to send. `shown` is where an instrument is that was not moved yet. */
  advance(dt_s: number, shown: (tool: number) => ToolPose | null): Array<{ tool: number; pose: ToolPose }> {
    const poses: Array<{ tool: number; pose: ToolPose }> = [];
    this.hands.forEach((hand, tool) => {
      let pose = hand.driver.advance(dt_s);
      if (pose === null && hand.unsent) pose = hand.driver.pose ?? shown(tool);
      if (pose === null) return;
      hand.unsent = false;
      poses.push({ tool, pose });
    });
    return poses;
  }
}
