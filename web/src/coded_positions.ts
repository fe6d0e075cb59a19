/**
 * Positions of docs/protocol.md: whole steps, as differences from a key that came before. They are off by half a step at most.
 */
import { Taker } from "./bytes";
import { fail } from "./fields";

/** What positions are differences from. */
export interface Key {
  readonly kind: "key";
  /** Of the topology. */
  readonly version: number;
  readonly number: number;
  readonly step_m: number;
  /** Whole steps, xyz of each vertex. */
  readonly places: Int32Array;
}

const KEY_HEADER_BYTES = 32;
/** Of coded positions: number of the key, bytes that follow. */
const CODED_HEADER_BYTES = 8;

export function decodeKey(buffer: ArrayBuffer, view: DataView): Key {
  if (buffer.byteLength < KEY_HEADER_BYTES) fail(`key of ${buffer.byteLength} bytes; its header has ${KEY_HEADER_BYTES}`);
  const nVertices = view.getUint32(20, true);
  const step_m = view.getFloat64(24, true);
  if (!(step_m > 0 && step_m < 1)) fail(`key: a step of ${step_m} m; allowed: above 0 and below 1`);
  const taker = new Taker(new Uint8Array(buffer, KEY_HEADER_BYTES));
  // Each number has a byte at least: nothing is allocated for more than is there.
  if (3 * nVertices > taker.left) fail(`key with ${nVertices} vertices needs ${3 * nVertices} bytes, found ${taker.left}`);
  const places = new Int32Array(3 * nVertices);
  for (let i = 0; i < places.length; i++) places[i] = (i < 3 ? 0 : places[i - 3]) + taker.signed();
  if (taker.left > 0) fail(`key goes on for ${taker.left} bytes after its last vertex`);
  return { kind: "key", version: view.getUint32(8, true), number: view.getUint32(16, true), step_m, places };
}

/** Bytes of coded positions at `at`, with what fills them up to whole words. */
export function codedBytes(view: DataView, at: number): number {
  if (view.byteLength < at + CODED_HEADER_BYTES) fail("snapshot ends before its positions");
  return CODED_HEADER_BYTES + 4 * Math.ceil(view.getUint32(at + 4, true) / 4);
}

/** Positions [m] at `at`, whose length was checked. */
export function decodeCoded(view: DataView, at: number, nVertices: number, key: Key | null): Float32Array<ArrayBuffer> {
  const number = view.getUint32(at, true);
  if (key === null || key.number !== number) fail(`snapshot: positions by key ${number}; the last one was ${key?.number ?? "none"}`);
  if (key.places.length !== 3 * nVertices) fail(`snapshot of ${nVertices} vertices by a key of ${key.places.length / 3}`);
  const taker = new Taker(new Uint8Array(view.buffer, view.byteOffset + at + CODED_HEADER_BYTES, view.getUint32(at + 4, true)));
  const positions_m = new Float32Array(3 * nVertices);
  const { places, step_m } = key;
  for (let i = 0; i < positions_m.length; ) {
    const kept = i + 3 * taker.number();
    const end = kept + 3 * taker.number();
    if (end > positions_m.length || end === i) fail("snapshot: a run of positions is empty or longer than what is left");
    for (; i < kept; i++) positions_m[i] = places[i] * step_m;
    for (let x = 0, y = 0, z = 0; i < end; i += 3) {
      x += taker.signed();
      y += taker.signed();
      z += taker.signed();
      positions_m[i] = (places[i] + x) * step_m;
      positions_m[i + 1] = (places[i + 1] + y) * step_m;
      positions_m[i + 2] = (places[i + 2] + z) * step_m;
    }
  }
  if (taker.left > 0) fail(`snapshot: positions go on for ${taker.left} bytes after the last vertex`);
  return positions_m;
}
