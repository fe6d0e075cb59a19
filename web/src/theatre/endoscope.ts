/**
 * What an endoscope sees, as in `crates/glisson/src/tool/endoscope.rs`: pure functions. The direction of view makes the view
 * angle with the way out of the tip; roll leads it around the shaft, and the picture stays upright.
 */
import { Quaternion, Vector3 } from "three";
import type { ViewAxes } from "../drag";
import type { OpticsInfo, ToolState } from "../protocol";

const FRONT = new Vector3(0, -1, 0);

/** Where an endoscope looks from and to. */
export interface Eye extends ViewAxes {
  readonly position_m: Vector3;
  /** Full angle of the cone that is seen. */
  readonly field_of_view_rad: number;
}

/** The eye of an endoscope that is held so. */
export function eyeOf({ tip_m, shaft, roll_rad }: Pick<ToolState, "tip_m" | "shaft" | "roll_rad">, optics: OpticsInfo): Eye {
  const along = new Vector3(...shaft).normalize();
  const turn = new Quaternion().setFromUnitVectors(FRONT, along);
  // Without roll, of a shaft to the front: x to the left, y to the head.
  const x = new Vector3(1, 0, 0).applyQuaternion(turn);
  const y = new Vector3(0, 0, 1).applyQuaternion(turn);
  const [sine, cosine] = [Math.sin(optics.view_angle_rad), Math.cos(optics.view_angle_rad)];
  const [sineOfRoll, cosineOfRoll] = [Math.sin(roll_rad), Math.cos(roll_rad)];
  const across = x.clone().multiplyScalar(cosineOfRoll).addScaledVector(y, sineOfRoll);
  const hinge = y.clone().multiplyScalar(cosineOfRoll).addScaledVector(x, -sineOfRoll);
  const forward = along.clone().multiplyScalar(-cosine).addScaledVector(across, -sine);
  const up = hinge.multiplyScalar(cosineOfRoll).addScaledVector(across, cosine * sineOfRoll).addScaledVector(along, -sine * sineOfRoll);
  return { position_m: new Vector3(...tip_m), forward, up, right: forward.clone().cross(up), field_of_view_rad: optics.field_of_view_rad };
}

/** One notch of the wheel moves an endoscope along its shaft by this much [m]. */
export const ADVANCE_M = 0.005;

/** Where the tip goes when the picture is dragged: turned about the pivot by these angles, so that the picture follows. */
export function pivoted(tip_m: Vector3, pivot_m: Vector3, { right, up }: ViewAxes, rightwards_rad: number, downwards_rad: number): Vector3 {
  const arm = tip_m.clone().sub(pivot_m);
  return arm.applyAxisAngle(up, rightwards_rad).applyAxisAngle(right, downwards_rad).add(pivot_m);
}

/** Where the tip goes when it is pushed in by so many notches; it stays a notch inside the pivot. */
export function advanced(tip_m: Vector3, pivot_m: Vector3, notches: number): Vector3 {
  const arm = tip_m.clone().sub(pivot_m);
  const length = arm.length();
  if (length === 0) return tip_m.clone();
  return arm.multiplyScalar(Math.max(length + notches * ADVANCE_M, ADVANCE_M) / length).add(pivot_m);
}
