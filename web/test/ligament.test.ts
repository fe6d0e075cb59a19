import { Box3, ShaderMaterial, SphereGeometry, Vector3, type Mesh } from "three";
import { describe, expect, it } from "vitest";
import type { Hello, ToolInfo, Vec3 } from "../src/protocol";
import { falciform } from "../src/theatre/ligament";
import { Scenery, type SceneSurface } from "../src/theatre/scenery";
import { abdomenOf } from "../src/theatre/walls";

/** An egg of 20 x 12 x 14 cm. */
function liver(): SceneSurface {
  const geometry = new SphereGeometry(1, 48, 32).scale(0.1, 0.06, 0.07);
  const rest_m = Float32Array.from(geometry.getAttribute("position").array);
  return { rest_m, triangles: Uint32Array.from(geometry.index!.array), bodyOf: new Uint8Array(rest_m.length / 3) };
}

const tool = (kind: string, home_tip_m: Vec3): ToolInfo => ({
  name: kind,
  kind,
  tip_radius_m: 0.005,
  shaft_radius_m: 0.005,
  shaft_length_m: 0.3,
  jaws: null,
  optics: kind === "endoscope" ? { view_angle_rad: 0, field_of_view_rad: 1.2 } : null,
  trocar_m: null,
  home_tip_m,
  home_shaft: [0, -0.6, -0.8],
  home_jaw: 0,
});

const hello = (tools: ToolInfo[], material = "liver", half_m: Vec3 = [0.1, 0.06, 0.07]) =>
  ({ scene: { gravity_m_per_s2: [0, 9.81, 0], material }, bodies: [], tools, bounds: { min_m: half_m.map((x) => -x), max_m: half_m } }) as unknown as Hello;

const FROM_BELOW = [tool("endoscope", [-0.02, -0.09, -0.1]), tool("probe", [-0.05, -0.08, -0.03])];

describe("the falciform ligament", () => {
  it("goes from the front of the liver to the wall, in one thin sheet", () => {
    const abdomen = abdomenOf(hello(FROM_BELOW));
    const { rows, columns, at } = falciform(liver(), abdomen)!;
    expect(rows).toBeGreaterThan(10);
    const share = (p: Vector3, half: Vector3, middle = new Vector3()): number => p.clone().sub(middle).divide(half).length();
    for (let i = 0; i < rows; i++) {
      // Rooted in both, and free between them.
      expect(share(at(i, 0), new Vector3(0.1, 0.06, 0.07))).toBeLessThan(1);
      expect(share(at(i, columns / 2 - 1), abdomen.half_m, abdomen.middle_m)).toBeGreaterThan(1);
      for (let j = 0; j < columns / 2; j++) {
        const [one, other] = [at(i, j), at(i, columns - 1 - j)];
        expect(one.distanceTo(other)).toBeLessThan(0.006);
        expect(other.x).toBeGreaterThanOrEqual(one.x);
      }
    }
    // The upper half of the liver alone, to the left of its middle.
    const box = new Box3().setFromPoints(Array.from({ length: columns }, (_, j) => at(rows - 1, j)));
    expect(box.min.z).toBeGreaterThan(0.04);
    expect(box.min.x).toBeGreaterThan(0.01);
  });

  it("is none where the wall is at the liver", () => {
    expect(falciform(liver(), { middle_m: new Vector3(), half_m: new Vector3(0.101, 0.061, 0.071) })).toBeNull();
  });

  const piecesOf = (scene: Hello): Mesh[] => {
    const scenery = new Scenery(new ShaderMaterial());
    scenery.begin(scene);
    const before = scenery.group.children.length;
    scenery.show(true, null);
    expect(scenery.group.children.length).toBe(before);
    scenery.show(true, liver());
    scenery.show(true, liver());
    return scenery.group.children.slice(before) as Mesh[];
  };

  it("is part of the scenery of livers, once, and of small scenes with a made-up one", () => {
    expect(piecesOf(hello(FROM_BELOW))).toHaveLength(1);
    expect(piecesOf(hello(FROM_BELOW, "kidney"))).toHaveLength(0);
    expect(piecesOf(hello([tool("endoscope", [0, -0.06, -0.05])], "kidney", [0.03, 0.004, 0.004]))).toHaveLength(1);
  });

  it("is left out where it would lie before what an endoscope looks at, or an instrument is", () => {
    expect(piecesOf(hello([tool("endoscope", [0.12, -0.12, 0.03])]))).toHaveLength(0);
    expect(piecesOf(hello([...FROM_BELOW, tool("grasper", [0.024, -0.09, 0.03])]))).toHaveLength(0);
  });
});
