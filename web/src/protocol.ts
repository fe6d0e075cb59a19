/**
 * The wire protocol of docs/protocol.md, version 1: decoding and encoding of every message.
 *
 * Decoders check every length and index against the bytes really there before anything is allocated,
 * and throw nothing but {@link ProtocolError}. Units: metres, seconds, newtons; frame: LPS.
 */

export const PROTOCOL_VERSION = 1;
/** Bytes `GLSN` read as a little-endian u32. */
export const MAGIC = 0x4e534c47;
export const KIND_TOPOLOGY = 1;
export const KIND_SNAPSHOT = 2;
export const FLAG_CONTACT = 1;
export const FLAG_PAUSED = 2;
export const FLAG_GRASP = 4;

const TOPOLOGY_HEADER_BYTES = 24;
const SNAPSHOT_HEADER_BYTES = 152;

export type Vec3 = readonly [number, number, number];

/** A message that does not follow the protocol: what was wrong, where, and what is allowed. */
export class ProtocolError extends Error {
  override readonly name = "ProtocolError";
}

export interface SceneInfo {
  readonly name: string;
  readonly model: string;
  readonly material: string;
  readonly time_step_s: number;
  readonly gravity_m_per_s2: Vec3;
  readonly n_nodes: number;
  readonly n_tetrahedra: number;
}

export interface ToolInfo {
  readonly name: string;
  readonly tip_radius_m: number;
  readonly shaft_radius_m: number;
  readonly shaft_length_m: number;
  readonly home_tip_m: Vec3;
  readonly home_shaft: Vec3;
}

export interface Hello {
  readonly type: "hello";
  readonly protocol: number;
  readonly scene: SceneInfo;
  /** Names of the models that the `model` message may ask for. */
  readonly models: readonly string[];
  readonly bounds: { readonly min_m: Vec3; readonly max_m: Vec3 };
  readonly tool: ToolInfo;
  /** Nodes of the uncut surface. */
  readonly capsule_nodes: readonly number[];
  readonly fixed_nodes: readonly number[];
}

export interface ServerError {
  readonly type: "error";
  readonly message: string;
}

export interface Topology {
  readonly kind: "topology";
  readonly version: number;
  readonly organ: number;
  /** Node id of each displayed vertex. */
  readonly nodeIds: Uint32Array;
  /** Rest positions [m], xyz of each vertex. */
  readonly rest_m: Float32Array;
  /** Vertex indices, three a triangle, counter-clockwise seen from outside. */
  readonly triangles: Uint32Array;
}

export interface SnapshotHeader {
  readonly version: number;
  readonly organ: number;
  readonly step: number;
  readonly time_s: number;
  readonly rate_steps_per_s: number;
  readonly realTimeFactor: number;
  readonly tip_m: Vec3;
  readonly shaft: Vec3;
  readonly forceOnTool_n: Vec3;
  readonly contactPoint_m: Vec3;
  readonly contact: boolean;
  readonly paused: boolean;
  readonly grasps: boolean;
}

export interface Snapshot {
  readonly kind: "snapshot";
  readonly header: SnapshotHeader;
  /** Positions [m], xyz of each vertex, in the order of the topology's vertices. */
  readonly positions_m: Float32Array;
}

export type ClientMessage =
  | { readonly type: "tool"; readonly tip_m: Vec3; readonly shaft: Vec3 }
  | { readonly type: "pause"; readonly paused: boolean }
  | { readonly type: "single_step" }
  | { readonly type: "reset" }
  | { readonly type: "cut" }
  | { readonly type: "gravity"; readonly m_per_s2: Vec3 }
  | { readonly type: "model"; readonly name: string };

export function encodeClientMessage(message: ClientMessage): string {
  return JSON.stringify(message);
}

// ---- text ----

type Fields = Readonly<Record<string, unknown>>;

function fail(message: string): never {
  throw new ProtocolError(message);
}

function fieldsOf(value: unknown, place: string): Fields {
  if (typeof value !== "object" || value === null || Array.isArray(value)) fail(`${place} must be an object`);
  return value as Fields;
}

function numberAt(fields: Fields, name: string, place: string, min = -Infinity): number {
  const value = fields[name];
  if (typeof value !== "number" || !Number.isFinite(value)) fail(`${place}.${name} must be a finite number`);
  if (value < min) fail(`${place}.${name} is ${value}; it must be at least ${min}`);
  return value;
}

function stringAt(fields: Fields, name: string, place: string): string {
  const value = fields[name];
  if (typeof value !== "string") fail(`${place}.${name} must be a string`);
  return value;
}

function vec3At(fields: Fields, name: string, place: string): Vec3 {
  const value = fields[name];
  if (!Array.isArray(value) || value.length !== 3 || !value.every((x) => typeof x === "number" && Number.isFinite(x))) {
    fail(`${place}.${name} must be three finite numbers`);
  }
  return [value[0] as number, value[1] as number, value[2] as number];
}

function nodeIdsAt(fields: Fields, name: string, place: string): number[] {
  const value = fields[name];
  if (!Array.isArray(value) || !value.every((x) => Number.isInteger(x) && x >= 0)) {
    fail(`${place}.${name} must be an array of node ids (whole numbers, 0 or more)`);
  }
  return value as number[];
}

function stringsAt(fields: Fields, name: string, place: string): string[] {
  const value = fields[name];
  if (!Array.isArray(value) || !value.every((x) => typeof x === "string")) {
    fail(`${place}.${name} must be an array of texts`);
  }
  return value as string[];
}

/** Decodes a text message of the server. */
export function decodeText(text: string): Hello | ServerError {
  let parsed: unknown;
  try {
    parsed = JSON.parse(text);
  } catch {
    fail(`text message is not JSON: ${text.slice(0, 60)}`);
  }
  const fields = fieldsOf(parsed, "message");
  const type = stringAt(fields, "type", "message");
  if (type === "error") return { type, message: stringAt(fields, "message", "error") };
  if (type !== "hello") fail(`unknown message type "${type.slice(0, 40)}"; the server may send hello or error`);
  const protocol = numberAt(fields, "protocol", "hello");
  if (protocol !== PROTOCOL_VERSION) {
    fail(`the server speaks protocol ${protocol}, this viewer ${PROTOCOL_VERSION}: build both from the same version`);
  }
  const scene = fieldsOf(fields.scene, "hello.scene");
  const bounds = fieldsOf(fields.bounds, "hello.bounds");
  const tool = fieldsOf(fields.tool, "hello.tool");
  return {
    type,
    protocol,
    scene: {
      name: stringAt(scene, "name", "scene"),
      model: stringAt(scene, "model", "scene"),
      material: stringAt(scene, "material", "scene"),
      time_step_s: numberAt(scene, "time_step_s", "scene", 0),
      gravity_m_per_s2: vec3At(scene, "gravity_m_per_s2", "scene"),
      n_nodes: numberAt(scene, "n_nodes", "scene", 0),
      n_tetrahedra: numberAt(scene, "n_tetrahedra", "scene", 0),
    },
    bounds: { min_m: vec3At(bounds, "min_m", "bounds"), max_m: vec3At(bounds, "max_m", "bounds") },
    tool: {
      name: stringAt(tool, "name", "tool"),
      tip_radius_m: numberAt(tool, "tip_radius_m", "tool", 0),
      shaft_radius_m: numberAt(tool, "shaft_radius_m", "tool", 0),
      shaft_length_m: numberAt(tool, "shaft_length_m", "tool", 0),
      home_tip_m: vec3At(tool, "home_tip_m", "tool"),
      home_shaft: vec3At(tool, "home_shaft", "tool"),
    },
    models: stringsAt(fields, "models", "hello"),
    capsule_nodes: nodeIdsAt(fields, "capsule_nodes", "hello"),
    fixed_nodes: nodeIdsAt(fields, "fixed_nodes", "hello"),
  };
}

// ---- binary ----

const HOST_IS_LITTLE_ENDIAN = new Uint8Array(new Uint32Array([1]).buffer)[0] === 1;

/** `n` f32 from byte `offset`: a view of the message where the host's byte order allows, else a copy. */
function floatsAt(buffer: ArrayBuffer, offset: number, n: number): Float32Array {
  if (HOST_IS_LITTLE_ENDIAN) return new Float32Array(buffer, offset, n);
  const view = new DataView(buffer);
  return Float32Array.from({ length: n }, (_, i) => view.getFloat32(offset + 4 * i, true));
}

function wordsAt(buffer: ArrayBuffer, offset: number, n: number): Uint32Array {
  if (HOST_IS_LITTLE_ENDIAN) return new Uint32Array(buffer, offset, n);
  const view = new DataView(buffer);
  return Uint32Array.from({ length: n }, (_, i) => view.getUint32(offset + 4 * i, true));
}

function checkFinite(values: Float32Array, what: string): void {
  for (let i = 0; i < values.length; i++) {
    if (!Number.isFinite(values[i])) fail(`${what} of vertex ${Math.floor(i / 3)} is not finite`);
  }
}

function checkLength(found: number, needed: number, what: string): void {
  if (found !== needed) fail(`${what} needs ${needed} bytes, found ${found}`);
}

/** Decodes a binary message of the server. */
export function decodeBinary(buffer: ArrayBuffer): Topology | Snapshot {
  if (buffer.byteLength < 16) fail(`binary message of ${buffer.byteLength} bytes; its header alone has 16`);
  const view = new DataView(buffer);
  const magic = view.getUint32(0, true);
  if (magic !== MAGIC) fail(`binary message begins with 0x${magic.toString(16)}, not with 0x${MAGIC.toString(16)} (GLSN)`);
  const kind = view.getUint32(4, true);
  if (kind === KIND_TOPOLOGY) return decodeTopology(buffer, view);
  if (kind === KIND_SNAPSHOT) return decodeSnapshot(buffer, view);
  return fail(`binary message of unknown kind ${kind}; allowed: 1 (topology), 2 (snapshot)`);
}

function decodeTopology(buffer: ArrayBuffer, view: DataView): Topology {
  if (buffer.byteLength < TOPOLOGY_HEADER_BYTES) fail(`topology of ${buffer.byteLength} bytes; its header has 24`);
  const nVertices = view.getUint32(16, true);
  const nTriangles = view.getUint32(20, true);
  checkLength(
    buffer.byteLength,
    TOPOLOGY_HEADER_BYTES + 16 * nVertices + 12 * nTriangles,
    `topology with ${nVertices} vertices and ${nTriangles} triangles`,
  );
  const rest_m = floatsAt(buffer, TOPOLOGY_HEADER_BYTES + 4 * nVertices, 3 * nVertices);
  checkFinite(rest_m, "topology: rest position");
  const triangles = wordsAt(buffer, TOPOLOGY_HEADER_BYTES + 16 * nVertices, 3 * nTriangles);
  for (let i = 0; i < triangles.length; i++) {
    const vertex = triangles[i];
    if (vertex >= nVertices) fail(`topology: triangle ${Math.floor(i / 3)} uses vertex ${vertex} of ${nVertices}`);
  }
  return {
    kind: "topology",
    version: view.getUint32(8, true),
    organ: view.getUint32(12, true),
    nodeIds: wordsAt(buffer, TOPOLOGY_HEADER_BYTES, nVertices),
    rest_m,
    triangles,
  };
}

function decodeSnapshot(buffer: ArrayBuffer, view: DataView): Snapshot {
  if (buffer.byteLength < SNAPSHOT_HEADER_BYTES) fail(`snapshot of ${buffer.byteLength} bytes; its header has 152`);
  const nVertices = view.getUint32(148, true);
  checkLength(buffer.byteLength, SNAPSHOT_HEADER_BYTES + 12 * nVertices, `snapshot with ${nVertices} vertices`);
  const step = view.getBigUint64(16, true);
  if (step > BigInt(Number.MAX_SAFE_INTEGER)) fail(`snapshot: step ${step} is above 2^53`);
  const scalar = (offset: number, what: string): number => {
    const value = view.getFloat64(offset, true);
    if (!Number.isFinite(value)) fail(`snapshot: ${what} (byte ${offset}) is not finite`);
    return value;
  };
  const vector = (offset: number, what: string): Vec3 => [
    scalar(offset, what),
    scalar(offset + 8, what),
    scalar(offset + 16, what),
  ];
  const flags = view.getUint32(144, true);
  const positions_m = floatsAt(buffer, SNAPSHOT_HEADER_BYTES, 3 * nVertices);
  checkFinite(positions_m, "snapshot: position");
  return {
    kind: "snapshot",
    header: {
      version: view.getUint32(8, true),
      organ: view.getUint32(12, true),
      step: Number(step),
      time_s: scalar(24, "time"),
      rate_steps_per_s: scalar(32, "simulation rate"),
      realTimeFactor: scalar(40, "real-time factor"),
      tip_m: vector(48, "tool tip"),
      shaft: vector(72, "shaft direction"),
      forceOnTool_n: vector(96, "force on the tool"),
      contactPoint_m: vector(120, "contact point"),
      contact: (flags & FLAG_CONTACT) !== 0,
      paused: (flags & FLAG_PAUSED) !== 0,
      grasps: (flags & FLAG_GRASP) !== 0,
    },
    positions_m,
  };
}

// ---- encoding of the server's frames: for tests and for the test server ----

export function encodeTopology(topology: Omit<Topology, "kind">): ArrayBuffer {
  const n = topology.nodeIds.length;
  const buffer = new ArrayBuffer(TOPOLOGY_HEADER_BYTES + 16 * n + 4 * topology.triangles.length);
  const view = new DataView(buffer);
  [MAGIC, KIND_TOPOLOGY, topology.version, topology.organ, n, topology.triangles.length / 3].forEach((word, i) =>
    view.setUint32(4 * i, word, true),
  );
  topology.nodeIds.forEach((id, i) => view.setUint32(TOPOLOGY_HEADER_BYTES + 4 * i, id, true));
  topology.rest_m.forEach((x, i) => view.setFloat32(TOPOLOGY_HEADER_BYTES + 4 * n + 4 * i, x, true));
  topology.triangles.forEach((v, i) => view.setUint32(TOPOLOGY_HEADER_BYTES + 16 * n + 4 * i, v, true));
  return buffer;
}

export function encodeSnapshot(snapshot: Omit<Snapshot, "kind">): ArrayBuffer {
  const { header, positions_m } = snapshot;
  const buffer = new ArrayBuffer(SNAPSHOT_HEADER_BYTES + 4 * positions_m.length);
  const view = new DataView(buffer);
  [MAGIC, KIND_SNAPSHOT, header.version, header.organ].forEach((word, i) => view.setUint32(4 * i, word, true));
  view.setBigUint64(16, BigInt(header.step), true);
  const scalars = [
    header.time_s,
    header.rate_steps_per_s,
    header.realTimeFactor,
    ...header.tip_m,
    ...header.shaft,
    ...header.forceOnTool_n,
    ...header.contactPoint_m,
  ];
  scalars.forEach((x, i) => view.setFloat64(24 + 8 * i, x, true));
  const flags =
    (header.contact ? FLAG_CONTACT : 0) | (header.paused ? FLAG_PAUSED : 0) | (header.grasps ? FLAG_GRASP : 0);
  view.setUint32(144, flags, true);
  view.setUint32(148, positions_m.length / 3, true);
  positions_m.forEach((x, i) => view.setFloat32(SNAPSHOT_HEADER_BYTES + 4 * i, x, true));
  return buffer;
}
