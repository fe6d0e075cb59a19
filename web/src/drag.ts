/**
 * Mathematics of pushing the organ with the pointer: pure functions and one small state, no DOM.
 *
 * A push begins at the picked point `hit` with outward normal `n`. While the pointer's ray is `o + s d`, the contact
 * point should be at
 *
 *     contact = (ray meets the plane through `hit` parallel to the screen) + depth d
 *
 * so that it stays exactly under the pointer. The tip's centre (a sphere of radius r) is `contact + n r`: the first
 * target lies outside the surface, so that contact is made at the picked point and not at a side of the sphere.
 * The tip walks towards its target with a bounded speed and a bounded stride, whatever the display's rate.
 */
import { Vector3 } from "three";

/** The organ is pressed this deep when the button goes down [m]. */
export const PRESS_DEPTH_M = 0.005;
/** One notch of the wheel while pushing [m]. */
export const WHEEL_DEPTH_M = 0.001;
export const MIN_DEPTH_M = -0.01;
export const MAX_DEPTH_M = 0.04;
/** The contact point is kept within this distance of where the push began [m]. */
export const MAX_REACH_M = 0.08;
/** The tip starts this far outside the surface [m]. */
export const APPROACH_GAP_M = 0.002;
/** While it approaches and presses, the tip moves slowly so that contact is made at the picked point. */
export const PRESS_SPEED_M_PER_S = 0.05;
export const PRESS_STRIDE_M = 0.001;
/** Afterwards it follows the hand. */
export const FOLLOW_SPEED_M_PER_S = 0.6;
export const FOLLOW_STRIDE_M = 0.01;
/** On release the tip leaves the organ along its shaft by this much [m]. */
export const RETRACT_M = 0.04;

export interface Ray {
  readonly origin: Vector3;
  /** Unit vector. */
  readonly direction: Vector3;
}

/** Where a ray meets the plane through `point` with unit normal `normal`; null if it runs along or away from it. */
export function rayMeetsPlane(ray: Ray, point: Vector3, normal: Vector3): Vector3 | null {
  const slope = ray.direction.dot(normal);
  if (Math.abs(slope) < 1e-9) return null;
  const distance = point.clone().sub(ray.origin).dot(normal) / slope;
  if (!(distance > 0)) return null;
  return ray.direction.clone().multiplyScalar(distance).add(ray.origin);
}

/** `depth_m` after `notches` of the wheel (forward, away from the hand, is deeper), within the allowed range. */
export function depthAfterWheel(depth_m: number, notches: number): number {
  return Math.min(MAX_DEPTH_M, Math.max(MIN_DEPTH_M, depth_m + notches * WHEEL_DEPTH_M));
}

/** `from` moved towards `to` by at most `stride_m`; exactly `to` when it is within reach. */
export function moveTowards(from: Vector3, to: Vector3, stride_m: number): Vector3 {
  const step = to.clone().sub(from);
  const distance = step.length();
  if (distance <= stride_m) return to.clone();
  return step.multiplyScalar(stride_m / distance).add(from);
}

export interface ViewAxes {
  /** Unit vectors of the screen in the patient frame: right, up, and into the screen. */
  readonly right: Vector3;
  readonly up: Vector3;
  readonly forward: Vector3;
}

/**
 * Direction of the shaft (tip towards handle) for a push at a surface with outward normal `normal`:
 * towards the camera's side, tilted up and to the right so that it is seen, and always out of the surface.
 */
export function shaftDirection(normal: Vector3, view: ViewAxes): Vector3 {
  const shaft = view.forward
    .clone()
    .multiplyScalar(-0.55)
    .addScaledVector(view.up, 0.6)
    .addScaledVector(view.right, 0.45)
    .addScaledVector(normal, 0.5)
    .normalize();
  const outward = shaft.dot(normal);
  if (outward < 0.35) shaft.addScaledVector(normal, 0.35 - outward).normalize();
  return shaft;
}

export interface PushStart {
  readonly hit_m: Vector3;
  readonly normal: Vector3;
  readonly tipRadius_m: number;
  readonly view: ViewAxes;
}

export interface ToolPose {
  readonly tip_m: Vector3;
  readonly shaft: Vector3;
}

/** One push, from button down to button up. */
export class Push {
  depth_m = PRESS_DEPTH_M;
  private tip_m: Vector3;
  private contact_m: Vector3;
  private rayDirection: Vector3;
  private readonly shaft: Vector3;
  private pressed = false;

  constructor(
    private readonly start: PushStart,
    ray: Ray,
  ) {
    this.tip_m = start.hit_m.clone().addScaledVector(start.normal, start.tipRadius_m + APPROACH_GAP_M);
    this.contact_m = start.hit_m.clone();
    this.rayDirection = ray.direction.clone();
    this.shaft = shaftDirection(start.normal, start.view);
  }

  /** The pointer moved to `ray`. A ray that misses the plane leaves the target as it was. */
  follow(ray: Ray): void {
    const met = rayMeetsPlane(ray, this.start.hit_m, this.start.view.forward);
    if (met === null) return;
    this.contact_m = met;
    this.rayDirection = ray.direction.clone();
  }

  /** Where the contact point should be [m]. */
  contactTarget(): Vector3 {
    const target = this.contact_m.clone().addScaledVector(this.rayDirection, this.depth_m);
    return moveTowards(this.start.hit_m, target, MAX_REACH_M);
  }

  /** Where the tip's centre should be [m]. */
  tipTarget(): Vector3 {
    return this.contactTarget().addScaledVector(this.start.normal, this.start.tipRadius_m);
  }

  settled(): boolean {
    return this.tip_m.equals(this.tipTarget());
  }

  pose(): ToolPose {
    return { tip_m: this.tip_m.clone(), shaft: this.shaft.clone() };
  }

  /** The tip walks on for `dt_s`: straight in to the picked point first, then to the target. */
  advance(dt_s: number): ToolPose {
    const target = this.tipTarget();
    const speed = this.pressed ? FOLLOW_SPEED_M_PER_S : PRESS_SPEED_M_PER_S;
    const longest = this.pressed ? FOLLOW_STRIDE_M : PRESS_STRIDE_M;
    const stride = Math.min(longest, speed * Math.max(dt_s, 0));
    if (!this.pressed) {
      // The normal's line through the picked point, until the sphere has passed the place where it touches.
      const touch = this.start.hit_m.clone().addScaledVector(this.start.normal, this.start.tipRadius_m - PRESS_STRIDE_M);
      this.tip_m = moveTowards(this.tip_m, touch, stride);
      if (this.tip_m.equals(touch)) this.pressed = true;
      return this.pose();
    }
    this.tip_m = moveTowards(this.tip_m, target, stride);
    return this.pose();
  }
}

/** Where a released tool goes: out along its shaft. */
export function retractedTip(pose: ToolPose): Vector3 {
  return pose.tip_m.clone().addScaledVector(pose.shaft, RETRACT_M);
}
