/** What a snapshot tells of the inside of bodies (flag 32 of docs/protocol.md), for who looks at it. */
import { fail } from "../fields";

/** What the colours show, in the order of their numbers. */
export const FIELDS = ["none", "strain", "stress", "quality"] as const;
export type FieldKind = (typeof FIELDS)[number];

const HEAD_BYTES = 24;
/** A corner of the section: place and value, f32 each. */
const CORNER_BYTES = 16;

export interface InsideSnapshot {
  readonly field: FieldKind;
  /** Kinetic, elastic, and in the hand's spring [J]. */
  readonly energies_j: readonly [number, number, number];
  /** At each displayed vertex; empty without a field. */
  readonly values: Float32Array;
  /** Corners of the section's triangles, xyz each [m]. */
  readonly section_m: Float32Array;
  /** At each of its corners. */
  readonly sectionValues: Float32Array;
}

function counts(view: DataView, at: number): readonly [field: number, nValues: number, nCorners: number] {
  if (view.byteLength < at + HEAD_BYTES) fail(`snapshot: the inside begins at byte ${at} of ${view.byteLength}`);
  return [view.getUint32(at, true), view.getUint32(at + 4, true), view.getUint32(at + 8, true)];
}

/** Bytes that it takes from byte `at` on. */
export function insideBytes(view: DataView, at: number): number {
  const [, nValues, nCorners] = counts(view, at);
  return HEAD_BYTES + 4 * nValues + CORNER_BYTES * nCorners;
}

/** The length was checked. */
export function decodeInside(view: DataView, at: number, nVertices: number): InsideSnapshot {
  const [field, nValues, nCorners] = counts(view, at);
  const name = FIELDS[field] ?? fail(`snapshot: the inside has the field ${field}; allowed: 0 to ${FIELDS.length - 1}`);
  if (nValues !== 0 && nValues !== nVertices) fail(`snapshot: ${nValues} values for ${nVertices} vertices`);
  if (nCorners % 3 !== 0) fail(`snapshot: a section of ${nCorners} corners; triangles have three`);
  const float = (offset: number): number => {
    const value = view.getFloat32(offset, true);
    return Number.isFinite(value) ? value : fail(`snapshot: the inside (byte ${offset}) is not finite`);
  };
  const first = at + HEAD_BYTES;
  const corners = first + 4 * nValues;
  const section_m = new Float32Array(3 * nCorners);
  const sectionValues = new Float32Array(nCorners);
  for (let i = 0; i < nCorners; i++) {
    for (let k = 0; k < 3; k++) section_m[3 * i + k] = float(corners + CORNER_BYTES * i + 4 * k);
    sectionValues[i] = float(corners + CORNER_BYTES * i + 12);
  }
  return {
    field: name,
    energies_j: [float(at + 12), float(at + 16), float(at + 20)],
    values: Float32Array.from({ length: nValues }, (_, i) => float(first + 4 * i)),
    section_m,
    sectionValues,
  };
}
