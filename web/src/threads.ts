/** The threads at the end of a SNAPSHOT frame (docs/protocol.md). */
import { fail, type Vec3 } from "./fields";

/** A surgical thread. */
export interface Thread {
  readonly radius_m: number;
  /** From its first end. */
  readonly nodes_m: readonly Vec3[];
  /** How many of them are the needle's. */
  readonly needleNodes: number;
  readonly clips_m: readonly Vec3[];
}

const HEAD_BYTES = 16;
const POINT_BYTES = 12;

/** How many bytes the part at `at` says that it has; more than there are where it does not say so. */
export function threadsBytes(view: DataView, at: number): number {
  if (at + 4 > view.byteLength) return 4;
  let end = at + 4;
  for (let i = 0; i < view.getUint32(at, true); i++) {
    if (end + HEAD_BYTES > view.byteLength) return end + HEAD_BYTES - at;
    end += HEAD_BYTES + POINT_BYTES * (view.getUint32(end, true) + view.getUint32(end + 8, true));
  }
  return end - at;
}

/** Decodes the part at byte `at` of a frame that is long enough. */
export function decodeThreads(view: DataView, at: number): Thread[] {
  const number = (offset: number): number => {
    const value = view.getFloat32(offset, true);
    if (!Number.isFinite(value)) fail(`snapshot: a thread (byte ${offset}) is not finite`);
    return value;
  };
  let next = at + 4;
  const points = (n: number): Vec3[] =>
    Array.from({ length: n }, () => {
      const point: Vec3 = [number(next), number(next + 4), number(next + 8)];
      next += POINT_BYTES;
      return point;
    });
  return Array.from({ length: view.getUint32(at, true) }, () => {
    const [n, needleNodes, nClips] = [0, 4, 8].map((offset) => view.getUint32(next + offset, true));
    if (needleNodes > n) fail(`snapshot: a needle of ${needleNodes} of the ${n} places of its thread`);
    const radius_m = number(next + 12);
    next += HEAD_BYTES;
    return { radius_m, needleNodes, nodes_m: points(n), clips_m: points(nClips) };
  });
}

/** The part of these threads, nothing for none; for tests and for the test server. */
export function encodeThreads(threads: readonly Thread[]): Uint8Array {
  if (threads.length === 0) return new Uint8Array();
  const sizes = threads.map((thread) => HEAD_BYTES + POINT_BYTES * (thread.nodes_m.length + thread.clips_m.length));
  const bytes = new Uint8Array(4 + sizes.reduce((sum, size) => sum + size, 0));
  const view = new DataView(bytes.buffer);
  view.setUint32(0, threads.length, true);
  let at = 4;
  for (const thread of threads) {
    [thread.nodes_m.length, thread.needleNodes, thread.clips_m.length].forEach((n, i) => view.setUint32(at + 4 * i, n, true));
    view.setFloat32(at + 12, thread.radius_m, true);
    [...thread.nodes_m, ...thread.clips_m].flat().forEach((x, i) => view.setFloat32(at + HEAD_BYTES + 4 * i, x, true));
    at += HEAD_BYTES + POINT_BYTES * (thread.nodes_m.length + thread.clips_m.length);
  }
  return bytes;
}
