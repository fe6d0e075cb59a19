/** Between two frames of a recording: places, instruments and their forces on straight lines, so that slow motion moves smoothly. */
import type { Snapshot, SnapshotHeader, ToolState, Vec3 } from "../protocol";

/** An instrument that goes further from one frame to the next was put elsewhere [m]. */
const PUT_ELSEWHERE_M = 0.05;

const mixed = (a: Vec3, b: Vec3, share: number): Vec3 => [0, 1, 2].map((k) => a[k] + share * (b[k] - a[k])) as unknown as Vec3;
const distance = (a: Vec3, b: Vec3): number => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

function toolBetween(a: ToolState, b: ToolState, share: number): ToolState {
  if (distance(a.tip_m, b.tip_m) > PUT_ELSEWHERE_M) return a;
  const number = (x: number, y: number): number => x + share * (y - x);
  return {
    ...a,
    tip_m: mixed(a.tip_m, b.tip_m, share),
    shaft: mixed(a.shaft, b.shaft, share),
    roll_rad: number(a.roll_rad, b.roll_rad),
    jaw: number(a.jaw, b.jaw),
    forceOnTool_n: mixed(a.forceOnTool_n, b.forceOnTool_n, share),
    contactPoint_m: a.contact && b.contact ? mixed(a.contactPoint_m, b.contactPoint_m, share) : a.contactPoint_m,
    shownFurtherOut_m: mixed(a.shownFurtherOut_m, b.shownFurtherOut_m, share),
  };
}

function headerBetween(a: SnapshotHeader, b: SnapshotHeader, share: number): SnapshotHeader {
  return { ...a, tools: a.tools.map((tool, i) => (b.tools[i] === undefined ? tool : toolBetween(tool, b.tools[i], share))) };
}

/** What is drawn at a share of the way from `a` to `b`; `a` where another surface is shown at `b`. Blood and threads are those of `a`. */
export function between(a: Snapshot, b: Snapshot, share: number): Snapshot {
  if (share <= 0 || a.header.version !== b.header.version || a.positions_m.length !== b.positions_m.length) return a;
  const [from, to] = [a.positions_m, b.positions_m];
  const positions_m = new Float32Array(from.length);
  for (let i = 0; i < from.length; i++) positions_m[i] = from[i] + share * (to[i] - from[i]);
  return { kind: "snapshot", header: headerBetween(a.header, b.header, share), positions_m };
}
