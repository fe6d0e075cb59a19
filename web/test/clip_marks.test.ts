import { Box3, BoxGeometry, CylinderGeometry, Vector3, type BufferGeometry } from "three";
import { describe, expect, it } from "vitest";
import { ClipMarks, type ClippedSurface } from "../src/clip_marks";
import type { Clip } from "../src/clips";

const surfaceOf = (geometry: BufferGeometry): ClippedSurface => ({
  positions_m: Float32Array.from(geometry.getAttribute("position").array),
  topology: { triangles: Uint32Array.from(geometry.index!.array) },
});
/** A duct of 8 mm along x. */
const DUCT = surfaceOf(new CylinderGeometry(4e-3, 4e-3, 0.06, 64, 20).rotateZ(Math.PI / 2));
/** A block of 10 cm whose right side is cut. */
const BLOCK = surfaceOf(new BoxGeometry(0.1, 0.1, 0.1).translate(-0.05, 0, 0));

const clip = (x_m: number): Clip => ({ position_m: [x_m, 0, 0], along: [1, 0, 0], legs: [0, -1, 0], radius_m: 1.5e-3 });

function boxesOf(marks: ClipMarks): Box3[] {
  marks.group.updateMatrixWorld();
  return marks.group.children.map((mesh) => new Box3().setFromObject(mesh, true));
}

describe("clips in the picture", () => {
  it("lie across a duct, around it, one at each place", () => {
    const marks = new ClipMarks();
    marks.show([clip(-0.01), clip(0.01)], DUCT);
    const boxes = boxesOf(marks);
    expect(boxes.map((box) => box.getCenter(new Vector3()).x)).toEqual([expect.closeTo(-0.01, 6), expect.closeTo(0.01, 6)]);
    for (const box of boxes) {
      const { x, y, z } = box.getSize(new Vector3());
      expect(x).toBeLessThan(2e-3);
      for (const across of [y, z]) {
        expect(across).toBeGreaterThan(8e-3);
        expect(across).toBeLessThan(10.5e-3);
      }
      expect(box.getCenter(new Vector3()).z).toBeCloseTo(0, 4);
    }
  });

  it("go with the tissue, and turn with it, without being made anew", () => {
    const marks = new ClipMarks();
    marks.show([clip(0)], DUCT);
    const [mesh] = marks.group.children;
    marks.show([{ ...clip(0), position_m: [0, 0, 0.02], along: [0, 0, 1], legs: [1, 0, 0] }], DUCT);
    const [box] = boxesOf(marks);
    expect(box.getCenter(new Vector3()).z).toBeCloseTo(0.02, 6);
    expect(box.getSize(new Vector3()).z).toBeLessThan(2e-3);
    expect(marks.group.children).toEqual([mesh]);
    marks.show([], DUCT);
    expect(marks.group.children).toEqual([]);
  });

  it("in a cut face are as wide as the vessel, and lie on the face", () => {
    const marks = new ClipMarks();
    marks.show([clip(-1e-3)], BLOCK);
    const [box] = boxesOf(marks);
    const { y, z } = box.getSize(new Vector3());
    for (const across of [y, z]) {
      expect(across).toBeGreaterThan(3e-3);
      expect(across).toBeLessThan(5e-3);
    }
    expect(box.getCenter(new Vector3()).x).toBeCloseTo(0, 6);
    // Far from any face it is where it is.
    marks.show([clip(-0.05), clip(-0.04)], BLOCK);
    expect(boxesOf(marks)[0].getCenter(new Vector3()).x).toBeCloseTo(-0.05, 6);
  });
});
