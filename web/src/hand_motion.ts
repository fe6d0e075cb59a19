/** What pointer and keys ask of the instrument in the hand; in the theatre view what turns the view leads the endoscope. */
import { Vector3 } from "three";
import type { PushHand } from "./controls";
import type { PushStart } from "./drag";
import type { Hands } from "./hands";
import { text } from "./language";
import { panned, turned, zoomed, type Orbit } from "./orbit";
import type { Messages } from "./overlays";
import type { Page } from "./page";
import type { Scene3d } from "./scene3d";
import { advanced, pivoted } from "./theatre/endoscope";
import type { Theatre } from "./theatre/view";
import type { ToolDriver } from "./tool_driver";

export interface MotionEvents {
  /** An instrument should move. */
  moved(): void;
  /** The view from outside should be another. */
  viewed(orbit: Orbit): void;
  /** Whether this page may move an instrument without taking it from anybody. */
  mayMove(tool: number): boolean;
}

export class HandMotion {
  /** Vertex nearest to the picked point of the last push. */
  pickedVertex: number | null = null;
  /** The instruments of the last pushes. */
  private readonly pushing: Record<PushHand, number> = { first: 0, second: 0 };

  constructor(
    private readonly scene: Scene3d,
    private readonly hands: Hands,
    private readonly theatre: Theatre,
    private readonly page: Page,
    private readonly messages: Messages,
    private readonly events: MotionEvents,
  ) {}

  isOnOrgan(x: number, y: number): boolean {
    return !this.theatre.leads(this.hands.chosen) && this.scene.pick(x, y) !== null;
  }

  /** With the instrument in the hand, or the one beside it. */
  pushBegin(x: number, y: number, hand: PushHand): boolean {
    const tool = hand === "first" ? this.hands.chosen : this.hands.second((other) => this.events.mayMove(other));
    const start = tool === null ? null : this.pushStart(x, y, tool);
    if (tool === null || start === null) return false;
    this.pushing[hand] = tool;
    this.hands.driverOf(tool).beginPush(start, this.scene.ray(x, y));
    this.events.moved();
    return true;
  }

  pushMove(x: number, y: number, hand: PushHand): void {
    this.pushedBy(hand)?.follow(this.scene.ray(x, y));
    this.events.moved();
  }

  pushEnd(hand: PushHand): void {
    this.pushedBy(hand)?.retract();
    this.events.moved();
  }

  /** The hand of a push; none if its instrument went with another scene. */
  private pushedBy(hand: PushHand): ToolDriver | null {
    const tool = this.pushing[hand];
    return this.hands.has(tool) ? this.hands.driverOf(tool) : null;
  }

  turn(dx: number, dy: number): void {
    const axes = this.scene.axes();
    const rad = this.theatre.pixel_rad;
    if (this.theatre.on) this.lead((tip_m, pivot_m) => pivoted(tip_m, pivot_m, axes, dx * rad, dy * rad));
    else this.events.viewed(turned(this.scene.orbit, dx, dy, this.scene.height));
  }

  move(dx: number, dy: number): void {
    if (!this.theatre.on) this.events.viewed(panned(this.scene.orbit, dx, dy, this.scene.height));
    else if (this.theatre.endoscope !== null) this.roll(-dx * this.theatre.pixel_rad, this.theatre.endoscope);
  }

  wheel(notches: number): void {
    if (this.hands.driver.wheel(notches)) this.events.moved();
    else if (this.theatre.on) this.lead((tip_m, pivot_m) => advanced(tip_m, pivot_m, notches));
    else this.events.viewed(zoomed(this.scene.orbit, notches));
  }

  /** Something else was asked of an instrument: the next frame says so. */
  wake(): void {
    this.events.moved();
  }

  /** Turns an instrument about its shaft. */
  roll(by_rad: number, tool = this.hands.chosen): void {
    this.hands.roll(tool, by_rad, this.scene.roll_rad(tool));
    this.events.moved();
  }

  /** Moves the tip along the screen (right, up, into). */
  nudge(direction: readonly [number, number, number], step_m: number, tool = this.hands.chosen): void {
    const current = this.scene.pose(tool);
    if (current === null) return;
    const { right, up, forward } = this.scene.axes();
    const [x, y, z] = direction;
    const offset = new Vector3().addScaledVector(right, x).addScaledVector(up, y).addScaledVector(forward, z);
    this.hands.driverOf(tool).nudge(offset.multiplyScalar(step_m), current);
    this.events.moved();
  }

  /** Sets the tip on the organ at the middle of the view. */
  place(): void {
    if (this.hands.driver.pushing) return;
    const start = this.pushStart(...this.scene.middle());
    if (start !== null) this.hands.driver.place(start);
    else this.messages.error(text("nothing_in_middle"));
  }

  /** What a push at a place of the canvas needs to know; null beside the organ. */
  private pushStart(x: number, y: number, tool = this.hands.chosen): PushStart | null {
    const start = this.scene.pushStart(x, y, tool);
    if (start === null) return null;
    this.pickedVertex = start.vertex;
    this.page.hint.classList.add("gone");
    return start;
  }

  /** Leads the endoscope's tip about its trocar, or about its handle where it has none. */
  private lead(to: (tip_m: Vector3, pivot_m: Vector3) => Vector3): void {
    const { endoscope, info } = this.theatre;
    const current = endoscope === null ? null : this.scene.pose(endoscope);
    if (endoscope === null || info === null || current === null) return;
    const driver = this.hands.driverOf(endoscope);
    const pivot_m = info.trocar_m === null ? current.tip_m.clone().addScaledVector(current.shaft, info.shaft_length_m) : new Vector3(...info.trocar_m);
    driver.lead(to(driver.goal_m ?? current.tip_m, pivot_m), pivot_m, current);
    this.events.moved();
  }
}
