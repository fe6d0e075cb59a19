/**
 * The wire protocol of docs/protocol.md, version 12: decoding of every message, encoding of the viewer's.
 *
 * Decoders check every length and index against the bytes really there before anything is allocated,
 * and throw nothing but {@link ProtocolError}. Units: metres, seconds, newtons; frame: LPS.
 */

import { decodeTask, type TaskNews } from "./task";
import { decodeParameters, type ParameterName, type Parameters } from "./turning/parameters";
import { BLOOD_BYTES, decodeBlood, type Bleeding } from "./blood";
import { bodiesAt, type BodyInfo } from "./body_info";
import { contactPointsBytes, decodeContactPoints, type ContactPoints } from "./contact_points";
import { decodeClass, decodeMarks, type ClassNews, type MarksNews } from "./classroom";
import { clipsBytes, decodeClips, type Clip } from "./clips";
import { codedBytes, decodeCoded, decodeKey, type Key } from "./coded_positions";
import { decodeInside, insideBytes, type FieldKind, type InsideSnapshot } from "./inside/snapshot";
import type { CutPlane } from "./inside/plane";
import { decodeStrands, strandsBytes } from "./strands";
import { decodeThreads, threadsBytes, type Thread } from "./threads";
import { decodeFeel, type Feel } from "./feel";
import { decodeRole, decodeTiming, type Role, type Timing } from "./timing";
import { MOST_TOOLS, toolsAt, type JawsInfo, type OpticsInfo, type ToolInfo } from "./tool_info";
import { fail, fieldsOf, nodeIdsAt, numberAt, ProtocolError, stringAt, stringsAt, vec3At, type Fields, type Vec3 } from "./fields";

export const PROTOCOL_VERSION = 12;
/** Bytes `GLSN` read as a little-endian u32. */
export const MAGIC = 0x4e534c47;
export const KIND_TOPOLOGY = 1;
export const KIND_SNAPSHOT = 2;
export const KIND_KEY = 3;
export const FLAG_CONTACT = 1;
export const FLAG_PAUSED = 2;
export const FLAG_GRASP = 4;
export const FLAG_CONTACT_POINTS = 8;
export const FLAG_THREADS = 16;
export const FLAG_INSIDE = 32;
export const FLAG_CODED = 64;
export const FLAG_STRANDS = 128;
export const FLAG_CLIPS = 256;
export const FLAG_ODD_RESETS = 512;

export const TOPOLOGY_HEADER_BYTES = 24;
export const SNAPSHOT_HEADER_BYTES = 64;
export const TOOL_BYTES = 152;

export { MOST_TOOLS };
export type { BodyInfo, JawsInfo, OpticsInfo, ToolInfo, Vec3 };

export { ProtocolError };

export interface SceneInfo {
  readonly name: string;
  readonly model: string;
  readonly material: string;
  readonly time_step_s: number;
  readonly gravity_m_per_s2: Vec3;
  readonly n_nodes: number;
  readonly n_tetrahedra: number;
  readonly n_vessels: number;
}

export interface Hello {
  readonly type: "hello";
  readonly protocol: number;
  readonly scene: SceneInfo;
  /** Names of the models that the `model` message may ask for. */
  readonly models: readonly string[];
  readonly bounds: { readonly min_m: Vec3; readonly max_m: Vec3 };
  /** Several bodies, by their numbers; none for one organ. */
  readonly bodies: readonly BodyInfo[];
  readonly tools: readonly ToolInfo[];
  readonly fixed_nodes: readonly number[];
  /** The page in control may end the simulation: a start page comes after it. */
  readonly can_leave: boolean;
  /** Force-feedback devices, and which instrument each holds. */
  readonly devices: ReadonlyArray<{ readonly tool: number; readonly name: string }>;
}

/** What the user should know: what is wrong, or (news) as it should be. */
export interface ServerNotice {
  readonly type: "error" | "news";
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
  /** 1 for each triangle that lies in a cut, 0 for those of the organ's own surface. */
  readonly isCut: Uint8Array;
  /** The body of each vertex, by its number in the hello's list; 0 for one organ. */
  readonly bodyOf: Uint8Array;
}

/** What one instrument does. */
export interface ToolState {
  readonly tip_m: Vec3;
  readonly shaft: Vec3;
  readonly roll_rad: number;
  readonly jaw: number;
  readonly trigger: number;
  readonly forceOnTool_n: Vec3;
  readonly contactPoint_m: Vec3;
  readonly contact: boolean;
  readonly grasps: boolean;
  readonly heldNodes: number;
  /** It is drawn so much further out [m]: it is that far in the surface of a mesh that is too coarse to show its dimple. */
  readonly shownFurtherOut_m: Vec3;
}

export interface SnapshotHeader {
  readonly version: number;
  readonly organ: number;
  readonly step: number;
  readonly time_s: number;
  readonly rate_steps_per_s: number;
  readonly realTimeFactor: number;
  readonly paused: boolean;
  readonly oddResets: boolean;
  /** In the order of the hello's tools; at least one. */
  readonly tools: readonly ToolState[];
  /** Null for an organ without vessels. */
  readonly bleeding: Bleeding | null;
  /** Null unless the viewer asked for them. */
  readonly contactPoints: ContactPoints | null;
  readonly threads: readonly Thread[];
  /** Both ends of each strand of attachments between bodies, three numbers each. */
  readonly strands_m: Float32Array;
  /** On vessels. */
  readonly clips: readonly Clip[];
  /** Null unless the viewer looks at it. */
  readonly inside: InsideSnapshot | null;
}

/** A header with the state of the instrument in the hand at its top. */
export type HandHeader = SnapshotHeader & ToolState;

/** The header as the hand with instrument number `tool` sees it; the first one where there is no such. */
export function headerOfHand(header: SnapshotHeader, tool: number): HandHeader {
  return { ...header, ...(header.tools[tool] ?? header.tools[0]) };
}

export interface Snapshot {
  readonly kind: "snapshot";
  readonly header: SnapshotHeader;
  /** Positions [m], xyz of each vertex, in the order of the topology's vertices. */
  readonly positions_m: Float32Array;
}

export type ClientMessage =
  | {
      readonly type: "tool";
      readonly tool: number;
      readonly tip_m: Vec3;
      readonly shaft: Vec3;
      readonly roll_rad: number;
      readonly jaw: number;
      readonly trigger: number;
    }
  | { readonly type: "pause"; readonly paused: boolean }
  | { readonly type: "single_step" }
  | { readonly type: "speed"; readonly factor: number }
  | { readonly type: "reset" }
  | { readonly type: "cut"; readonly tool: number }
  | { readonly type: "clip"; readonly tool: number }
  | { readonly type: "refine"; readonly tool: number }
  | { readonly type: "undo" }
  | { readonly type: "task_event"; readonly number: number }
  | { readonly type: "bookmark"; readonly time_s: number; readonly text?: string }
  | { readonly type: "leave" }
  | { readonly type: "take_over" | "give_back" | "erase" }
  | { readonly type: "introduce"; readonly name: string }
  | { readonly type: "point"; readonly at_m: Vec3 | null }
  | { readonly type: "draw"; readonly points_m: readonly Vec3[] }
  | { readonly type: "contacts"; readonly shown: boolean }
  | { readonly type: "gravity"; readonly m_per_s2: Vec3 }
  | { readonly type: "model"; readonly name: string }
  | { readonly type: "turn"; readonly parameter: ParameterName; readonly body: number; readonly value: number }
  | { readonly type: "inside"; readonly field: FieldKind; readonly plane: CutPlane | null; readonly energies: boolean }
  | { readonly type: "offer"; readonly tool: number; readonly offered: boolean }
  | { readonly type: "hold"; readonly tool: number; readonly held: boolean };

export function encodeClientMessage(message: ClientMessage): string {
  return JSON.stringify(message);
}

// ---- text ----

/** Decodes a text message of the server. */
export function decodeText(text: string): Hello | ServerNotice | Role | Timing | Feel | TaskNews | Parameters | ClassNews | MarksNews {
  let parsed: unknown;
  try {
    parsed = JSON.parse(text);
  } catch {
    fail(`text message is not JSON: ${text.slice(0, 60)}`);
  }
  const fields = fieldsOf(parsed, "message");
  const type = stringAt(fields, "type", "message");
  if (type === "error" || type === "news") return { type, message: stringAt(fields, "message", type) };
  if (type === "role") return decodeRole(fields);
  if (type === "timing") return decodeTiming(fields);
  if (type === "feel") return decodeFeel(fields);
  if (type === "task") return decodeTask(fields);
  if (type === "parameters") return decodeParameters(fields);
  if (type === "class") return decodeClass(fields);
  if (type === "marks") return decodeMarks(fields);
  if (type !== "hello") {
    fail(`unknown message type "${type.slice(0, 40)}"; the server may send hello, role, timing, feel, task, parameters, class, marks, news or error`);
  }
  const protocol = numberAt(fields, "protocol", "hello");
  if (protocol !== PROTOCOL_VERSION) {
    fail(`the server speaks protocol ${protocol}, this viewer ${PROTOCOL_VERSION}: build both from the same version`);
  }
  const scene = fieldsOf(fields.scene, "hello.scene");
  const bounds = fieldsOf(fields.bounds, "hello.bounds");
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
      n_vessels: numberAt(scene, "n_vessels", "scene", 0),
    },
    bounds: { min_m: vec3At(bounds, "min_m", "bounds"), max_m: vec3At(bounds, "max_m", "bounds") },
    bodies: bodiesAt(fields),
    tools: toolsAt(fields),
    models: stringsAt(fields, "models", "hello"),
    fixed_nodes: nodeIdsAt(fields, "fixed_nodes", "hello"),
    can_leave: fields.can_leave === true,
    devices: devicesAt(fields),
  };
}

/** Recordings have none. */
function devicesAt({ devices }: Fields): Array<{ tool: number; name: string }> {
  if (!Array.isArray(devices)) return [];
  return devices.map((item: unknown, i) => {
    const device = fieldsOf(item, `devices[${i}]`);
    return { tool: numberAt(device, "tool", `devices[${i}]`, 0), name: stringAt(device, "name", `devices[${i}]`) };
  });
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

/** Decodes a binary message of the server; `held`: the last key that came. */
export function decodeBinary(buffer: ArrayBuffer, held: Key | null = null): Topology | Snapshot | Key {
  if (buffer.byteLength < 16) fail(`binary message of ${buffer.byteLength} bytes; its header alone has 16`);
  const view = new DataView(buffer);
  const magic = view.getUint32(0, true);
  if (magic !== MAGIC) fail(`binary message begins with 0x${magic.toString(16)}, not with 0x${MAGIC.toString(16)} (GLSN)`);
  const kind = view.getUint32(4, true);
  if (kind === KIND_TOPOLOGY) return decodeTopology(buffer, view);
  if (kind === KIND_SNAPSHOT) return decodeSnapshot(buffer, view, held);
  if (kind === KIND_KEY) return decodeKey(buffer, view);
  return fail(`binary message of unknown kind ${kind}; allowed: 1 (topology), 2 (snapshot), 3 (key)`);
}

function decodeTopology(buffer: ArrayBuffer, view: DataView): Topology {
  if (buffer.byteLength < TOPOLOGY_HEADER_BYTES) fail(`topology of ${buffer.byteLength} bytes; its header has 24`);
  const nVertices = view.getUint32(16, true);
  const nTriangles = view.getUint32(20, true);
  checkLength(
    buffer.byteLength,
    TOPOLOGY_HEADER_BYTES + 16 * nVertices + 12 * nTriangles + 4 * Math.ceil(nTriangles / 32) + 4 * Math.ceil(nVertices / 4),
    `topology with ${nVertices} vertices and ${nTriangles} triangles`,
  );
  const rest_m = floatsAt(buffer, TOPOLOGY_HEADER_BYTES + 4 * nVertices, 3 * nVertices);
  checkFinite(rest_m, "topology: rest position");
  const triangles = wordsAt(buffer, TOPOLOGY_HEADER_BYTES + 16 * nVertices, 3 * nTriangles);
  const nFlags = Math.ceil(nTriangles / 32);
  const flags = wordsAt(buffer, TOPOLOGY_HEADER_BYTES + 16 * nVertices + 12 * nTriangles, nFlags);
  const bodyOf = new Uint8Array(buffer, TOPOLOGY_HEADER_BYTES + 16 * nVertices + 12 * nTriangles + 4 * nFlags, nVertices);
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
    isCut: Uint8Array.from({ length: nTriangles }, (_, i) => (flags[i >>> 5] >>> (i & 31)) & 1),
    bodyOf,
  };
}

function decodeSnapshot(buffer: ArrayBuffer, view: DataView, held: Key | null): Snapshot {
  if (buffer.byteLength < SNAPSHOT_HEADER_BYTES) fail(`snapshot of ${buffer.byteLength} bytes; its header has 64`);
  const nTools = view.getUint32(52, true);
  if (nTools < 1 || nTools > MOST_TOOLS) fail(`snapshot with ${nTools} instruments; allowed: 1 to ${MOST_TOOLS}`);
  const nVertices = view.getUint32(56, true);
  const nBlood = view.getUint32(60, true);
  const first = SNAPSHOT_HEADER_BYTES + TOOL_BYTES * nTools;
  const flags = view.getUint32(48, true);
  const isCoded = (flags & FLAG_CODED) !== 0;
  const blood = first + (isCoded ? codedBytes(view, first) : 12 * nVertices);
  const contacts = blood + BLOOD_BYTES * nBlood;
  const hasContacts = (flags & FLAG_CONTACT_POINTS) !== 0;
  const threads = contacts + (hasContacts ? contactPointsBytes(view, contacts) : 0);
  const hasThreads = (flags & FLAG_THREADS) !== 0;
  const clips = threads + (hasThreads ? threadsBytes(view, threads) : 0);
  const hasClips = (flags & FLAG_CLIPS) !== 0;
  const inside = clips + (hasClips ? clipsBytes(view, clips) : 0);
  const hasInside = (flags & FLAG_INSIDE) !== 0;
  const strands = inside + (hasInside ? insideBytes(view, inside) : 0);
  const hasStrands = (flags & FLAG_STRANDS) !== 0;
  const end = strands + (hasStrands ? strandsBytes(view, strands) : 0);
  checkLength(buffer.byteLength, end, `snapshot with ${nVertices} vertices and ${nBlood} records of blood`);
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
  const tool = (at: number): ToolState => {
    const flags = view.getUint32(at + 120, true);
    return {
      tip_m: vector(at, "tool tip"),
      shaft: vector(at + 24, "shaft direction"),
      roll_rad: scalar(at + 48, "roll"),
      jaw: scalar(at + 56, "jaw opening"),
      trigger: scalar(at + 64, "trigger"),
      forceOnTool_n: vector(at + 72, "force on the tool"),
      contactPoint_m: vector(at + 96, "contact point"),
      contact: (flags & FLAG_CONTACT) !== 0,
      grasps: (flags & FLAG_GRASP) !== 0,
      heldNodes: view.getUint32(at + 124, true),
      shownFurtherOut_m: vector(at + 128, "way that the tool is shown further out"),
    };
  };
  const positions_m = isCoded ? decodeCoded(view, first, nVertices, held) : floatsAt(buffer, first, 3 * nVertices);
  if (!isCoded) checkFinite(positions_m, "snapshot: position");
  return {
    kind: "snapshot",
    header: {
      version: view.getUint32(8, true),
      organ: view.getUint32(12, true),
      step: Number(step),
      time_s: scalar(24, "time"),
      rate_steps_per_s: scalar(32, "simulation rate"),
      realTimeFactor: scalar(40, "real-time factor"),
      paused: (flags & FLAG_PAUSED) !== 0,
      oddResets: (flags & FLAG_ODD_RESETS) !== 0,
      tools: Array.from({ length: nTools }, (_, i) => tool(SNAPSHOT_HEADER_BYTES + TOOL_BYTES * i)),
      bleeding: decodeBlood(view, blood, nBlood),
      contactPoints: hasContacts ? decodeContactPoints(view, contacts) : null,
      threads: hasThreads ? decodeThreads(view, threads) : [],
      clips: hasClips ? decodeClips(view, clips) : [],
      inside: hasInside ? decodeInside(view, inside, nVertices) : null,
      strands_m: hasStrands ? decodeStrands(view, strands) : new Float32Array(),
    },
    positions_m,
  };
}
