/** Two pictures for two eyes through one endoscope: where its two lenses are, and how their pictures meet. */
import type { PerspectiveCamera } from "three";
import { Vector3 } from "three";

export type Stereo = "off" | "side_by_side" | "anaglyph";
export const STEREO: readonly Stereo[] = ["off", "side_by_side", "anaglyph"];

/** The choice after another one. */
export function nextStereo(choice: Stereo): Stereo {
  return STEREO[(STEREO.indexOf(choice) + 1) % STEREO.length];
}

/** Between the two lenses of a stereo endoscope [m]: as usual ones of 10 mm have it, a choice. */
export const BETWEEN_LENSES_M = 0.0045;

/** Moves a camera that looks through the middle to the left (-1) or right (+1) lens; what is at that distance does not move in the picture. */
export function throughLens(camera: PerspectiveCamera, side: -1 | 1, distance_m: number): void {
  const half_m = 0.5 * BETWEEN_LENSES_M;
  camera.position.add(new Vector3(side * half_m, 0, 0).applyQuaternion(camera.quaternion));
  camera.updateProjectionMatrix();
  // Parallel axes, and a frustum that leans: no keystones.
  camera.projectionMatrix.elements[8] -= (side * half_m) / (distance_m * Math.tan((camera.fov * Math.PI) / 360));
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  camera.updateMatrixWorld();
}
