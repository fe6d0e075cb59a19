import { describe, expect, it } from "vitest";
import { aspect, isOneSlice, middleVoxel, moved, pointAt, shareOf, type Box } from "../src/patient/planes";
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

  it("know which slice of the image a point is in, by the nearest middle", () => {
    const n = 145;
    const box: Box = { from_mm: [-191.25, -110.25, -216.3471], to_mm: [191.25, 110.25, -216.3471 + 1.5 * (n - 1)] };
    const image = (z: number): { box: Box; steps_mm: Point; at_mm: Point } => ({ box, steps_mm: [1.5, 1.5, 1.5], at_mm: [0, 0, z] });
    for (let k = 0; k < n; k++) {
      const middle = -216.3471 + 1.5 * k;
      // As the server writes it.
      const told: Point = [3, 4, Math.round(100 * middle) / 100];
      for (const off of [-0.7, 0, 0.7]) expect(isOneSlice("axial", image(middle + off), told)).toBe(true);
      for (const off of [-0.8, 0.8, 1.5]) expect(isOneSlice("axial", image(middle + off), told)).toBe(false);
    }
    const [, , z] = middleVoxel(box, [1.5, 1.5, 1.5]);
    expect((z - box.from_mm[2]) / 1.5).toBeCloseTo(72, 9);
    const even = middleVoxel({ from_mm: [0, 0, 0], to_mm: [1, 3, 5] }, [1, 1, 1]);
    expect(even).toEqual([1, 2, 3]);
  });
});
