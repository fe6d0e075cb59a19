import { Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { nearestOnSurface } from "../src/on_surface";
import { pointsOf, TaskMarks } from "../src/task_marks";

/** A square of two triangles in the plane z = 0, and a third one that lies in a cut. */
const TOPOLOGY = {
  rest_m: new Float32Array([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0.5, 0.5, 0.1]),
  triangles: new Uint32Array([0, 1, 2, 0, 2, 3, 0, 1, 4]),
  isCut: new Uint8Array([0, 0, 1]),
};

describe("marks of a task", () => {
  it("are at the nearest place of the skin, and not in a cut", () => {
    const nearest = (x: number, y: number, z: number) => nearestOnSurface(new Vector3(x, y, z), TOPOLOGY.rest_m, TOPOLOGY.triangles, (t) => TOPOLOGY.isCut[t] === 1)!;
    const { vertices, weights } = nearest(0.5, 0.25, 0.09);
    expect(vertices).toEqual([0, 1, 2]);
    expect(weights.map((weight) => Math.round(100 * weight))).toEqual([50, 25, 25]);
    const beside = nearest(-1, 0.5, 0);
    expect(beside.vertices).toEqual([0, 2, 3]);
    expect(beside.weights[1]).toBe(0);
  });

  it("go with the tissue, and away with their stage", () => {
    const marks = new TaskMarks();
    const [dots] = marks.group.children as unknown as { count: number; instanceMatrix: { array: ArrayLike<number> } }[];
    marks.setTopology({ kind: "topology", version: 1, organ: 0, nodeIds: new Uint32Array(5), bodyOf: new Uint8Array(5), ...TOPOLOGY });
    expect(marks.show({ kind: "line", points_m: [[0, 0.5, 0], [1, 0.5, 0]] }, TOPOLOGY.rest_m)).toBe(true);
    expect(dots.count).toBe(41);
    marks.follow(TOPOLOGY.rest_m.map((x) => 2 * x));
    // The last one: the translation of its matrix.
    expect(Array.from(dots.instanceMatrix.array).slice(16 * 40 + 12, 16 * 40 + 15)).toEqual([2, 1, 0]);
    expect(marks.show({ kind: "line", points_m: [[0, 0.5, 0], [1, 0.5, 0]] }, TOPOLOGY.rest_m)).toBe(false);
    marks.show({ kind: "space", points_m: [[0, 0, 3]] }, null);
    expect(dots.count).toBe(1);
    marks.show(null, null);
    expect(dots.count).toBe(0);
  });
});

it("a line through points has its marks the same way apart, corners or not", () => {
  const square: [number, number, number][] = [[0, 0, 0], [0.01, 0, 0], [0.01, 0.03, 0], [0, 0.03, 0], [0, 0, 0]];
  const marks = pointsOf({ kind: "line", points_m: square });
  expect(marks).toHaveLength(41);
  expect(marks[0].toArray()).toEqual([0, 0, 0]);
  expect(marks[5].toArray()).toEqual([0.01, 0, 0]);
  expect(marks[20].distanceTo(new Vector3(0.01, 0.03, 0))).toBeLessThan(1e-12);
  expect(marks[40].length()).toBeLessThan(1e-12);
  const [from, to]: [number, number, number][] = [[0, 0, 0], [0.04, 0, 0]];
  const straight = pointsOf({ kind: "line", points_m: [from, to] });
  straight.forEach((mark, i) => expect(mark.x).toBeCloseTo(i * 1e-3, 12));
});
