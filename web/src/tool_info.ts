/** The instruments of a scene, as the hello describes them. */
import { fail, fieldsOf, numberAt, stringAt, vec3At, type Fields, type Vec3 } from "./fields";

/** Instruments of a scene at most. */
export const MOST_TOOLS = 5;

export interface JawsInfo {
  readonly length_m: number;
  readonly width_m: number;
  readonly greatest_opening_rad: number;
}

/** The lens of an endoscope. */
export interface OpticsInfo {
  /** Between the way out of the tip and the direction of view. */
  readonly view_angle_rad: number;
  /** Full angle of the cone that is seen. */
  readonly field_of_view_rad: number;
}

export interface ToolInfo {
  readonly name: string;
  /** probe, grasper, scissors, scalpel, hook, cautery, clipper, endoscope, suction or loop. */
  readonly kind: string;
  readonly tip_radius_m: number;
  readonly shaft_radius_m: number;
  readonly shaft_length_m: number;
  /** Two jaws; null for a tool without. */
  readonly jaws: JawsInfo | null;
  /** The lens; null for a tool without. */
  readonly optics: OpticsInfo | null;
  /** Where it goes through the abdominal wall; null for a tool that is free. */
  readonly trocar_m: Vec3 | null;
  readonly home_tip_m: Vec3;
  readonly home_shaft: Vec3;
  /** How far the jaws are open at home: 0 closed, 1 wide open. */
  readonly home_jaw: number;
}

export function toolsAt(fields: Fields): ToolInfo[] {
  const value = fields.tools;
  if (!Array.isArray(value) || value.length < 1 || value.length > MOST_TOOLS) {
    fail(`hello.tools must be an array of 1 to ${MOST_TOOLS} instruments`);
  }
  return value.map((item: unknown, i) => {
    const place = `hello.tools[${i}]`;
    const tool = fieldsOf(item, place);
    const jaws = tool.jaws === null ? null : fieldsOf(tool.jaws, `${place}.jaws`);
    const optics = tool.optics == null ? null : fieldsOf(tool.optics, `${place}.optics`);
    return {
      name: stringAt(tool, "name", place),
      kind: stringAt(tool, "kind", place),
      tip_radius_m: numberAt(tool, "tip_radius_m", place, 0),
      shaft_radius_m: numberAt(tool, "shaft_radius_m", place, 0),
      shaft_length_m: numberAt(tool, "shaft_length_m", place, 0),
      jaws: jaws && {
        length_m: numberAt(jaws, "length_m", `${place}.jaws`, 0),
        width_m: numberAt(jaws, "width_m", `${place}.jaws`, 0),
        greatest_opening_rad: numberAt(jaws, "greatest_opening_rad", `${place}.jaws`, 0),
      },
      optics: optics && {
        view_angle_rad: numberAt(optics, "view_angle_rad", `${place}.optics`, 0),
        field_of_view_rad: numberAt(optics, "field_of_view_rad", `${place}.optics`, 0),
      },
      trocar_m: tool.trocar_m == null ? null : vec3At(tool, "trocar_m", place),
      home_tip_m: vec3At(tool, "home_tip_m", place),
      home_shaft: vec3At(tool, "home_shaft", place),
      home_jaw: numberAt(tool, "home_jaw", place, 0),
    };
  });
}
