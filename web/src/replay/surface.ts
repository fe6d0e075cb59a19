/** The displayed surface in a recording (docs/replay.md): each as what it keeps of one before, in order, and what is new. */
import { fail } from "../fields";
import type { Topology } from "../protocol";
import type { Taker } from "../bytes";

export interface Surface {
  readonly version: number;
  readonly nodeIds: Uint32Array;
  /** In whole steps, xyz of each vertex. */
  readonly rest: Int32Array;
  readonly bodyOf: Uint8Array;
  readonly triangles: Uint32Array;
  readonly isCut: Uint8Array;
}

export const NO_SURFACE: Surface = {
  version: 0,
  nodeIds: new Uint32Array(),
  rest: new Int32Array(),
  bodyOf: new Uint8Array(),
  triangles: new Uint32Array(),
  isCut: new Uint8Array(),
};

/** Runs through a list; `take` gets the place of each in the list of `nBefore`, or null and takes a new one. */
function takeList(from: Taker, nBefore: number, take: (kept: number | null) => void): void {
  let left = from.number();
  let next = 0;
  while (left > 0) {
    const run = from.number();
    const n = run >>> 1;
    if (n === 0 || n > left) fail("the recording is broken: a run is longer than its list");
    left -= n;
    if ((run & 1) === 1) {
      for (let i = 0; i < n; i++) take(null);
      continue;
    }
    const first = next + from.number();
    next = first + n;
    if (next > nBefore) fail("the recording is broken: a run is kept of what is not there");
    for (let i = first; i < next; i++) take(i);
  }
}

const vertexOfNode = ({ nodeIds }: Surface): Map<number, number> => new Map(Array.from(nodeIds, (node, i) => [node, i]));

/** The surface that follows `before`. @throws ProtocolError */
export function takeSurface(before: Surface, from: Taker): Surface {
  const version = from.number();
  const [nodeIds, rest, bodyOf]: [number[], number[], number[]] = [[], [], []];
  const last = [0, 0, 0, 0];
  takeList(from, before.nodeIds.length, (kept) => {
    if (kept !== null) {
      nodeIds.push(before.nodeIds[kept]);
      rest.push(before.rest[3 * kept], before.rest[3 * kept + 1], before.rest[3 * kept + 2]);
      bodyOf.push(before.bodyOf[kept]);
      return;
    }
    for (let k = 0; k < 4; k++) last[k] = (last[k] + from.signed()) | 0;
    nodeIds.push(last[0] >>> 0);
    rest.push(last[1], last[2], last[3]);
    bodyOf.push(from.byte());
  });
  const nVertices = nodeIds.length;
  const here = new Map(nodeIds.map((node, i) => [node, i]));
  const numbers = Array.from(before.nodeIds, (node) => here.get(node) ?? nVertices);
  const [triangles, isCut]: [number[], number[]] = [[], []];
  let first = 0;
  takeList(from, before.isCut.length, (kept) => {
    let corners: number[];
    if (kept !== null) {
      corners = [0, 1, 2].map((k) => numbers[before.triangles[3 * kept + k]]);
      isCut.push(before.isCut[kept]);
    } else {
      isCut.push(from.byte() === 0 ? 0 : 1);
      first = (first + from.signed()) >>> 0;
      corners = [first, (first + from.signed()) >>> 0, (first + from.signed()) >>> 0];
    }
    if (corners.some((vertex) => vertex >= nVertices)) fail("the recording is broken: a triangle has a vertex that is not there");
    triangles.push(...corners);
  });
  return {
    version,
    nodeIds: Uint32Array.from(nodeIds),
    rest: Int32Array.from(rest),
    bodyOf: Uint8Array.from(bodyOf),
    triangles: Uint32Array.from(triangles),
    isCut: Uint8Array.from(isCut),
  };
}

/** Where each vertex is looked for: where its node was before, else where it is at rest. */
export function expectedPlaces(surface: Surface, before: Surface, places: Int32Array): Int32Array {
  const there = vertexOfNode(before);
  const expected = surface.rest.slice();
  surface.nodeIds.forEach((node, i) => {
    const then = there.get(node);
    if (then !== undefined) expected.set(places.subarray(3 * then, 3 * then + 3), 3 * i);
  });
  return expected;
}

/** As the live page is told of it. */
export function topologyOf(surface: Surface, step_m: number): Topology {
  const { version, nodeIds, rest, triangles, isCut, bodyOf } = surface;
  return { kind: "topology", version, organ: 0, nodeIds, rest_m: Float32Array.from(rest, (x) => x * step_m), triangles, isCut, bodyOf };
}
