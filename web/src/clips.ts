/** The clips on vessels of a SNAPSHOT frame (docs/protocol.md). */
import { fail, type Vec3 } from "./fields";

/** A clip on a vessel. */
export interface Clip {
  /** Its middle, on the vessel's axis. */
  readonly position_m: Vec3;
  /** Unit vector along the vessel. */
  readonly along: Vec3;
  /** Unit vector across the vessel, along the clip's legs to their bend. */
  readonly legs: Vec3;
  /** Of the vessel at rest. */
  readonly radius_m: number;
}

const CLIP_BYTES = 40;

/** How many bytes the part at `at` says that it has; more than there are where it does not say so. */
export function clipsBytes(view: DataView, at: number): number {
  return at + 4 > view.byteLength ? 4 : 4 + CLIP_BYTES * view.getUint32(at, true);
}

/** Decodes the part at byte `at` of a frame that is long enough. */
export function decodeClips(view: DataView, at: number): Clip[] {
  return Array.from({ length: view.getUint32(at, true) }, (_, i) => {
    const number = (place: number): number => {
      const value = view.getFloat32(at + 4 + CLIP_BYTES * i + 4 * place, true);
      if (!Number.isFinite(value)) fail(`snapshot: clip ${i} is not finite`);
      return value;
    };
    const vector = (place: number): Vec3 => [number(place), number(place + 1), number(place + 2)];
    return { position_m: vector(0), along: vector(3), legs: vector(6), radius_m: number(9) };
  });
}

/** The part of these clips, nothing for none; for tests and for the test server. */
export function encodeClips(clips: readonly Clip[]): Uint8Array {
  if (clips.length === 0) return new Uint8Array();
  const view = new DataView(new ArrayBuffer(4 + CLIP_BYTES * clips.length));
  view.setUint32(0, clips.length, true);
  const numbers = clips.flatMap(({ position_m, along, legs, radius_m }) => [...position_m, ...along, ...legs, radius_m]);
  numbers.forEach((x, i) => view.setFloat32(4 + 4 * i, x, true));
  return new Uint8Array(view.buffer);
}
