/** The contact points at the end of a SNAPSHOT frame (docs/protocol.md), for viewers that asked for them. */
import { fail, type Vec3 } from "./fields";

/** What touches what, by the numbers of the wire. */
export const CONTACT_KINDS = ["tool_organ", "tool_rigid", "bodies", "itself", "tool_tool"] as const;
export type ContactKind = (typeof CONTACT_KINDS)[number];

/** A place of a surface that bears a force. */
export interface ContactPoint {
  readonly kind: ContactKind;
  /** Number of the touched body; of two bodies, and of two instruments, the higher number. */
  readonly touched: number;
  /** Number of the instrument or body that touches it. */
  readonly by: number;
  readonly place_m: Vec3;
  /** Unit normal out of what is touched; zero where jaws hold. */
  readonly normal: Vec3;
  /** Force of what is touched on what touches it. */
  readonly force_n: Vec3;
}

/** All contacts of a kind, also those that are not in the list. */
export interface ContactSum {
  readonly n: number;
  /** Sum of the sizes of their forces. */
  readonly force_n: number;
}

export interface ContactPoints {
  /** In the order of {@link CONTACT_KINDS}. */
  readonly sums: readonly ContactSum[];
  /** Those of instruments, then the others; of each the greatest force first. */
  readonly points: readonly ContactPoint[];
}

const SUMS_BYTES = 8 * CONTACT_KINDS.length;
const POINT_BYTES = 40;

/** Contacts that bear a force and are not in the list. */
export function leftOut({ sums, points }: ContactPoints): number {
  return Math.max(0, sums.reduce((n, sum) => n + sum.n, 0) - points.length);
}

/** How many bytes the part at `at` says that it has; more than there are where not even its number of points is there. */
export function contactPointsBytes(view: DataView, at: number): number {
  if (at + SUMS_BYTES + 4 > view.byteLength) return SUMS_BYTES + 4;
  return SUMS_BYTES + 4 + POINT_BYTES * view.getUint32(at + SUMS_BYTES, true);
}

/** Decodes the part at byte `at` of a frame that is long enough. */
export function decodeContactPoints(view: DataView, at: number): ContactPoints {
  const number = (offset: number, what: string): number => {
    const value = view.getFloat32(offset, true);
    if (!Number.isFinite(value)) fail(`snapshot: ${what} (byte ${offset}) is not finite`);
    return value;
  };
  const vector = (offset: number, what: string): Vec3 => [number(offset, what), number(offset + 4, what), number(offset + 8, what)];
  const point = (from: number): ContactPoint => {
    const kind = CONTACT_KINDS[view.getUint8(from)];
    if (kind === undefined) fail(`snapshot: contact of kind ${view.getUint8(from)}; allowed: 0 to ${CONTACT_KINDS.length - 1}`);
    return {
      kind,
      touched: view.getUint8(from + 1),
      by: view.getUint8(from + 2),
      place_m: vector(from + 4, "place of a contact"),
      normal: vector(from + 16, "normal of a contact"),
      force_n: vector(from + 28, "force of a contact"),
    };
  };
  const n = view.getUint32(at + SUMS_BYTES, true);
  return {
    sums: CONTACT_KINDS.map((_, i) => ({ n: view.getUint32(at + 8 * i, true), force_n: number(at + 8 * i + 4, "sum of contact forces") })),
    points: Array.from({ length: n }, (_, i) => point(at + SUMS_BYTES + 4 + POINT_BYTES * i)),
  };
}

/** The part as bytes; for tests and for the test server. */
export function encodeContactPoints(contacts: ContactPoints | null): Uint8Array {
  if (contacts === null) return new Uint8Array(0);
  const bytes = new Uint8Array(SUMS_BYTES + 4 + POINT_BYTES * contacts.points.length);
  const view = new DataView(bytes.buffer);
  contacts.sums.forEach((sum, i) => {
    view.setUint32(8 * i, sum.n, true);
    view.setFloat32(8 * i + 4, sum.force_n, true);
  });
  view.setUint32(SUMS_BYTES, contacts.points.length, true);
  contacts.points.forEach((point, i) => {
    const at = SUMS_BYTES + 4 + POINT_BYTES * i;
    [CONTACT_KINDS.indexOf(point.kind), point.touched, point.by].forEach((byte, k) => view.setUint8(at + k, byte));
    [...point.place_m, ...point.normal, ...point.force_n].forEach((x, k) => view.setFloat32(at + 4 + 4 * k, x, true));
  });
  return bytes;
}
