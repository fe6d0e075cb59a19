import { Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { ClassMarks, dotsOf } from "../src/class_marks";
import { decodeClass, decodeMarks } from "../src/classroom";
import { atRest } from "../src/on_surface";
import { decodeText, ProtocolError, type Topology } from "../src/protocol";

/** A square of two triangles in the plane z = 0. */
const TOPOLOGY: Topology = {
  kind: "topology",
  version: 1,
  organ: 0,
  nodeIds: Uint32Array.of(10, 11, 12, 13),
  rest_m: Float32Array.of(0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0),
  triangles: Uint32Array.of(0, 1, 2, 0, 2, 3),
  isCut: Uint8Array.of(0, 0),
  bodyOf: new Uint8Array(4),
};

const PERSON = { number: 3, name: "Ada", is_teacher: true, points_at_m: null };

/** Where the first dot is. */
function firstDot(marks: ClassMarks): number[] {
  const [dots] = marks.group.children as unknown as { instanceMatrix: { array: ArrayLike<number> } }[];
  return Array.from(dots.instanceMatrix.array).slice(12, 15).map((x) => Math.round(1e5 * x) / 1e5);
}

describe("what the server says of a class", () => {
  it("is read", () => {
    const news = decodeText(JSON.stringify({ type: "class", you: 3, controls: null, people: [PERSON, { ...PERSON, number: 4, points_at_m: [1, 2, 3] }] }));
    expect(news).toMatchObject({ you: 3, controls: null, people: [{ isTeacher: true, pointsAt_m: null }, { pointsAt_m: [1, 2, 3] }] });
    expect(decodeMarks({ marks: [{ by: 3, points_m: [[0, 0, 1], [0, 1, 0]] }] }).marks).toEqual([[[0, 0, 1], [0, 1, 0]]]);
  });

  it.each([
    [{ you: 3, controls: null }],
    [{ you: 3, controls: "me", people: [] }],
    [{ you: 3, controls: null, people: [{ ...PERSON, points_at_m: [1, 2] }] }],
    [{ you: 3, controls: null, people: [{ ...PERSON, name: 7 }] }],
  ])("is refused where it is broken: %j", (fields) => {
    expect(() => decodeClass(fields)).toThrow(ProtocolError);
  });

  it("has no strokes of nothing", () => {
    for (const points_m of [[], "x", [[1, 2]], [[1, 2, null]]]) expect(() => decodeMarks({ marks: [{ points_m }] })).toThrow(ProtocolError);
  });
});

describe("what is drawn on the tissue", () => {
  it("goes with it, also where the surface got another numbering", () => {
    const marks = new ClassMarks();
    marks.setTopology(TOPOLOGY);
    marks.showMarks([[[0.75, 0.25, 0]]]);
    expect(marks.shown).toEqual({ dots: 1, pointers: 0 });
    expect(firstDot(marks)).toEqual([0.75, 0.25, 0]);
    marks.follow(TOPOLOGY.rest_m.map((x, i) => (i % 3 === 2 ? 0.5 : 2 * x)));
    expect(firstDot(marks)).toEqual([1.5, 0.5, 0.5]);
    // The same nodes, the other way round, elsewhere: it stays with its nodes.
    const turned: Topology = { ...TOPOLOGY, version: 2, nodeIds: Uint32Array.of(13, 12, 11, 10), rest_m: Float32Array.of(0, 1, 9, 1, 1, 9, 1, 0, 9, 0, 0, 9), triangles: Uint32Array.of(3, 2, 1, 3, 1, 0) };
    marks.setTopology(turned);
    expect(firstDot(marks)).toEqual([0.75, 0.25, 9]);
    marks.showMarks([]);
    expect(marks.shown.dots).toBe(0);
  });

  it("is a dot where it is a place, and many where it is a stroke", () => {
    expect(dotsOf([[0, 0, 0]])).toHaveLength(1);
    expect(dotsOf([[0, 0, 0], [0, 0, 0]])).toHaveLength(1);
    expect(dotsOf([[0, 0, 0], [0.015, 0, 0]])).toHaveLength(11);
    expect(dotsOf([[0, 0, 0], [1, 0, 0]])).toHaveLength(61);
  });

  it("is told as it lies at rest", () => {
    const moved = TOPOLOGY.rest_m.map((x, i) => (i % 3 === 0 ? x + 5 : x));
    const rest = atRest(new Vector3(5.5, 0.25, 0), [0, 1, 2], moved, TOPOLOGY.rest_m);
    expect(rest.toArray().map((x) => Math.round(1e6 * x) / 1e6)).toEqual([0.5, 0.25, 0]);
  });

  it("shows where others point", () => {
    const marks = new ClassMarks();
    marks.setTopology(TOPOLOGY);
    expect(marks.showPointers([[0.5, 0.5, 0]])).toBe(true);
    expect(marks.showPointers([[0.5, 0.5, 0]])).toBe(false);
    expect(marks.shown.pointers).toBe(1);
    expect(marks.showPointers([])).toBe(true);
    expect(marks.shown.pointers).toBe(0);
  });
});
