import { describe, expect, it } from "vitest";
import type { Key } from "../src/coded_positions";
import { encodeSnapshot } from "../src/encode";
import { FLAG_CODED, FLAG_INSIDE, KIND_KEY, MAGIC, ProtocolError, SNAPSHOT_HEADER_BYTES, TOOL_BYTES, decodeBinary, type Snapshot } from "../src/protocol";

const STEP_M = 2 ** -17;

/** A KEY frame as docs/protocol.md has it. */
function keyFrame(nVertices: number, bytes: readonly number[], step_m = STEP_M): ArrayBuffer {
  const frame = new Uint8Array(32 + bytes.length);
  const view = new DataView(frame.buffer);
  [MAGIC, KIND_KEY, 3, 0, 7, nVertices].forEach((word, i) => view.setUint32(4 * i, word, true));
  view.setFloat64(24, step_m, true);
  frame.set(bytes, 32);
  return frame.buffer;
}

const BARE: Snapshot = {
  kind: "snapshot",
  header: {
    version: 3,
    organ: 0,
    step: 5,
    time_s: 0.5,
    rate_steps_per_s: 1000,
    realTimeFactor: 1,
    paused: false,
    oddResets: false,
    tools: [
      {
        tip_m: [0, 0, 1],
        shaft: [0, 0, 1],
        roll_rad: 0,
        jaw: 0,
        trigger: 0,
        forceOnTool_n: [0, 0, 0],
        contactPoint_m: [0, 0, 0],
        contact: false,
        grasps: false,
        heldNodes: 0,
        shownFurtherOut_m: [0, 0, 0],
      },
    ],
    bleeding: { lost_m3: 0.25, rate_m3_per_s: 0, clips: 0, ends: [] },
    contactPoints: null,
    threads: [],
    strands_m: new Float32Array(),
    clips: [],
    inside: null,
  },
  positions_m: new Float32Array(0),
};

/** A snapshot of `nVertices` whose positions are those bytes by a key. */
function codedFrame(nVertices: number, key: number, bytes: readonly number[]): ArrayBuffer {
  const bare = new Uint8Array(encodeSnapshot(BARE));
  const first = SNAPSHOT_HEADER_BYTES + TOOL_BYTES;
  const frame = new Uint8Array(bare.length + 8 + 4 * Math.ceil(bytes.length / 4));
  frame.set(bare.subarray(0, first));
  frame.set(bytes, first + 8);
  frame.set(bare.subarray(first), frame.length - (bare.length - first));
  const view = new DataView(frame.buffer);
  view.setUint32(48, FLAG_CODED, true);
  view.setUint32(56, nVertices, true);
  view.setUint32(first, key, true);
  view.setUint32(first + 4, bytes.length, true);
  return frame.buffer;
}

/** Four vertices at 0 0 0, 100 0 0, 100 -1 0 and 100 -1 64 steps. */
const KEY_BYTES = [0, 0, 0, 0xc8, 1, 0, 0, 0, 1, 0, 0, 0, 0x80, 1];
/** The first stays; the second goes by 1 2 3, the third by 2 2 2; the last stays. */
const POSITION_BYTES = [1, 2, 2, 4, 6, 2, 0, 1, 1, 0];

const key = decodeBinary(keyFrame(4, KEY_BYTES)) as Key;

describe("positions as differences from a key", () => {
  it("are where they should be, with what follows them", () => {
    expect([...key.places]).toEqual([0, 0, 0, 100, 0, 0, 100, -1, 0, 100, -1, 64]);
    const found = decodeBinary(codedFrame(4, 7, POSITION_BYTES), key) as Snapshot;
    const steps = [0, 0, 0, 101, 2, 3, 102, 1, 2, 100, -1, 64];
    expect([...found.positions_m]).toEqual(steps.map((x) => x * STEP_M));
    expect(found.header).toEqual(BARE.header);
  });

  it("have what is looked at inside after them", () => {
    const bytes = new Uint8Array(codedFrame(4, 7, POSITION_BYTES));
    const frame = new Uint8Array(bytes.length + 24 + 16);
    frame.set(bytes);
    const view = new DataView(frame.buffer);
    view.setUint32(48, FLAG_CODED | FLAG_INSIDE, true);
    view.setUint32(bytes.length, 2, true);
    view.setUint32(bytes.length + 4, 4, true);
    [1, 2, 4, 8].forEach((value, i) => view.setFloat32(bytes.length + 24 + 4 * i, value, true));
    const found = decodeBinary(frame.buffer, key) as Snapshot;
    expect([found.header.inside?.field, ...(found.header.inside?.values ?? [])]).toEqual(["stress", 1, 2, 4, 8]);
    expect(found.positions_m[3]).toBe(101 * STEP_M);
    expect(found.header.bleeding).toEqual(BARE.header.bleeding);
  });

  it("by another key, or by one of another surface, are refused", () => {
    expect(() => decodeBinary(codedFrame(4, 7, POSITION_BYTES))).toThrow(/by key 7; the last one was none/);
    expect(() => decodeBinary(codedFrame(4, 8, POSITION_BYTES), key)).toThrow(/by key 8; the last one was 7/);
    expect(() => decodeBinary(codedFrame(5, 7, POSITION_BYTES), key)).toThrow(/5 vertices by a key of 4/);
  });

  it.each([
    ["runs that end too early", [1, 2, 2, 4, 6], /too early/],
    ["a run beyond the last vertex", [1, 4, ...Array<number>(12).fill(0)], /longer than what is left/],
    ["an empty run", [0, 0], /empty/],
    ["more than the last vertex", [4, 0, 0], /go on for 1/],
  ])("with %s are refused", (_, bytes, message) => {
    expect(() => decodeBinary(codedFrame(4, 7, bytes), key)).toThrow(message);
  });

  it("keys of another length or step are refused", () => {
    expect(() => decodeBinary(keyFrame(4, KEY_BYTES.slice(0, 12)))).toThrow(/too early/);
    expect(() => decodeBinary(keyFrame(3, KEY_BYTES))).toThrow(/goes on for/);
    expect(() => decodeBinary(keyFrame(1e9, KEY_BYTES))).toThrow(/needs .* bytes/);
    expect(() => decodeBinary(keyFrame(4, KEY_BYTES, NaN))).toThrow(/step/);
  });

  it("any mutation gives a message or a ProtocolError, nothing else", () => {
    let state = 1;
    const next = (n: number): number => {
      state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
      return Math.floor((state / 2 ** 32) * n);
    };
    let refused = 0;
    for (let round = 0; round < 5_000; round++) {
      const bytes = new Uint8Array(round % 2 === 0 ? keyFrame(4, KEY_BYTES) : codedFrame(4, 7, POSITION_BYTES));
      bytes[next(bytes.length)] = next(256);
      try {
        const decoded = decodeBinary(bytes.buffer.slice(0, next(4) === 0 ? next(bytes.length) : bytes.length), key);
        if (decoded.kind === "snapshot") expect(decoded.positions_m.every((x) => Number.isFinite(x))).toBe(true);
      } catch (error) {
        if (!(error instanceof ProtocolError)) throw error;
        refused += 1;
      }
    }
    expect(refused).toBeGreaterThan(1_000);
  });
});
