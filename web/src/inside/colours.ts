/**
 * Colours of a scale from 0 to 1: dark blue to yellow, ever lighter, so that who sees few colours reads it by its lightness (as the scale
 * viridis of van der Walt and Smith, 2015, of which these are five points).
 */
import { niceCeiling } from "../plot";
import type { FieldKind } from "./snapshot";

export const SCALE = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"] as const;

/** As the eye sees them (sRGB). */
const POINTS = SCALE.map((hex) => [1, 3, 5].map((at) => Number.parseInt(hex.slice(at, at + 2), 16) / 255));
const linear = (x: number): number => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);

/** Writes the colour of a share (linear light, as shaders want it) to `out` from `at` on. */
export function colourInto(share: number, out: Float32Array, at: number): void {
  const place = Math.min(1, Math.max(0, share)) * (POINTS.length - 1);
  const before = Math.min(POINTS.length - 2, Math.floor(place));
  for (let k = 0; k < 3; k++) {
    const [from, to] = [POINTS[before][k], POINTS[before + 1][k]];
    out[at + k] = linear(from + (place - before) * (to - from));
  }
}

/** This share of the vertices is below the scale's end: a tip presses on so few that all others would be dark. A choice. */
const BELOW_END = 0.98;

/** What is left of the greatest value from one snapshot to the next: half of it after two seconds. */
const FADES_BY = 0.994;
const LEAST: Readonly<Record<FieldKind, number>> = { none: 1, strain: 0.01, stress: 10, quality: 1 };

/** The upper end of the scale: round, above nearly all that is shown, lower again some seconds later. */
export class Range {
  private largest = 0;
  private field: FieldKind = "none";

  take(field: FieldKind, values: Float32Array): number {
    if (field !== this.field) this.largest = 0;
    this.field = field;
    const sorted = values.slice().sort();
    const high = sorted[Math.floor(BELOW_END * (sorted.length - 1))] ?? 0;
    this.largest = Math.max(high, this.largest * FADES_BY);
    return field === "quality" ? 1 : niceCeiling(this.largest, LEAST[field]);
  }
}

/** A value of the scale with its unit: `20 %`, `1.5 kPa`, `0.5`. */
export function valueText(field: FieldKind, value: number): string {
  const figures = (x: number): string => String(Number(x.toPrecision(2)));
  if (field === "strain") return `${figures(100 * value)} %`;
  if (field === "stress") return value < 1000 ? `${figures(value)} Pa` : `${figures(value / 1000)} kPa`;
  return figures(value);
}
