/** What an instrument of each kind is made of, in the tool's frame: the tip is at the origin, the handle at the end of +z. */
import { BoxGeometry, CircleGeometry, CylinderGeometry, RingGeometry, SphereGeometry, TorusGeometry, type BufferGeometry } from "three";
import type { ToolInfo } from "../protocol";
import { hinge, jawParts } from "./jaws";
import { EDGE_ON, joined, plate, revolved, wire } from "./shapes";
import type { Look } from "./surfaces";

/** A solid and what it looks like. */
export interface Part {
  readonly look: Look;
  readonly geometry: BufferGeometry;
}

export interface InstrumentParts {
  readonly fixed: readonly Part[];
  /** Of the two jaws in the frames of their hinges, which lie on the axis at `hinge_m`; none without jaws. */
  readonly jaws: ReadonlyArray<readonly Part[]>;
  readonly hinge_m: number;
}

/** A blade's length where nothing tells it: the default of scenes [m]. */
const BLADE_M = 0.02;
/** How far a jet of water is shown [m]: as far as it rinses. */
export const JET_M = 0.015;
/** What the current of a hook may reach stands so far out of the insulation [m]. */
const BARE_HOOK_M = 0.012;

const tube = (radius_m: number, from_m: number, to_m: number): BufferGeometry =>
  new CylinderGeometry(radius_m, radius_m, to_m - from_m, 32, 1, true).rotateX(Math.PI / 2).translate(0, 0, (from_m + to_m) / 2);

/** A working end, and where the shaft begins behind it. */
interface End {
  readonly parts: readonly Part[];
  readonly shaftFrom_m: number;
  readonly shaft: Look;
}

/** A ball: what the simulator touches tissue with. */
function ballEnd({ tip_radius_m: tip }: ToolInfo, shaft_m: number): End {
  const shaftFrom_m = Math.sqrt(Math.max(tip * tip - shaft_m * shaft_m, 0));
  return { parts: [{ look: "polished", geometry: new SphereGeometry(tip, 40, 28) }], shaftFrom_m, shaft: "marked_steel" };
}

/** An L of wire out of a ceramic collar; its toe is the tip. */
function hookEnd({ tip_radius_m: tip }: ToolInfo, shaft_m: number): End {
  const wire_m = Math.min(tip, 0.9e-3);
  const heel_m = -Math.max(3 * wire_m, 2.4e-3);
  const hook = wire([[0, 0, BARE_HOOK_M], [0.35 * heel_m, 0, 0.72 * BARE_HOOK_M], [heel_m, 0, 0.35 * BARE_HOOK_M], [heel_m, 0, 0.6 * wire_m], [0.5 * heel_m, 0, 0], [0, 0, 0]], 0.75 * wire_m);
  const collar = revolved([[wire_m, BARE_HOOK_M - 0.001], [0.7 * shaft_m, BARE_HOOK_M], [shaft_m, BARE_HOOK_M + 0.004], [shaft_m, BARE_HOOK_M + 0.006]]);
  const toe = new SphereGeometry(wire_m, 16, 12);
  return { parts: [{ look: "steel", geometry: joined([hook, toe]) }, { look: "ceramic", geometry: collar }], shaftFrom_m: BARE_HOOK_M + 0.006, shaft: "insulation" };
}

/** The edge lies on the axis, from the tip backwards; the blade's back beside it. */
function scalpelEnd(_: ToolInfo, shaft_m: number): End {
  const outline = [[0, 0], [-0.25, -0.1], [-0.55, -0.19], [-1, -0.2], [-1.15, -0.14], [-1.15, 0], [-1, 0]].map(([z, x]) => [z * BLADE_M, x * BLADE_M] as const);
  const thickness_m = 0.4e-3;
  const blade = plate({ outline, thickness_m, rounding_m: 0.05e-3 }, EDGE_ON).translate(0, thickness_m / 2, 0);
  const holder = new BoxGeometry(0.16 * BLADE_M, 2.2e-3, 0.5 * BLADE_M).translate(-0.08 * BLADE_M, 0, 1.3 * BLADE_M);
  const collar = revolved([[0.4 * shaft_m, 1.3 * BLADE_M], [shaft_m, 1.6 * BLADE_M]]);
  return { parts: [{ look: "polished", geometry: blade }, { look: "steel", geometry: joined([holder, collar]) }], shaftFrom_m: 1.6 * BLADE_M, shaft: "marked_steel" };
}

/** The window looks along the direction of view, and light comes out around the lens. */
function endoscopeEnd({ tip_radius_m: tip, optics }: ToolInfo): End {
  const slope = Math.min(Math.tan(optics?.view_angle_rad ?? 0), 2);
  const bevelled = (face: BufferGeometry): BufferGeometry => {
    const place = face.getAttribute("position");
    for (let i = 0; i < place.count; i++) place.setZ(i, -slope * place.getX(i));
    face.computeVertexNormals();
    return face;
  };
  const glass = bevelled(new CircleGeometry(0.5 * tip, 32).rotateY(Math.PI));
  const fibres = bevelled(new RingGeometry(0.56 * tip, 0.86 * tip, 40).rotateY(Math.PI));
  const rims = [bevelled(new RingGeometry(0.5 * tip, 0.56 * tip, 40).rotateY(Math.PI)), bevelled(new RingGeometry(0.86 * tip, tip, 40).rotateY(Math.PI))];
  const sleeve = tube(tip, 0, 4 * tip);
  const place = sleeve.getAttribute("position");
  for (let i = 0; i < place.count; i++) if (place.getZ(i) < tip) place.setZ(i, -slope * place.getX(i));
  return {
    parts: [{ look: "glass", geometry: glass }, { look: "light", geometry: fibres }, { look: "steel", geometry: joined([...rims, sleeve]) }],
    shaftFrom_m: 4 * tip,
    shaft: "marked_steel",
  };
}

/** A straight tube with a rounded rim; holes in rows around it let it suck where its end lies on something. */
function suctionEnd({ tip_radius_m: tip }: ToolInfo): End {
  const rim = revolved([[0.62 * tip, 0.3 * tip], [0.66 * tip, -0.75 * tip], [0.85 * tip, -0.95 * tip], [tip, -0.7 * tip], [tip, 0]]);
  const bore = new CircleGeometry(0.64 * tip, 24).rotateY(Math.PI).translate(0, 0, -0.3 * tip);
  const hole = (turn: number, z_m: number): BufferGeometry =>
    new CylinderGeometry(0.24 * tip, 0.24 * tip, 0.1 * tip, 16).scale(1.5, 1, 1).rotateZ(-Math.PI / 2).rotateX(Math.PI / 2).translate(0.965 * tip, 0, z_m).rotateZ(turn);
  const holes = [1, 2.6, 4.2].flatMap((z, row) => [0, 1, 2, 3].map((i) => hole(((2 * i + (row % 2)) * Math.PI) / 4, z * tip)));
  return { parts: [{ look: "polished", geometry: joined([rim, tube(tip, 0, 6 * tip)]) }, { look: "hole", geometry: joined([bore, ...holes]) }], shaftFrom_m: 6 * tip, shaft: "marked_steel" };
}

function endOf(tool: ToolInfo, shaft_m: number): End {
  if (tool.optics !== null) return endoscopeEnd(tool);
  if (tool.jaws !== null) return { ...hinge(tool.jaws, tool.tip_radius_m, shaft_m), shaft: "insulation" };
  if (tool.kind === "hook") return hookEnd(tool, shaft_m);
  if (tool.kind === "scalpel") return scalpelEnd(tool, shaft_m);
  if (tool.kind === "suction") return suctionEnd(tool);
  return ballEnd(tool, shaft_m);
}

/** What is held: a grip, and for jaws two rings for thumb and fingers. */
function handle(length_m: number, shaft_m: number, hasRings: boolean): BufferGeometry {
  const thick = 1.9 * shaft_m;
  const from_m = length_m - Math.min(0.09, 0.4 * length_m);
  const grip = revolved([[shaft_m, from_m], [thick, from_m + 0.006], [thick, length_m - 0.004], [0.7 * thick, length_m], [0, length_m]]);
  if (!hasRings) return joined([grip]);
  const ring = (x: number, z: number): BufferGeometry => new TorusGeometry(0.013, 0.0026, 10, 24).rotateX(Math.PI / 2).translate(x, 0, z);
  const bar = (x: number, z: number): BufferGeometry => wire([[0, 0, length_m - 0.02], [0.5 * x, 0, 0.5 * (z + length_m - 0.02)], [0.8 * x, 0, z]], 0.003);
  return joined([grip, ring(0.045, length_m + 0.012), bar(0.045, length_m + 0.008), ring(0.045, length_m - 0.045), bar(0.045, length_m - 0.045)]);
}

export function instrumentParts(tool: ToolInfo): InstrumentParts {
  const { tip_radius_m: tip, jaws, kind } = tool;
  const shaft_m = Math.min(tool.shaft_radius_m, tip > 0 && jaws === null && kind !== "hook" ? Math.max(tip * 0.98, 1e-4) : tool.shaft_radius_m);
  const length_m = Math.max(tool.shaft_length_m, 4 * tip);
  const { parts, shaftFrom_m, shaft } = endOf(tool, shaft_m);
  const fixed: Part[] = [...parts, { look: shaft, geometry: tube(shaft_m, shaftFrom_m, Math.max(length_m, shaftFrom_m + tip)) }];
  // Its front is closed where no ball does it.
  if (jaws !== null) fixed.push({ look: "steel", geometry: revolved([[0, shaftFrom_m], [0.9 * shaft_m, shaftFrom_m], [1.02 * shaft_m, shaftFrom_m + 0.3 * shaft_m], [1.02 * shaft_m, shaftFrom_m + 0.004]]) });
  fixed.push({ look: "grip", geometry: handle(length_m, shaft_m, jaws !== null) });
  return { fixed, jaws: jaws === null ? [] : ([0, 1] as const).map((side) => jawParts(kind, jaws, tip, side)), hinge_m: jaws?.length_m ?? 0 };
}

/** What comes out of a suction tube that rinses: a jet that spreads, in the tool's frame. */
export function jetOf({ tip_radius_m: tip }: ToolInfo): BufferGeometry {
  return revolved([[0.5 * tip, -0.5 * tip], [0.55 * tip, -0.5 * JET_M], [1.1 * tip, -0.9 * JET_M], [1.6 * tip, -JET_M]]);
}

/** A cannula in the abdominal wall, along z through the origin: outside is at +z. */
export function trocarParts(shaft_m: number): Part[] {
  const [inner, inside_m, outside_m] = [shaft_m + 0.8e-3, 0.022, 0.05];
  const outer = inner + 0.6e-3;
  return [
    { look: "cannula", geometry: revolved([[inner, outside_m], [inner, -inside_m], [outer, -inside_m], [outer, outside_m]]) },
    { look: "grip", geometry: revolved([[outer, 0.028], [2.6 * outer, 0.032], [2.6 * outer, outside_m], [inner, outside_m + 0.004]]) },
  ];
}
