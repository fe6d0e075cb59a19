import { Mesh, PerspectiveCamera, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { advanced, ADVANCE_M, eyeOf, pivoted } from "../src/theatre/endoscope";
import { bent, rayThrough, seenAt, straightened } from "../src/theatre/lens";
import { nextStereo, throughLens } from "../src/theatre/stereo";
import { distortionOf } from "../src/theatre/view";
import { distanceToWalls_m } from "../src/theatre/walls";

const SHAFT = [0.3, -0.8, -0.5].map((x) => x / Math.hypot(0.3, 0.8, 0.5)) as [number, number, number];
const FIELD = (70 * Math.PI) / 180;

/** View angle, roll [rad], direction of view and up, as `tool::endoscope::tests::the_page_has_the_same_geometry` has them. */
const BY_RUST: ReadonlyArray<readonly [number, number, readonly number[], readonly number[]]> = [
  [0, 0, [-0.3030457633656632, 0.8081220356417687, 0.5050762722761053], [0.08465204309921971, -0.5050762722761053, 0.8589132615013004]],
  [0.5, 0, [-0.7210226051745916, 0.5639059280352615, 0.4026617776173143], [0.08465204309921971, -0.5050762722761053, 0.8589132615013004]],
  [0.5, 0.9, [-0.5806176033364094, 0.8085612541461186, 0.09545625694285231], [-0.0920949438631945, -0.18171342720432218, 0.9790294948000772]],
  [0.5, -2.4, [0.09703494951642755, 0.652767154132179, 0.7513183486768578], [0.1201835658523856, -0.7570417711566373, 0.6422177724285016]],
  [1.2, 3.6, [0.7184653262279049, 0.3378022812128164, 0.6080272969329974], [-0.04111395459587447, -0.8519985837804325, 0.5219272516104382]],
];

const eye = (viewAngle_rad: number, roll_rad: number) =>
  eyeOf({ tip_m: [0.01, -0.02, 0.03], shaft: SHAFT, roll_rad }, { view_angle_rad: viewAngle_rad, field_of_view_rad: FIELD });

describe("the endoscope's eye", () => {
  it.each(BY_RUST)("view angle %f, roll %f: as the library has it", (viewAngle, roll, forward, up) => {
    const found = eye(viewAngle, roll);
    expect(found.position_m.toArray()).toEqual([0.01, -0.02, 0.03]);
    found.forward.toArray().forEach((x, i) => expect(x).toBeCloseTo(forward[i], 12));
    found.up.toArray().forEach((x, i) => expect(x).toBeCloseTo(up[i], 12));
    expect(found.right.dot(found.forward)).toBeCloseTo(0, 12);
  });

  it("dragging leads it about the trocar, so that the picture follows the pointer", () => {
    const axes = { right: new Vector3(1, 0, 0), up: new Vector3(0, 0, 1), forward: new Vector3(0, 1, 0) };
    const pivot = new Vector3(0, -0.1, 0);
    const tip = new Vector3(0, 0, 0);
    // To the right and down: the tip goes left and up, at the same depth.
    const to = pivoted(tip, pivot, axes, 0.1, 0.1);
    expect(to.x).toBeLessThan(-0.009);
    expect(to.z).toBeGreaterThan(0.009);
    expect(to.distanceTo(pivot)).toBeCloseTo(0.1, 12);
  });

  it("the wheel moves it along its shaft, never out of the trocar", () => {
    const pivot = new Vector3(0, 0, 0.1);
    expect(advanced(new Vector3(), pivot, 2).z).toBeCloseTo(-2 * ADVANCE_M, 12);
    expect(advanced(new Vector3(), pivot, -100).z).toBeCloseTo(0.1 - ADVANCE_M, 12);
    expect(advanced(pivot, pivot, 1).toArray()).toEqual(pivot.toArray());
  });
});

describe("the lens", () => {
  it.each([0, 0.05, 0.12, 0.3])("distortion %f bends and straightens", (distortion) => {
    expect(straightened(1, distortion)).toBeCloseTo(1, 12);
    for (const radius of [0, 0.1, 0.5, 0.9, 1, 1.3]) expect(bent(straightened(radius, distortion), distortion)).toBeCloseTo(radius, 12);
    // Barrel: what is half-way without it is further out.
    expect(bent(0.5, distortion)).toBeGreaterThanOrEqual(0.5);
  });

  it("rays and places are each other's inverse", () => {
    const circle = { x: 640, y: 380, radius: 300 };
    for (const distortion of [0, 0.12]) {
      const seen = eye(0.5, 0.9);
      for (const [x, y] of [[640, 380], [500, 200], [900, 420]] as const) {
        const { origin, direction } = rayThrough(x, y, circle, seen, distortion);
        expect(direction.length()).toBeCloseTo(1, 12);
        const [u, v] = seenAt(origin.addScaledVector(direction, 0.07), circle, seen, distortion);
        expect(u).toBeCloseTo(x, 8);
        expect(v).toBeCloseTo(y, 8);
      }
      // The edge is the edge of the field of view.
      const edge = rayThrough(940, 380, circle, seen, distortion).direction;
      expect(edge.angleTo(seen.forward)).toBeCloseTo(FIELD / 2, 12);
    }
    expect(seenAt(new Vector3(0.01, -0.02, 0.03).addScaledVector(eye(0.5, 0).forward, -0.1), circle, eye(0.5, 0), 0.1)[0]).toBeNaN();
  });

  it("the page's address may ask for another distortion", () => {
    expect(distortionOf("?distortion=0")).toBe(0);
    expect(distortionOf("?view=theatre&distortion=0.2")).toBe(0.2);
    expect(distortionOf("")).toBe(distortionOf("?distortion=7"));
  });
});

describe("stereo", () => {
  it("what is at the distance of the crossing is at the same place for both eyes, what is nearer is crossed", () => {
    const seen = (side: -1 | 1, z: number): number => {
      const camera = new PerspectiveCamera(70, 1, 0.001, 1);
      throughLens(camera, side, 0.1);
      return new Vector3(0, 0, z).project(camera).x;
    };
    expect(seen(-1, -0.1)).toBeCloseTo(0, 12);
    expect(seen(1, -0.1)).toBeCloseTo(0, 12);
    // The left eye sees what is nearer further to the right.
    expect(seen(-1, -0.05)).toBeGreaterThan(0.01);
    expect(seen(1, -0.05)).toBeCloseTo(-seen(-1, -0.05), 12);
    expect(seen(-1, -0.3)).toBeLessThan(0);
  });

  it("goes around its choices", () => {
    expect([nextStereo("off"), nextStereo("side_by_side"), nextStereo("anaglyph")]).toEqual(["side_by_side", "anaglyph", "off"]);
  });
});

describe("the walls", () => {
  it("are as far away as the ellipsoid is", () => {
    const walls = new Mesh();
    walls.position.set(1, 0, 0);
    walls.scale.set(0.1, 0.2, 0.3);
    const ray = { origin: new Vector3(1.05, 0, 0), direction: new Vector3(1, 0, 0) };
    expect(distanceToWalls_m(walls, ray)).toBeCloseTo(0.05, 12);
    expect(distanceToWalls_m(walls, { ...ray, direction: new Vector3(-1, 0, 0) })).toBeCloseTo(0.15, 12);
    expect(distanceToWalls_m(walls, { origin: new Vector3(1, 0, 0), direction: new Vector3(0, 0, 1) })).toBeCloseTo(0.3, 12);
    expect(distanceToWalls_m(walls, { ...ray, origin: new Vector3(2, 0, 0) })).toBe(Infinity);
  });
});
