/**
 * Where the instrument should be, from pushes with the pointer, keys and the server's own word: one small state
 * machine without DOM. `advance` is called once a frame and gives the pose to send, or null when nothing changed.
 */
import { Vector3 } from "three";
import {
  APPROACH_GAP_M,
  moveTowards,
  PRESS_SPEED_M_PER_S,
  PRESS_STRIDE_M,
  Push,
  FOLLOW_SPEED_M_PER_S,
  FOLLOW_STRIDE_M,
  retractedTip,
  shaftDirection,
  depthAfterWheel,
  type PushStart,
  type Ray,
  type ToolPose,
} from "./drag";

/** A key places the tip this deep [m]: enough to be in contact. */
const PLACE_DEPTH_M = 0.0005;

type Mode =
  | { readonly kind: "idle" }
  | { readonly kind: "push"; readonly push: Push }
  /** Walks to `goal_m` and stays there; `slow` while it touches; its shaft goes through the pivot, if there is one. */
  | { readonly kind: "glide"; readonly goal_m: Vector3; readonly slow: boolean; readonly pivot_m?: Vector3 };

export class ToolDriver {
  private mode: Mode = { kind: "idle" };
  /** The pose last asked for; null until the first one, then the snapshot's pose holds. */
  private asked: ToolPose | null = null;
  private unsent = false;

  get pushing(): boolean {
    return this.mode.kind === "push";
  }

  /** True while this page holds the instrument somewhere. */
  get active(): boolean {
    return this.asked !== null;
  }

  get depth_m(): number | null {
    return this.mode.kind === "push" ? this.mode.push.depth_m : null;
  }

  /** The pose last asked for. */
  get pose(): ToolPose | null {
    return this.asked;
  }

  /** True when the tip is where the hand wants it. */
  get settled(): boolean {
    if (this.unsent) return false;
    if (this.mode.kind === "push") return this.mode.push.settled();
    if (this.mode.kind === "glide") return this.asked?.tip_m.equals(this.mode.goal_m) ?? true;
    return true;
  }

  beginPush(start: PushStart, ray: Ray): void {
    const push = new Push(start, ray);
    this.mode = { kind: "push", push };
    this.ask(push.pose());
  }

  follow(ray: Ray): void {
    if (this.mode.kind === "push") this.mode.push.follow(ray);
  }

  /** Wheel while pushing; false if there is no push. */
  wheel(notches: number): boolean {
    if (this.mode.kind !== "push") return false;
    this.mode.push.depth_m = depthAfterWheel(this.mode.push.depth_m, notches);
    return true;
  }

  /** Takes the tip off the organ, out along its shaft. */
  retract(): void {
    if (this.asked === null) return;
    this.mode = { kind: "glide", goal_m: retractedTip(this.asked), slow: false };
  }

  /** Sets the tip on the surface without a pointer. */
  place(start: PushStart): void {
    const shaft = shaftDirection(start.normal, start.view);
    const at = (height: number): Vector3 => start.hit_m.clone().addScaledVector(start.normal, height);
    this.ask({ tip_m: at(start.tipRadius_m + APPROACH_GAP_M), shaft });
    this.mode = { kind: "glide", goal_m: at(start.tipRadius_m - PLACE_DEPTH_M), slow: true };
  }

  /** Moves the tip by `offset_m`; `current` is where the instrument is shown. */
  nudge(offset_m: Vector3, current: ToolPose): void {
    if (this.mode.kind === "push") return;
    const goal = this.mode.kind === "glide" ? this.mode.goal_m : (this.asked ?? current).tip_m;
    if (this.asked === null) this.ask(current);
    this.mode = { kind: "glide", goal_m: goal.clone().add(offset_m), slow: true };
  }

  /** Where the tip is on its way to; null until it is held. */
  get goal_m(): Vector3 | null {
    return this.mode.kind === "glide" ? this.mode.goal_m : (this.asked?.tip_m ?? null);
  }

  /** The tip goes to `goal_m` as fast as a hand, its shaft through `pivot_m`; `current` is where the instrument is shown. */
  lead(goal_m: Vector3, pivot_m: Vector3, current: ToolPose): void {
    if (this.mode.kind === "push") return;
    if (this.asked === null) this.ask(current);
    this.mode = { kind: "glide", goal_m, slow: false, pivot_m };
  }

  /** Forgets everything: the instrument is where the server says. */
  forget(): void {
    this.mode = { kind: "idle" };
    this.asked = null;
    this.unsent = false;
  }

  private ask(pose: ToolPose): void {
    this.asked = { tip_m: pose.tip_m.clone(), shaft: pose.shaft.clone() };
    this.unsent = true;
  }

  /** One frame of `dt_s`. */
  advance(dt_s: number): ToolPose | null {
    if (this.unsent) {
      // The first pose of a motion goes out as it is: outside the organ.
      this.unsent = false;
      return this.asked;
    }
    if (this.settled || this.asked === null) return null;
    if (this.mode.kind === "push") {
      this.asked = this.mode.push.advance(dt_s);
    } else if (this.mode.kind === "glide") {
      const { slow, goal_m, pivot_m } = this.mode;
      const stride = slow
        ? Math.min(PRESS_STRIDE_M, PRESS_SPEED_M_PER_S * dt_s)
        : Math.min(FOLLOW_STRIDE_M, FOLLOW_SPEED_M_PER_S * dt_s);
      const tip_m = moveTowards(this.asked.tip_m, goal_m, stride);
      const shaft = pivot_m === undefined ? this.asked.shaft : pivot_m.clone().sub(tip_m).normalize();
      this.asked = { tip_m, shaft };
    }
    return this.asked;
  }
}
