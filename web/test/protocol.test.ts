import { describe, expect, it } from "vitest";
import { leftOut } from "../src/contact_points";
import { encodeSnapshot, encodeTopology } from "../src/encode";
import { insideOf } from "../src/organ";
import {
  decodeBinary,
  decodeText,
  encodeClientMessage,
  ProtocolError,
  type Hello,
  type Snapshot,
  type Topology,
} from "../src/protocol";

const TOPOLOGY: Topology = {
  kind: "topology",
  version: 3,
  organ: 1,
  nodeIds: Uint32Array.of(10, 20, 30, 41),
  rest_m: Float32Array.of(0, 0, 0, 0.5, 0, 0, 0, 0.25, 0, 0, 0, 0.125),
  triangles: Uint32Array.of(0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2),
  isCut: Uint8Array.of(0, 1, 1, 1),
  bodyOf: Uint8Array.of(0, 0, 2, 1),
};

const SNAPSHOT: Snapshot = {
  kind: "snapshot",
  header: {
    version: 3,
    organ: 1,
    step: 2 ** 40 + 7,
    time_s: 12.5,
    rate_steps_per_s: 497.25,
    realTimeFactor: 0.9945,
    paused: true,
    oddResets: true,
    bleeding: {
      lost_m3: 0.25,
      rate_m3_per_s: 0.5,
      clips: 3,
      ends: [{ position_m: [1, 2, 3], rate_m3_per_s: 0.5 }],
    },
    contactPoints: null,
    threads: [],
    strands_m: new Float32Array(),
    clips: [],
    inside: null,
    tools: [
      {
        tip_m: [0.01, -0.02, 0.03],
        shaft: [0, -0.6, 0.8],
        roll_rad: 0.5,
        jaw: 0.25,
        trigger: 1,
        forceOnTool_n: [0.5, -1.25, 2],
        contactPoint_m: [0.011, -0.021, 0.031],
        contact: true,
        grasps: true,
        heldNodes: 6,
        shownFurtherOut_m: [0.5, 0.25, 0.125],
      },
    ],
  },
  positions_m: Float32Array.of(0, 0, 0, 0.5, 0, 0, 0, 0.25, 0.5, 0, 0, 0.125),
};

const WITH_CONTACTS: Snapshot = {
  ...SNAPSHOT,
  header: {
    ...SNAPSHOT.header,
    contactPoints: {
      sums: [{ n: 1, force_n: 0.5 }, { n: 0, force_n: 0 }, { n: 0, force_n: 0 }, { n: 7, force_n: 4 }, { n: 1, force_n: 2 }],
      points: [
        { kind: "tool_organ", touched: 0, by: 3, place_m: [0.5, 0.25, 0], normal: [0, 0, 1], force_n: [0.25, 0, 0.5] },
        { kind: "itself", touched: 2, by: 2, place_m: [1, 2, 3], normal: [0, 0, 0], force_n: [0, -1.5, 0] },
        { kind: "tool_tool", touched: 1, by: 0, place_m: [1, 2, 4], normal: [0, 1, 0], force_n: [0, 2, 0] },
      ],
    },
  },
};

const WITH_THREADS: Snapshot = {
  ...WITH_CONTACTS,
  header: {
    ...WITH_CONTACTS.header,
    threads: [
      { radius_m: 0.125, needleNodes: 2, nodes_m: [[1, 2, 3], [0.5, 0, 0], [4, 5, 6]], clips_m: [[0, 0.25, 0]] },
      { radius_m: 0.5, needleNodes: 0, nodes_m: [[1, 2, 3], [0.5, 0, 0]], clips_m: [] },
    ],
  },
};

const WITH_CLIPS: Snapshot = {
  ...WITH_THREADS,
  header: {
    ...WITH_THREADS.header,
    clips: [
      { position_m: [0.5, 0.25, 0], along: [1, 0, 0], legs: [0, 0, 1], radius_m: 0.125 },
      { position_m: [0.25, 2, 0], along: [0, 1, 0], legs: [-1, 0, 0], radius_m: 0.5 },
    ],
  },
};

const WITH_STRANDS: Snapshot = {
  ...WITH_CLIPS,
  header: { ...WITH_CLIPS.header, strands_m: Float32Array.of(1, 2, 3, 0.5, 0.25, 0, -1, 0, 0, 4, 5, 6) },
};

const HELLO: Hello = {
  type: "hello",
  protocol: 12,
  scene: {
    name: "liver",
    model: "pre-computed",
    material: "linear",
    time_step_s: 0.002,
    gravity_m_per_s2: [0, 0, -9.81],
    n_nodes: 1452,
    n_tetrahedra: 6300,
    n_vessels: 12,
  },
  bounds: { min_m: [-0.1, -0.1, -0.1], max_m: [0.1, 0.1, 0.1] },
  tools: [
    {
      name: "grasper",
      kind: "grasper",
      tip_radius_m: 0.005,
      shaft_radius_m: 0.0025,
      shaft_length_m: 0.3,
      jaws: { length_m: 0.02, width_m: 0.005, greatest_opening_rad: 1 },
      optics: null,
      trocar_m: null,
      home_tip_m: [0, -0.2, 0],
      home_shaft: [0, -1, 0],
      home_jaw: 1,
    },
  ],
  bodies: [
    { name: "liver", color: "#8c3a30", is_rigid: false, n_tetrahedra: 6200 },
    { name: "spine", color: null, is_rigid: true, n_tetrahedra: 100 },
  ],
  models: ["precomputed", "tensor_mass"],
  fixed_nodes: [1, 2, 3],
  can_leave: true,
      devices: [{ tool: 0, name: "simulated" }],
};

/** Small seeded generator (xorshift32, Marsaglia 2003, doi 10.18637/jss.v008.i14). */
function random(seed: number): () => number {
  let x = seed;
  return () => {
    x ^= x << 13;
    x ^= x >>> 17;
    x ^= x << 5;
    return (x >>> 0) / 4294967296;
  };
}

describe("binary frames", () => {
  it("topology: what was encoded comes back", () => {
    expect(decodeBinary(encodeTopology(TOPOLOGY))).toEqual(TOPOLOGY);
  });

  it("topology: many flags come back, and a vertex at the rim of a cut belongs to the surface", () => {
    const triangles = Uint32Array.from({ length: 3 * 77 }, (_, i) => i % 4);
    const many = { ...TOPOLOGY, triangles, isCut: Uint8Array.from({ length: 77 }, (_, i) => (i % 5 === 0 ? 1 : 0)) };
    expect(decodeBinary(encodeTopology(many))).toEqual(many);
    expect(Array.from(insideOf(TOPOLOGY))).toEqual([0, 0, 0, 1]);
  });

  it("snapshot: what was encoded comes back", () => {
    expect(decodeBinary(encodeSnapshot(SNAPSHOT))).toEqual(SNAPSHOT);
  });

  it("snapshot: fields stand at the documented offsets", () => {
    const view = new DataView(encodeSnapshot(SNAPSHOT));
    expect(String.fromCharCode(...new Uint8Array(view.buffer, 0, 4))).toBe("GLSN");
    expect(view.getUint32(4, true)).toBe(2);
    expect(view.getBigUint64(16, true)).toBe(BigInt(2 ** 40 + 7));
    expect(view.getFloat64(24, true)).toBe(12.5);
    expect([48, 52, 56, 60].map((at) => view.getUint32(at, true))).toEqual([2 + 512, 1, 4, 2]);
    expect(view.getFloat64(64, true)).toBe(0.01);
    expect(view.getFloat64(88 + 8, true)).toBe(-0.6);
    expect([112, 120, 128].map((at) => view.getFloat64(at, true))).toEqual([0.5, 0.25, 1]);
    expect(view.getFloat64(136 + 16, true)).toBe(2);
    expect(view.getFloat64(160, true)).toBe(0.011);
    expect([184, 188].map((at) => view.getUint32(at, true))).toEqual([1 + 4, 6]);
    expect([192, 200, 208].map((at) => view.getFloat64(at, true))).toEqual([0.5, 0.25, 0.125]);
    expect(view.getFloat32(216 + 4 * 3, true)).toBe(0.5);
    expect(view.getFloat32(264 + 8, true)).toBe(3);
    expect(view.getFloat32(280 + 12, true)).toBe(0.5);
    expect(view.byteLength).toBe(216 + 48 + 32);
  });

  it("snapshot: contact points that were asked for come back, at the end of the same bytes", () => {
    const [without, whole] = [encodeSnapshot(SNAPSHOT), encodeSnapshot(WITH_CONTACTS)];
    expect(decodeBinary(whole)).toEqual(WITH_CONTACTS);
    const view = new DataView(whole);
    const end = without.byteLength;
    expect(whole.byteLength).toBe(end + 5 * 8 + 4 + 3 * 40);
    expect(view.getUint32(48, true)).toBe(2 + 8 + 512);
    view.setUint32(48, 2 + 512, true);
    expect(new Uint8Array(whole, 0, end)).toEqual(new Uint8Array(without));
    expect([view.getUint32(end + 24, true), view.getFloat32(end + 28, true), view.getUint32(end + 40, true)]).toEqual([7, 4, 3]);
    expect([44, 45, 46, 84, 85, 86, 124, 125, 126].map((at) => view.getUint8(end + at))).toEqual([0, 0, 3, 3, 2, 2, 4, 1, 0]);
    expect(view.getFloat32(end + 84 + 32, true)).toBe(-1.5);
    if (WITH_CONTACTS.header.contactPoints !== null) expect(leftOut(WITH_CONTACTS.header.contactPoints)).toBe(6);
  });

  it.each([
    ["a huge number of points", (v: DataView) => v.setUint32(296 + 40, 0xffffffff, true), /needs .* bytes, found/],
    ["a kind that there is not", (v: DataView) => v.setUint8(296 + 44, 5), /contact of kind 5; allowed: 0 to 4/],
    ["a force that is no number", (v: DataView) => v.setFloat32(296 + 44 + 28, NaN, true), /force of a contact .* is not finite/],
    ["a sum that is no number", (v: DataView) => v.setFloat32(296 + 4, Infinity, true), /sum of contact forces .* is not finite/],
    ["no points although there are", (v: DataView) => v.setUint32(48, 2, true), /needs .* bytes, found/],
  ])("contact points with %s are refused", (_name, spoil, message) => {
    const buffer = encodeSnapshot(WITH_CONTACTS);
    spoil(new DataView(buffer));
    expect(() => decodeBinary(buffer)).toThrow(message);
  });

  it("points that are said to follow and do not are refused", () => {
    const buffer = encodeSnapshot(SNAPSHOT);
    new DataView(buffer).setUint32(48, 2 + 8, true);
    expect(() => decodeBinary(buffer)).toThrow(/needs .* bytes, found/);
  });

  it.each([
    ["a huge vertex count", (v: DataView) => v.setUint32(16, 0xffffffff, true), /needs .* bytes, found/],
    ["a huge triangle count", (v: DataView) => v.setUint32(20, 0xffffffff, true), /needs .* bytes, found/],
    ["an index out of range", (v: DataView) => v.setUint32(24 + 64, 4, true), /triangle 0 uses vertex 4 of 4/],
    ["a position that is no number", (v: DataView) => v.setFloat32(24 + 16 + 12, NaN, true), /vertex 1 is not finite/],
    ["another magic", (v: DataView) => v.setUint32(0, 1, true), /GLSN/],
    ["another kind", (v: DataView) => v.setUint32(4, 4, true), /unknown kind 4/],
  ])("topology with %s is refused", (_name, spoil, message) => {
    const buffer = encodeTopology(TOPOLOGY);
    spoil(new DataView(buffer));
    expect(() => decodeBinary(buffer)).toThrow(message);
  });

  it.each([
    ["a huge vertex count", (v: DataView) => v.setUint32(56, 0xffffffff, true), /needs .* bytes, found/],
    ["a huge count of open vessels", (v: DataView) => v.setUint32(60, 0xffffffff, true), /records of blood needs/],
    ["blood that is no number", (v: DataView) => v.setFloat32(280, NaN, true), /record 1 of blood is not finite/],
    ["six instruments", (v: DataView) => v.setUint32(52, 6, true), /6 instruments; allowed: 1 to 5/],
    ["an infinite force", (v: DataView) => v.setFloat64(144, Infinity, true), /force on the tool \(byte 144\)/],
    ["a step beyond 2^53", (v: DataView) => v.setBigUint64(16, 2n ** 60n, true), /above 2\^53/],
    ["a position that is no number", (v: DataView) => v.setFloat32(216 + 44, NaN, true), /vertex 3 is not finite/],
  ])("snapshot with %s is refused", (_name, spoil, message) => {
    const buffer = encodeSnapshot(SNAPSHOT);
    spoil(new DataView(buffer));
    expect(() => decodeBinary(buffer)).toThrow(message);
  });

  it("snapshot: threads come back, after the contact points", () => {
    const buffer = encodeSnapshot(WITH_THREADS);
    expect(buffer.byteLength).toBe(encodeSnapshot(WITH_CONTACTS).byteLength + 4 + 2 * 16 + 12 * 6);
    expect(decodeBinary(buffer)).toEqual(WITH_THREADS);
    const view = new DataView(buffer);
    view.setUint32(buffer.byteLength - 12 * 2 - 12, 9, true);
    expect(() => decodeBinary(buffer)).toThrow(/needle of 9|bytes/);
  });

  it("snapshot: clips come back, after the threads", () => {
    const buffer = encodeSnapshot(WITH_CLIPS);
    expect(buffer.byteLength).toBe(encodeSnapshot(WITH_THREADS).byteLength + 4 + 2 * 40);
    expect(new DataView(buffer).getUint32(48, true) & 256).toBe(256);
    expect(decodeBinary(buffer)).toEqual(WITH_CLIPS);
    new DataView(buffer).setFloat32(buffer.byteLength - 4, NaN, true);
    expect(() => decodeBinary(buffer)).toThrow("clip 1 is not finite");
  });

  it("snapshot: strands come back, after the clips", () => {
    const buffer = encodeSnapshot(WITH_STRANDS);
    expect(buffer.byteLength).toBe(encodeSnapshot(WITH_CLIPS).byteLength + 4 + 2 * 24);
    expect(decodeBinary(buffer)).toEqual(WITH_STRANDS);
    new DataView(buffer).setFloat32(buffer.byteLength - 4, Number.NaN, true);
    expect(() => decodeBinary(buffer)).toThrow(/strand .* not finite/);
  });

  it("any mutation and any truncation gives a message or a ProtocolError, nothing else", () => {
    const next = random(2463534242);
    let refused = 0;
    for (let round = 0; round < 20_000; round++) {
      const snapshot = round % 4 === 1 ? SNAPSHOT : WITH_STRANDS;
      const whole = new Uint8Array(round % 2 === 0 ? encodeTopology(TOPOLOGY) : encodeSnapshot(snapshot));
      const bytes = next() < 0.5 ? whole : whole.slice(0, Math.floor(next() * (whole.length + 1)));
      for (let k = Math.floor(next() * 6); k >= 0 && bytes.length > 0; k--) {
        bytes[Math.floor(next() * bytes.length)] = Math.floor(next() * 256);
      }
      try {
        const decoded = decodeBinary(bytes.buffer);
        if (decoded.kind === "key") throw new Error("nothing of this was one");
        if (decoded.kind === "topology") {
          expect(decoded.triangles.every((v) => v < decoded.nodeIds.length)).toBe(true);
        } else {
          const points = decoded.header.contactPoints?.points ?? [];
          const numbers = points.flatMap((p) => [...p.place_m, ...p.normal, ...p.force_n]);
          const places = decoded.header.threads.flatMap((thread) => [...thread.nodes_m, ...thread.clips_m].flat());
          const clips = decoded.header.clips.flatMap(({ position_m, along, legs, radius_m }) => [...position_m, ...along, ...legs, radius_m]);
          expect([...decoded.positions_m, ...decoded.header.strands_m, ...numbers, ...places, ...clips].every((x) => Number.isFinite(x))).toBe(true);
        }
      } catch (error) {
        if (!(error instanceof ProtocolError)) throw error;
        refused += 1;
      }
    }
    expect(refused).toBeGreaterThan(5_000);
  });
});

describe("text messages", () => {
  it("hello and error come through", () => {
    expect(decodeText(JSON.stringify(HELLO))).toEqual(HELLO);
    expect(decodeText('{"type":"error","message":"no"}')).toEqual({ type: "error", message: "no" });
    expect(decodeText('{"type":"news","message":"yes"}')).toEqual({ type: "news", message: "yes" });
  });

  it("fields that the viewer does not know are ignored", () => {
    expect(decodeText(JSON.stringify({ ...HELLO, later: 1 }))).toEqual(HELLO);
  });

  it("another protocol version is refused, with both numbers", () => {
    expect(() => decodeText(JSON.stringify({ ...HELLO, protocol: 2 }))).toThrow(/protocol 2, this viewer 12/);
  });

  it.each(["", "null", "[]", "7", '"hello"', "{", '{"type":"hello"}', '{"type":7}', '{"type":"goodbye"}'])(
    "%j is refused",
    (text) => {
      expect(() => decodeText(text)).toThrow(ProtocolError);
    },
  );

  it("a hello with any one field spoiled is refused or read, nothing else", () => {
    const spoilers: unknown[] = [null, undefined, "x", -1, [], {}, [1, 2], [1, 2, "3"], 1e400, true];
    const places = (value: unknown, path: string[] = []): string[][] =>
      typeof value === "object" && value !== null
        ? Object.entries(value).flatMap(([key, inner]) => [[...path, key], ...places(inner, [...path, key])])
        : [];
    let refused = 0;
    for (const path of places(HELLO)) {
      for (const spoiler of spoilers) {
        const copy = structuredClone(HELLO) as unknown as Record<string, unknown>;
        let at = copy;
        for (const key of path.slice(0, -1)) at = at[key] as Record<string, unknown>;
        at[path.at(-1)!] = spoiler;
        try {
          decodeText(JSON.stringify(copy));
        } catch (error) {
          if (!(error instanceof ProtocolError)) throw error;
          refused += 1;
        }
      }
    }
    expect(refused).toBeGreaterThan(250);
  });

  it("random cuts of a hello give a ProtocolError", () => {
    const text = JSON.stringify(HELLO);
    for (let cut = 0; cut < text.length; cut++) expect(() => decodeText(text.slice(0, cut))).toThrow(ProtocolError);
  });

  it("messages to the server are those of the protocol", () => {
    expect(encodeClientMessage({ type: "tool", tool: 1, tip_m: [1, 2, 3], shaft: [0, 0, 1], roll_rad: 0, jaw: 0.5, trigger: 1 })).toBe(
      '{"type":"tool","tool":1,"tip_m":[1,2,3],"shaft":[0,0,1],"roll_rad":0,"jaw":0.5,"trigger":1}',
    );
    expect(encodeClientMessage({ type: "pause", paused: true })).toBe('{"type":"pause","paused":true}');
    expect(encodeClientMessage({ type: "single_step" })).toBe('{"type":"single_step"}');
    expect(encodeClientMessage({ type: "reset" })).toBe('{"type":"reset"}');
    expect(encodeClientMessage({ type: "contacts", shown: true })).toBe('{"type":"contacts","shown":true}');
  });
});
