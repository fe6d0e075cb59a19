/** The strands of attachments between bodies, the last part of a SNAPSHOT frame (docs/protocol.md). */
import { fail } from "./fields";

/** Both ends of a strand, three numbers each. */
export const NUMBERS_OF_STRAND = 6;

/** How many bytes the part at `at` says that it has; more than there are where it does not say so. */
export function strandsBytes(view: DataView, at: number): number {
  return at + 4 > view.byteLength ? 4 : 4 + 4 * NUMBERS_OF_STRAND * view.getUint32(at, true);
}

/** Decodes the part at byte `at` of a frame that is long enough: both ends of each strand [m]. */
export function decodeStrands(view: DataView, at: number): Float32Array {
  return Float32Array.from({ length: NUMBERS_OF_STRAND * view.getUint32(at, true) }, (_, i) => {
    const value = view.getFloat32(at + 4 + 4 * i, true);
    if (!Number.isFinite(value)) fail(`snapshot: a strand (byte ${at + 4 + 4 * i}) is not finite`);
    return value;
  });
}

/** The part of these strands, nothing for none; for tests and for the test server. */
export function encodeStrands(strands_m: Float32Array): Uint8Array {
  if (strands_m.length === 0) return new Uint8Array();
  const bytes = new Uint8Array(4 + 4 * strands_m.length);
  const view = new DataView(bytes.buffer);
  view.setUint32(0, strands_m.length / NUMBERS_OF_STRAND, true);
  strands_m.forEach((x, i) => view.setFloat32(4 + 4 * i, x, true));
  return bytes;
}
