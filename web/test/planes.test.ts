import { describe, expect, it } from "vitest";
import { aspect, moved, pointAt, shareOf, type Box } from "../src/patient/planes";
import type { PlaneName, Point } from "../src/patient/state";

const BOX: Box = { from_mm: [-100, -50, 10], to_mm: [100, 70, 250] };
const PLANES: readonly PlaneName[] = ["axial", "coronal", "sagittal"];

describe("planes", () => {
  it("lead from a place in the picture to the patient and back", () => {
    const cross: Point = [12, -7, 99];
    for (const plane of PLANES) {
      const point = pointAt(plane, BOX, cross, [0.2, 0.7]);
      const [x, y] = shareOf(plane, BOX, point);
      expect(x).toBeCloseTo(0.2);
      expect(y).toBeCloseTo(0.7);
    }
  });

  it("are seen as radiologists do: head up, the patient's left on the right, the back below or on the right", () => {
    const cross: Point = [0, 0, 100];
    expect(pointAt("axial", BOX, cross, [1, 1])).toEqual([100, 70, 100]);
    expect(pointAt("coronal", BOX, cross, [1, 0])).toEqual([100, 0, 250]);
    expect(pointAt("sagittal", BOX, cross, [1, 0])).toEqual([0, 70, 250]);
  });

  it("move by voxels and stay in the image", () => {
    expect(moved("axial", BOX, [0, 0, 100], [2, 2, 5], [1, -1, 1])).toEqual([2, -2, 105]);
    expect(moved("coronal", BOX, [0, 0, 100], [2, 2, 5], [0, 1, -1])).toEqual([0, -2, 95]);
    expect(moved("sagittal", BOX, [0, 0, 249], [2, 2, 5], [0, -1, 100])).toEqual([100, 0, 250]);
  });

  it("have the image's proportions", () => {
    expect(aspect("axial", BOX)).toBeCloseTo(200 / 120);
    expect(aspect("sagittal", BOX)).toBeCloseTo(120 / 240);
  });
});
