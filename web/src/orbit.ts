/**
 * The camera's pose as turntable angles about the patient's long axis: pure functions.
 *
 * Patient frame LPS: +x left, +y posterior, +z superior. Azimuth 0, elevation 0 looks from the front (anterior), so
 * that the patient's left is on the right of the screen, as in clinical pictures.
 */
import { Vector3 } from "three";
import type { ViewAxes } from "./drag";

export const FIELD_OF_VIEW_DEG = 32;
/** Short of the poles, where "up" would lose its meaning. */
const MAX_ELEVATION_RAD = 1.53;
const START_AZIMUTH_RAD = -0.38;
const START_ELEVATION_RAD = 0.3;
/** Shown size over the organ's box, so that the instrument has room. */
const MARGIN = 1.16;

export interface Orbit {
  readonly target_m: Vector3;
  readonly distance_m: number;
  readonly azimuth_rad: number;
  readonly elevation_rad: number;
}

/** Unit vectors of the screen in the patient frame. */
export function viewAxes(orbit: Orbit): ViewAxes {
  const { azimuth_rad: a, elevation_rad: e } = orbit;
  const forward = new Vector3(-Math.sin(a) * Math.cos(e), Math.cos(a) * Math.cos(e), -Math.sin(e));
  const right = new Vector3(Math.cos(a), Math.sin(a), 0);
  return { forward, right, up: right.clone().cross(forward) };
}

export function cameraPosition(orbit: Orbit): Vector3 {
  return orbit.target_m.clone().addScaledVector(viewAxes(orbit).forward, -orbit.distance_m);
}

/** The view that shows the whole box, from the front, a little from above and from the patient's right. */
export function orbitThatShows(min_m: Vector3, max_m: Vector3, aspect: number): Orbit {
  const orbit = {
    target_m: min_m.clone().add(max_m).multiplyScalar(0.5),
    distance_m: 1,
    azimuth_rad: START_AZIMUTH_RAD,
    elevation_rad: START_ELEVATION_RAD,
  };
  const { right, up, forward } = viewAxes(orbit);
  const half = max_m.clone().sub(min_m).multiplyScalar(0.5);
  const extent = (axis: Vector3): number =>
    Math.abs(axis.x) * half.x + Math.abs(axis.y) * half.y + Math.abs(axis.z) * half.z;
  const tangent = Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360);
  const needed = Math.max(extent(up) / tangent, extent(right) / (tangent * Math.max(aspect, 0.1)));
  return { ...orbit, distance_m: Math.max(MARGIN * needed + 0.5 * extent(forward), 0.01) };
}

export function turned(orbit: Orbit, dxPixels: number, dyPixels: number, heightPixels: number): Orbit {
  const perPixel = Math.PI / Math.max(heightPixels, 1);
  const elevation = orbit.elevation_rad + dyPixels * perPixel;
  return {
    ...orbit,
    azimuth_rad: orbit.azimuth_rad - dxPixels * perPixel,
    elevation_rad: Math.min(MAX_ELEVATION_RAD, Math.max(-MAX_ELEVATION_RAD, elevation)),
  };
}

/** Moves the target so that the point at its depth stays under the pointer. */
export function panned(orbit: Orbit, dxPixels: number, dyPixels: number, heightPixels: number): Orbit {
  const { right, up } = viewAxes(orbit);
  const perPixel = metresPerPixel(orbit, heightPixels);
  const target_m = orbit.target_m
    .clone()
    .addScaledVector(right, -dxPixels * perPixel)
    .addScaledVector(up, dyPixels * perPixel);
  return { ...orbit, target_m };
}

/** `notches` > 0 comes nearer. The distance stays between 2 cm and 5 m. */
export function zoomed(orbit: Orbit, notches: number): Orbit {
  return { ...orbit, distance_m: Math.min(5, Math.max(0.02, orbit.distance_m * Math.pow(0.9, notches))) };
}

/** Size of a pixel at the target's depth [m]. */
export function metresPerPixel(orbit: Orbit, heightPixels: number): number {
  return (2 * orbit.distance_m * Math.tan((FIELD_OF_VIEW_DEG * Math.PI) / 360)) / Math.max(heightPixels, 1);
}
