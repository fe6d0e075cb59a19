import { Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { isFull, nextDetail } from "../src/detail";
import { Burns, hotTools } from "../src/field/burns";
import { washingOf } from "../src/field/suction";
import type { BodyInfo, Hello, SnapshotHeader, ToolInfo, ToolState } from "../src/protocol";
import { bedDepth_m, downOf } from "../src/theatre/scenery";
import { lookOf, looksOf } from "../src/tissue/looks";

/** A square metre in the plane z = 0 at rest, now lifted by 2 m. */
const SURFACE = {
  rest_m: new Float32Array([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0]),
  positions_m: new Float32Array([0, 0, 2, 1, 0, 2, 1, 1, 2, 0, 1, 2]),
  triangles: new Uint32Array([0, 1, 2, 0, 2, 3]),
};

describe("burns", () => {
  it("are where a hot tip was on the tissue at rest, grow with the time of the simulation, and fade outwards", () => {
    const burns = new Burns();
    expect(burns.heat(new Vector3(0.5, 0.25, 2), 0.001, 0.07, SURFACE)).toBe(true);
    const first = burns.at([0.5, 0.25, 0]);
    expect(first).toBeCloseTo(0.2, 6);
    for (let i = 0; i < 9; i++) burns.heat(new Vector3(0.5, 0.25, 2), 0.001, 0.07, SURFACE);
    expect(burns.at([0.5, 0.25, 0])).toBe(1);
    expect(burns.all).toHaveLength(1);
    expect(burns.at([0.503, 0.25, 0])).toBeGreaterThan(0);
    expect(burns.at([0.503, 0.25, 0])).toBeLessThan(1);
    expect(burns.at([0.51, 0.25, 0])).toBe(0);
    expect(burns.heat(new Vector3(0.5, 0.25, 2), 0.001, 0, SURFACE)).toBe(false);
  });

  it("are bounded in number", () => {
    const burns = new Burns();
    for (let i = 0; i < 400; i++) burns.heat(new Vector3(0.01 + 0.002 * i, 0.001, 2), 0.001, 0.35, SURFACE);
    expect(burns.all.length).toBe(256);
  });

  it("come from instruments that burn, are switched on, and touch or hold", () => {
    const state = (trigger: number, contact: boolean, grasps = false) => ({ trigger, contact, grasps }) as ToolState;
    const tools = ["hook", "probe", "cautery", "hook", "hook"].map((kind) => ({ kind }) as ToolInfo);
    const header = { tools: [state(1, true), state(1, true), state(1, false, true), state(0, true), state(1, false)] } as unknown as SnapshotHeader;
    expect(hotTools(header, { tools })).toEqual([0, 2]);
  });
});

it("suction tubes suck while their trigger is pressed, and rinse ahead of them while their lever is", () => {
  const state = (trigger: number, jaw: number) =>
    ({ trigger, jaw, tip_m: [0, 0.5, 0], shaft: [0, 0, 1], shownFurtherOut_m: [0.25, 0, 0] }) as unknown as ToolState;
  const tools = ["suction", "suction", "grasper", "suction"].map((kind) => ({ kind }) as ToolInfo);
  const header = { tools: [state(1, 1), state(0, 0), state(1, 0), state(0, 1)] } as unknown as SnapshotHeader;
  const { sucked_m, rinsed_m } = washingOf(header, { tools });
  expect(sucked_m.map((at) => at.toArray())).toEqual([[0.25, 0.5, 0]]);
  expect(rinsed_m.map((at) => at.toArray())).toEqual([[0.25, 0.5, -0.006]]);
});

describe("looks", () => {
  const body = (name: string, more: Partial<BodyInfo> = {}): BodyInfo => ({ name, color: null, is_rigid: false, n_tetrahedra: 1, ...more });

  it("follow the names of bodies, and of one organ its tissue", () => {
    const [liver, bladder, fat] = looksOf([body("Liver"), body("gall bladder"), body("omentum")], "liver (E 4 kPa)");
    expect(liver).toBe(lookOf("liver"));
    // The gall bladder is greener than red, fat has lobules.
    expect(bladder.light[1]).toBeGreaterThan(bladder.light[0]);
    expect(fat.lobules).toBe(1);
    expect(looksOf([], "kidney (E 9 kPa)")).toEqual([lookOf("kidney")]);
    expect(lookOf("kidney")).not.toBe(lookOf("liver"));
  });

  it("show the colour that a body has of its own, and bone for rigid ones", () => {
    const [own, bone] = looksOf([body("liver", { color: "#00ff00" }), body("plate", { is_rigid: true })], "");
    expect(own.light[1]).toBeGreaterThan(1);
    expect([own.light[0], own.light[2]]).toEqual([0, 0]);
    expect(bone.dark[0]).toBeGreaterThan(0.5);
  });
});

describe("scenery", () => {
  const hello = (gravity_m_per_s2: [number, number, number]) =>
    ({ scene: { gravity_m_per_s2 }, bounds: { min_m: [-0.1, -0.2, -0.3], max_m: [0.4, 0.5, 0.6] } }) as unknown as Hello;

  it("lies below the scene along gravity, at the back without", () => {
    expect(downOf(hello([0, 0, 0])).toArray()).toEqual([0, 1, 0]);
    expect(bedDepth_m(hello([0, 0, 0]), downOf(hello([0, 0, 0])))).toBeCloseTo(0.506, 9);
    const down = downOf(hello([0, 0, -9.81]));
    expect(bedDepth_m(hello([0, 0, -9.81]), down)).toBeCloseTo(0.306, 9);
  });
});

it("detail follows what draws, unless it was chosen", () => {
  expect([isFull("auto", true), isFull("auto", false), isFull("full", true), isFull("low", false)]).toEqual([false, true, true, false]);
  expect([nextDetail("auto"), nextDetail("low"), nextDetail("full")]).toEqual(["low", "full", "auto"]);
});
