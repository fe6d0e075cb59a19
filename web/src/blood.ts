/** The records of blood at the end of a SNAPSHOT frame (docs/protocol.md). */
import { fail, type Vec3 } from "./fields";

/** An open end of a vessel. */
export interface BleedingEnd {
  readonly position_m: Vec3;
  readonly rate_m3_per_s: number;
}

/** Blood from severed vessels. */
export interface Bleeding {
  readonly lost_m3: number;
  readonly rate_m3_per_s: number;
  readonly clips: number;
  readonly ends: readonly BleedingEnd[];
}

/** A sum, then one record for each open end: four f32 each. */
export const BLOOD_BYTES = 16;

/** Decodes `n` records from byte `at` of a frame that is long enough; null for none. */
export function decodeBlood(view: DataView, at: number, n: number): Bleeding | null {
  if (n === 0) return null;
  const record = (i: number): [number, number, number, number] => {
    const numbers = [0, 4, 8, 12].map((offset) => view.getFloat32(at + BLOOD_BYTES * i + offset, true));
    if (!numbers.every((x) => Number.isFinite(x))) fail(`snapshot: record ${i} of blood is not finite`);
    return numbers as [number, number, number, number];
  };
  const [lost_m3, rate_m3_per_s, clips] = record(0);
  const ends = Array.from({ length: n - 1 }, (_, i) => {
    const [x, y, z, rate] = record(i + 1);
    return { position_m: [x, y, z] as Vec3, rate_m3_per_s: rate };
  });
  return { lost_m3, rate_m3_per_s, clips, ends };
}

/** The records, one number after the other; for tests and for the test server. */
export function bloodNumbers(bleeding: Bleeding | null): number[] {
  if (bleeding === null) return [];
  const ends = bleeding.ends.flatMap((end) => [...end.position_m, end.rate_m3_per_s]);
  return [bleeding.lost_m3, bleeding.rate_m3_per_s, bleeding.clips, 0, ...ends];
}
