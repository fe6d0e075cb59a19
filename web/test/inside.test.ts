import { describe, expect, it } from "vitest";
import { ProtocolError } from "../src/fields";
import { colourInto, Range, SCALE, valueText } from "../src/inside/colours";
import { cutPlane, thickness_m } from "../src/inside/plane";
import { decodeInside, insideBytes } from "../src/inside/snapshot";

/** As `InsideView` of the server is written, from byte 8 on. */
function bytes(field: number, values: readonly number[], corners: readonly number[]): DataView {
  const floats = [0.5, 0.25, 0.125, ...values, ...corners];
  const view = new DataView(new ArrayBuffer(8 + 12 + 4 * floats.length));
  [field, values.length, corners.length / 4].forEach((n, i) => view.setUint32(8 + 4 * i, n, true));
  floats.forEach((x, i) => view.setFloat32(20 + 4 * i, x, true));
  return view;
}

describe("the inside in a snapshot", () => {
  const corners = [1, 2, 3, 9, 4, 5, 6, 8, 7, 8, 9, 7];

  it("is decoded whole", () => {
    const view = bytes(2, [1, 2], corners);
    expect(insideBytes(view, 8)).toBe(view.byteLength - 8);
    const inside = decodeInside(view, 8, 2);
    expect([inside.field, inside.energies_j]).toEqual(["stress", [0.5, 0.25, 0.125]]);
    expect([[...inside.values], [...inside.section_m], [...inside.sectionValues]]).toEqual([[1, 2], [1, 2, 3, 4, 5, 6, 7, 8, 9], [9, 8, 7]]);
  });

  it("is refused where it is broken", () => {
    for (const view of [bytes(4, [], []), bytes(1, [1], []), bytes(0, [], [1, 2, 3, 4]), bytes(1, [1, Number.NaN], [])]) {
      expect(() => decodeInside(view, 8, 2)).toThrow(ProtocolError);
    }
    expect(() => insideBytes(new DataView(new ArrayBuffer(20)), 8)).toThrow(ProtocolError);
  });
});

describe("the colours of a field", () => {
  it("grow lighter all the way, and stay at the ends", () => {
    const of = (share: number): number => {
      const rgb = new Float32Array(3);
      colourInto(share, rgb, 0);
      return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
    };
    for (let share = 0; share < 1; share += 0.01) expect(of(share + 0.01)).toBeGreaterThan(of(share));
    expect([of(-1), of(7)]).toEqual([of(0), of(1)]);
    const first = new Float32Array(3);
    colourInto(0, first, 0);
    expect(1.055 * first[2] ** (1 / 2.4) - 0.055).toBeCloseTo(Number.parseInt(SCALE[0].slice(5), 16) / 255, 4);
  });

  it("have a scale that ends at a round number, and comes down slowly", () => {
    const range = new Range();
    const mostly = Float32Array.from({ length: 100 }, (_, i) => (i < 99 ? 15 * i : 1e6));
    expect(range.take("stress", mostly)).toBe(2000);
    expect(range.take("stress", Float32Array.of(100, 100))).toBe(2000);
    for (let i = 0; i < 1000; i++) range.take("stress", Float32Array.of(100));
    expect(range.take("stress", Float32Array.of(100))).toBe(100);
    expect(range.take("quality", Float32Array.of(0.3))).toBe(1);
    expect(range.take("strain", Float32Array.of(0))).toBe(0.01);
  });

  it("have units", () => {
    expect([valueText("strain", 0.05), valueText("stress", 250), valueText("stress", 1500), valueText("quality", 0.5)]).toEqual(["5 %", "250 Pa", "1.5 kPa", "0.5"]);
  });
});

describe("the cut plane", () => {
  const bounds = { min_m: [0, 10, 20], max_m: [1, 12, 23] } as const;

  it("goes through the organ from the side that it takes away", () => {
    expect(cutPlane("off", 0.5, false, bounds)).toBeNull();
    expect(cutPlane("axial", 0, false, bounds)).toEqual({ point_m: [0.5, 11, 23], normal: [0, 0, 1] });
    expect(cutPlane("axial", 1, true, bounds)).toEqual({ point_m: [0.5, 11, 23], normal: [0, 0, -1] });
    expect(cutPlane("coronal", 0.25, false, bounds)).toEqual({ point_m: [0.5, 10.5, 21.5], normal: [0, -1, 0] });
    expect(cutPlane("sagittal", 0.25, false, bounds)?.point_m[0]).toBe(0.75);
    expect([thickness_m("axial", bounds), thickness_m("coronal", bounds)]).toEqual([3, 2]);
  });
});
