import { Vector3 } from "three";
import { describe, expect, it } from "vitest";
import type { BleedingEnd } from "../src/blood";
import { BloodFlow, puddleRadius_m, type BloodySurface } from "../src/field/blood_flow";
import { placeIn } from "../src/on_surface";
import { Smoke } from "../src/field/smoke";

const DOWN = new Vector3(0, 0, -1);
const GROUND_M = -0.02;

/** A roof of two sides that meet in a valley at x = 0, 10 cm to either side, as a fine grid. */
function valley(n = 20): BloodySurface {
  const positions: number[] = [];
  const triangles: number[] = [];
  for (let i = 0; i <= n; i++) {
    for (let j = 0; j <= n; j++) {
      const [x, y] = [0.2 * (i / n - 0.5), 0.1 * (j / n - 0.5)];
      positions.push(x, y, 0.5 * Math.abs(x));
      if (i === n || j === n) continue;
      const a = i * (n + 1) + j;
      triangles.push(a, a + n + 1, a + 1, a + 1, a + n + 1, a + n + 2);
    }
  }
  return {
    positions_m: Float32Array.from(positions),
    topology: { triangles: Uint32Array.from(triangles), nodeIds: Uint32Array.from({ length: positions.length / 3 }, (_, i) => 5 * i) },
  };
}

const flowOn = () => new BloodFlow(DOWN, (from_m) => new Vector3(from_m.x, from_m.y, GROUND_M));
const bleeds = (x: number, ml_per_min: number): BleedingEnd[] => [{ position_m: [x, 0.001, 0.5 * Math.abs(x)], rate_m3_per_s: (ml_per_min * 1e-6) / 60 }];

describe("blood on a surface", () => {
  it("runs down into the valley, and lies there", () => {
    const [flow, surface] = [flowOn(), valley()];
    for (let i = 0; i < 30; i++) flow.advance(0.1, bleeds(0.05, 20), surface);
    expect(flow.isMoving).toBe(true);
    for (let i = 0; i < 50; i++) flow.advance(0.1, [], surface);
    expect(flow.isMoving).toBe(false);
    const [heavy] = [...flow.drops].sort((a, b) => b.volume_m3 - a.volume_m3);
    expect(Math.abs(placeIn(surface.positions_m, heavy.place, new Vector3()).x)).toBeLessThan(0.003);
    // A streak of stains leads there.
    const stains = flow.drops.map(({ place }) => placeIn(surface.positions_m, place, new Vector3()).x).filter((x) => x > 0.01 && x < 0.045);
    expect(stains.length).toBeGreaterThan(10);
  });

  it("neither comes from nor goes to nowhere: drops and puddles hold what came out", () => {
    const [flow, surface] = [flowOn(), valley()];
    for (let i = 0; i < 40; i++) flow.advance(0.05, bleeds(0.03, 90), surface);
    const held = [...flow.drops, ...flow.puddles].reduce((sum, { volume_m3 }) => sum + volume_m3, 0);
    const out = (2 * 90e-6) / 60;
    // Less what waits for the next drop.
    expect(held).toBeLessThanOrEqual(out);
    expect(held).toBeGreaterThan(0.8 * out);
    expect(flow.puddles.length).toBeGreaterThan(0);
    expect(flow.puddles[0].middle_m.z).toBe(GROUND_M);
  });

  it("is the same however its time is divided", () => {
    const surface = valley();
    const [once, often] = [flowOn(), flowOn()];
    for (let i = 0; i < 8; i++) once.advance(0.25, bleeds(0.04, 20), surface);
    for (let i = 0; i < 128; i++) often.advance(0.015625, bleeds(0.04, 20), surface);
    expect(often.drops.map(({ place, volume_m3 }) => [place.triangle, volume_m3])).toEqual(once.drops.map(({ place, volume_m3 }) => [place.triangle, volume_m3]));
  });

  it("is bounded, however long it bleeds", () => {
    const [flow, surface] = [flowOn(), valley(8)];
    const ends = [-0.08, -0.05, -0.02, 0.02, 0.05, 0.08].flatMap((x) => bleeds(x, 60));
    for (let i = 0; i < 200; i++) flow.advance(0.2, ends, surface);
    expect(flow.drops.length).toBeLessThanOrEqual(420);
    expect(flow.puddles.length).toBeLessThanOrEqual(8);
    expect(puddleRadius_m({ volume_m3: 1 })).toBeLessThan(0.1);
  });

  it("stays on triangles that a new surface still has, and goes with those that are cut away", () => {
    const [flow, surface] = [flowOn(), valley()];
    for (let i = 0; i < 20; i++) flow.advance(0.1, bleeds(0.05, 20), surface);
    const before = flow.drops.length;
    const { triangles, nodeIds } = surface.topology;
    // Without the triangles beyond x = 0.03.
    const kept = Array.from({ length: triangles.length / 3 }, (_, t) => [...triangles.subarray(3 * t, 3 * t + 3)]).filter((corners) => corners.every((vertex) => surface.positions_m[3 * vertex] < 0.03));
    flow.advance(0, [], { ...surface, topology: { triangles: Uint32Array.from(kept.flat()), nodeIds } });
    expect(flow.drops.length).toBeLessThan(before);
    expect(flow.drops.length).toBeGreaterThan(0);
    for (const { place } of flow.drops) expect([...place.vertices]).toEqual(kept[place.triangle]);
  });
});

describe("suction and rinsing", () => {
  const total = (flow: BloodFlow): number => [...flow.drops, ...flow.puddles].reduce((sum, { volume_m3 }) => sum + volume_m3, 0);
  /** Blood that has run into the valley below x = 0.03. */
  function bloody(): { flow: BloodFlow; surface: BloodySurface } {
    const [flow, surface] = [flowOn(), valley()];
    for (let i = 0; i < 30; i++) flow.advance(0.1, bleeds(0.03, 20), surface);
    for (let i = 0; i < 40; i++) flow.advance(0.1, [], surface);
    expect(flow.isMoving).toBe(false);
    return { flow, surface };
  }
  const at = (drop: { place: { vertices: readonly [number, number, number]; weights: readonly [number, number, number] } }, { positions_m }: BloodySurface) => placeIn(positions_m, drop.place, new Vector3());

  it("takes away what is near to the tip, and nothing else", () => {
    const { flow, surface } = bloody();
    const tip = new Vector3(0.001, 0.001, 0.002);
    const [near, far] = [true, false].map((isNear) => flow.drops.filter((drop) => at(drop, surface).distanceTo(tip) < 8e-3 === isNear));
    expect(Math.min(near.length, far.length)).toBeGreaterThan(3);
    flow.advance(0.1, [], surface, { sucked_m: [tip], rinsed_m: [] });
    expect(flow.drops).toEqual(far);
    // It is seen that it goes, and then that nothing moves.
    expect(flow.isMoving).toBe(true);
    flow.advance(0.1, [], surface, { sucked_m: [tip], rinsed_m: [] });
    expect(flow.isMoving).toBe(false);
  });

  it("takes puddles in, no faster than it can, and not from far", () => {
    const flow = flowOn();
    flow.puddles.push({ middle_m: new Vector3(0, 0, GROUND_M), volume_m3: 20e-6 });
    const suck = (x_m: number, z_m: number, time_s: number) => flow.advance(time_s, [], valley(2), { sucked_m: [new Vector3(x_m, 0, z_m)], rinsed_m: [] });
    suck(0.2, GROUND_M, 0.5);
    suck(0, GROUND_M + 0.02, 0.5);
    expect(total(flow)).toBe(20e-6);
    suck(0.03, GROUND_M, 0.4);
    expect(total(flow)).toBeCloseTo(10e-6, 9);
    suck(0, GROUND_M, 2);
    expect(flow.puddles).toEqual([]);
  });

  it("keeps a bleeding end dry, as long as it sucks", () => {
    const [flow, surface] = [flowOn(), valley()];
    const washing = { sucked_m: [new Vector3(0.03, 0.001, 0.016)], rinsed_m: [] };
    for (let i = 0; i < 40; i++) flow.advance(0.1, bleeds(0.03, 60), surface, washing);
    expect(total(flow)).toBe(0);
    for (let i = 0; i < 10; i++) flow.advance(0.1, bleeds(0.03, 60), surface);
    expect(total(flow)).toBeGreaterThan(0);
  });

  it("rinses blood off the tissue, down to the puddles: none of it is lost", () => {
    const { flow, surface } = bloody();
    const before = total(flow);
    const place = new Vector3(0.001, 0.001, 0.002);
    const near = () => flow.drops.filter((drop) => at(drop, surface).distanceTo(place) < 10e-3).length;
    expect(near()).toBeGreaterThan(3);
    for (let i = 0; i < 10; i++) flow.advance(0.1, [], surface, { sucked_m: [], rinsed_m: [place] });
    expect(near()).toBe(0);
    expect(total(flow)).toBeCloseTo(before, 15);
    expect(flow.puddles.length).toBe(1);
  });
});

describe("smoke", () => {
  it("rises from what burns, fades in the simulation's time, and is bounded", () => {
    const smoke = new Smoke();
    for (let i = 0; i < 400; i++) smoke.advance(0.05, [new Vector3(), new Vector3(0.01, 0, 0)], DOWN);
    expect(smoke.count).toBeGreaterThan(20);
    expect(smoke.count).toBeLessThanOrEqual(72);
    const { array } = smoke.points.geometry.getAttribute("position");
    expect(Math.max(...Array.from({ length: smoke.count }, (_, i) => array[3 * i + 2]))).toBeGreaterThan(0.02);
    smoke.advance(3.3, [], DOWN);
    expect(smoke.count).toBe(0);
    expect(smoke.points.visible).toBe(false);
  });

  it("is sucked away where suction is near", () => {
    const [free, near, far] = [new Smoke(), new Smoke(), new Smoke()];
    for (let i = 0; i < 20; i++) {
      free.advance(0.05, [new Vector3()], DOWN);
      near.advance(0.05, [new Vector3()], DOWN, [new Vector3(0, 0.005, 0.01)]);
      far.advance(0.05, [new Vector3()], DOWN, [new Vector3(0, 0.1, 0)]);
    }
    expect(far.count).toBe(free.count);
    expect(near.count).toBeLessThan(0.5 * free.count);
  });
});
