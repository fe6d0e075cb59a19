import { describe, expect, it } from "vitest";
import { Inputs } from "../src/patient/inputs";
import type { Outline, Point } from "../src/patient/state";

const corners: readonly Point[] = [
  [0, 0, 5],
  [10, 0, 5],
  [0, 10, 5],
];
const inFive = ({ through_mm }: Outline): boolean => through_mm[2] === 5;

describe("inputs", () => {
  it("take an organ out of a slice whatever was drawn there, and back in", () => {
    const inputs = new Inputs();
    inputs.draft = [...corners];
    expect(inputs.finish(inFive)).toBe(null);
    inputs.byHand.push({ through_mm: [0, 0, 7], points_mm: corners });
    inputs.leaveOut([1, 2, 5], inFive);
    inputs.leaveOut([1, 2, 5], inFive);
    expect(inputs.byHand.map(({ points_mm }) => points_mm.length)).toEqual([3, 0]);
    inputs.draft = [...corners];
    expect(inputs.finish(inFive)).toBe(null);
    expect(inputs.byHand.map(({ through_mm }) => through_mm[2])).toEqual([7, 5]);
    inputs.draft = corners.slice(0, 2);
    expect(inputs.finish(inFive)).toContain("3 corners");
  });

  it("keep what was said of each organ, and ask for what the method takes", () => {
    const inputs = new Inputs();
    inputs.points = [
      { at_mm: [1, 2, 3], kind: "inside" },
      { at_mm: [4, 5, 6], kind: "outside" },
    ];
    inputs.byHand = [{ through_mm: [0, 0, 5], points_mm: corners }];
    expect(inputs.choice("liver")).toMatchObject({ name: "liver", method: "points", inside_mm: [[1, 2, 3]], outside_mm: [[4, 5, 6]], outlines: [] });
    inputs.method = "contours";
    expect(inputs.choice("liver")).toMatchObject({ method: "contours", outside_mm: [], outlines: [{ through_mm: [0, 0, 5] }] });
    inputs.recall("spleen");
    expect([inputs.points.length, inputs.byHand.length]).toEqual([0, 0]);
    inputs.recall("liver");
    expect([inputs.points.length, inputs.byHand.length, inputs.method]).toEqual([2, 1, "contours"]);
    inputs.forget();
    inputs.recall("liver");
    expect(inputs.points.length).toBe(0);
  });
});
