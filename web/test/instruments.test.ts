import { Box3, Matrix4 } from "three";
import { describe, expect, it } from "vitest";
import { instrumentParts, jetOf, type Part } from "../src/instruments/parts";
import { Instrument } from "../src/instrument";
import type { ToolInfo, ToolState } from "../src/protocol";

const JAWS = { length_m: 0.02, width_m: 0.005, greatest_opening_rad: 1 };

function tool(kind: string): ToolInfo {
  const hasJaws = ["grasper", "scissors", "cautery", "clipper"].includes(kind);
  return {
    name: kind,
    kind,
    tip_radius_m: 0.0015,
    shaft_radius_m: 0.0025,
    shaft_length_m: 0.3,
    jaws: hasJaws ? JAWS : null,
    optics: kind === "endoscope" ? { view_angle_rad: 0.5, field_of_view_rad: 1.2 } : null,
    trocar_m: null,
    home_tip_m: [0, 0, 0],
    home_shaft: [0, -1, 0],
    home_jaw: 1,
  };
}

function boxOf(parts: readonly Part[], turn_rad = 0): Box3 {
  const box = new Box3();
  for (const { geometry } of parts) {
    const turned = geometry.clone().applyMatrix4(new Matrix4().makeRotationY(turn_rad));
    turned.computeBoundingBox();
    box.union(turned.boundingBox!);
  }
  return box;
}

describe("instruments", () => {
  it.each(["probe", "grasper", "scissors", "scalpel", "hook", "cautery", "clipper", "endoscope", "suction"])("%s is whole, and ends at its tip", (kind) => {
    const { fixed, jaws, hinge_m } = instrumentParts(tool(kind));
    for (const { geometry } of [...fixed, ...jaws.flat()]) {
      for (const name of ["position", "normal"]) {
        const { array, count } = geometry.getAttribute(name);
        expect(count).toBeGreaterThan(0);
        expect(array.every(Number.isFinite)).toBe(true);
      }
    }
    const front_m = jaws.length > 0 ? boxOf(jaws.flat()).min.z + hinge_m : boxOf(fixed).min.z;
    expect(Math.abs(front_m)).toBeLessThan(0.004);
    expect(boxOf(fixed).max.z).toBeGreaterThan(0.29);
  });

  it.each(["grasper", "cautery", "clipper"])("the jaws of a %s meet in the middle, and are as long as those that touch", (kind) => {
    const { jaws } = instrumentParts(tool(kind));
    const [right, left] = jaws.map((parts) => boxOf(parts));
    expect(right.min.x).toBeGreaterThan(-0.0004);
    expect(left.max.x).toBeLessThan(0.0004);
    for (const { min } of [right, left]) expect(-min.z).toBeCloseTo(JAWS.length_m, 2.5);
    // Turned as the instrument opens them, they part.
    expect(boxOf(jaws[0], -0.5).max.x).toBeGreaterThan(0.008);
    expect(boxOf(jaws[1], 0.5).min.x).toBeLessThan(-0.008);
  });

  it("a suction tube has dark holes near its tip, and its jet goes ahead of it", () => {
    const { fixed } = instrumentParts(tool("suction"));
    const holes = boxOf(fixed.filter(({ look }) => look === "hole"));
    expect(holes.min.z).toBeGreaterThan(-0.0015);
    expect(holes.max.z).toBeLessThan(0.01);
    const jet = boxOf([{ look: "glass", geometry: jetOf(tool("suction")) }]);
    expect(jet.min.z).toBeCloseTo(-0.015, 6);
    expect(jet.max.z).toBeLessThan(0);
  });

  it("a suction tube shows its jet while it rinses, as far as tissue; others have none", () => {
    const state = (jaw: number) => ({ tip_m: [0, 0, 0], shaft: [0, 0, 1], roll_rad: 0, jaw, trigger: 1, forceOnTool_n: [0, 0, 0], contact: false, shownFurtherOut_m: [0, 0, 0] }) as unknown as ToolState;
    const [suction, grasper] = ["suction", "grasper"].map((kind) => new Instrument(tool(kind)));
    for (const [instrument, jaw, isShown] of [[suction, 1, false], [suction, 0, true], [grasper, 0, false]] as const) {
      instrument.show(state(jaw));
      expect(instrument.jet.visible).toBe(isShown);
    }
    for (const [ahead_m, end_m] of [[Infinity, -0.015], [0.005, -0.005], [1e-5, -0.0015]] as const) {
      suction.endJet(ahead_m);
      suction.group.updateMatrixWorld(true);
      expect(new Box3().setFromObject(suction.jet, true).min.z).toBeCloseTo(end_m, 6);
    }
  });

  it("blades of scissors pass each other, one at either side", () => {
    const [right, left] = instrumentParts(tool("scissors")).jaws.map((parts) => boxOf(parts));
    // At the hinge, where they are not bent yet, one ends where the other begins.
    expect(right.min.y).toBeLessThan(-0.0008);
    expect(left.min.y).toBeGreaterThan(-1e-5);
    expect(right.max.x).toBeGreaterThan(0.0015);
    expect(left.min.x).toBeLessThan(-0.0015);
  });
});
