/** The pointer draws on the tissue: a stroke while a button is held, a place where it is only pressed. */
import { atRest } from "./on_surface";
import type { Vec3 } from "./fields";
import type { ClientMessage } from "./protocol";
import type { Scene3d } from "./scene3d";

/** Points of a stroke at most, as the server takes them, and how far apart at least [m]. */
const MOST_POINTS = 200;
const APART_M = 1e-3;
/** Others are told so often where the pointer is [ms]. */
const TELL_EVERY_MS = 80;

export class Drawing {
  private on = false;
  private stroke: Vec3[] | null = null;
  private told_ms = 0;

  constructor(
    private readonly scene: Scene3d,
    private readonly send: (message: ClientMessage) => void,
  ) {
    const { canvas } = scene;
    // Before the listeners that push and turn.
    const heard = (what: (event: PointerEvent) => void) => (event: PointerEvent): void => {
      if (!this.on || event.button > 0) return;
      event.stopImmediatePropagation();
      what(event);
    };
    canvas.addEventListener("pointerdown", heard((event) => {
      canvas.setPointerCapture(event.pointerId);
      this.stroke = [];
      this.extend(event);
    }), { capture: true });
    canvas.addEventListener("pointermove", heard((event) => this.extend(event)), { capture: true });
    canvas.addEventListener("pointerup", heard(() => this.end()), { capture: true });
    canvas.addEventListener("pointercancel", heard(() => this.end()), { capture: true });
  }

  turn(on: boolean): void {
    this.on = on;
    this.stroke = null;
    if (!on) this.send({ type: "point", at_m: null });
  }

  private extend(event: PointerEvent): void {
    const { left, top } = this.scene.canvas.getBoundingClientRect();
    const at = this.at(event.clientX - left, event.clientY - top);
    if (at === null) return;
    const last = this.stroke?.at(-1);
    const far = last === undefined || Math.hypot(at[0] - last[0], at[1] - last[1], at[2] - last[2]) > APART_M;
    if (this.stroke !== null && far && this.stroke.length < MOST_POINTS) this.stroke.push(at);
    if (event.timeStamp - this.told_ms < TELL_EVERY_MS) return;
    this.told_ms = event.timeStamp;
    this.send({ type: "point", at_m: at });
  }

  private end(): void {
    if (this.stroke !== null && this.stroke.length > 0) this.send({ type: "draw", points_m: this.stroke });
    this.stroke = null;
  }

  /** The place of the tissue at rest under a place of the canvas. */
  private at(x: number, y: number): Vec3 | null {
    const pick = this.scene.pick(x, y);
    const organ = pick === null ? undefined : this.scene.organs.get(pick.organ);
    if (pick === null || organ === undefined) return null;
    const [a, b, c] = organ.triangles.subarray(3 * pick.triangle, 3 * pick.triangle + 3);
    const rest = atRest(pick.point_m, [a, b, c], organ.positions_m, organ.topology.rest_m);
    return [rest.x, rest.y, rest.z];
  }

  /** A place without a pointer: that of the tissue nearest to the tip of the instrument in the hand. */
  markTip(tip_m: Vec3): void {
    const organ = this.scene.organs.get(0);
    if (organ === undefined) return;
    const { positions_m, topology: { rest_m } } = organ;
    let [nearest, least_m] = [0, Infinity];
    for (let i = 0; i < positions_m.length; i += 3) {
      const away_m = Math.hypot(positions_m[i] - tip_m[0], positions_m[i + 1] - tip_m[1], positions_m[i + 2] - tip_m[2]);
      if (away_m < least_m) [nearest, least_m] = [i, away_m];
    }
    this.send({ type: "draw", points_m: [[rest_m[nearest], rest_m[nearest + 1], rest_m[nearest + 2]]] });
  }
}
