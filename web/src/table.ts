/** The operating table, which turns about the patient's long axis: gravity turns the other way in the patient. */

import { text } from "./language";
import type { ClientMessage, Hello, Vec3 } from "./protocol";

/** One key press [rad]. */
const STRIDE_RAD = (15 * Math.PI) / 180;

/** `v` turned about +z, the patient's long axis. */
export function turnedAboutLongAxis(v: Vec3, angle_rad: number): Vec3 {
  const [c, s] = [Math.cos(angle_rad), Math.sin(angle_rad)];
  return [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]];
}

export class Table {
  private strides = 0;

  /** Level again. */
  level(): void {
    this.strides = 0;
  }

  /** Gravity in the patient after one more stride to the left (+1) or right (-1); null without gravity. */
  tilt(level_m_per_s2: Vec3, direction: 1 | -1): Vec3 | null {
    if (level_m_per_s2.every((x) => x === 0)) return null;
    this.strides += direction;
    return turnedAboutLongAxis(level_m_per_s2, -this.strides * STRIDE_RAD);
  }

  /** One stride more: the server is told, or the page why not. Gravity keeps its size, which may have been turned. */
  press(
    direction: 1 | -1,
    hello: Hello | null,
    server: { send(message: ClientMessage): boolean },
    page: { error(message: string): void },
    size_m_per_s2: number | null = null,
  ): void {
    if (hello === null) return;
    const level = hello.scene.gravity_m_per_s2;
    const share = size_m_per_s2 === null ? 1 : size_m_per_s2 / Math.max(Math.hypot(...level), Number.MIN_VALUE);
    const m_per_s2 = this.tilt([level[0] * share, level[1] * share, level[2] * share], direction);
    if (m_per_s2 !== null) server.send({ type: "gravity", m_per_s2 });
    else page.error(text("no_gravity"));
  }
}
