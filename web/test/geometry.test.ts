import { describe, expect, it } from "vitest";
import { Vector3 } from "three";
import { reconnectDelay_ms, socketAddress } from "../src/connection";
import { pickTriangle, uniqueEdges, vertexNormalsInto } from "../src/geometry";
import { fractalNoise, latticeValue, valueNoise } from "../src/noise";
import { cameraPosition, orbitThatShows, panned, turned, viewAxes, zoomed, metresPerPixel } from "../src/orbit";
import { axisEnds, scaleBar_m } from "../src/orientation";

/** Octahedron, counter-clockwise from outside. */
const POSITIONS = Float32Array.of(1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1);
const TRIANGLES = Uint32Array.of(0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5);

describe("geometry", () => {
  it("vertex normals of an octahedron point from its centre", () => {
    const normals = new Float32Array(18);
    vertexNormalsInto(POSITIONS, TRIANGLES, normals);
    POSITIONS.forEach((x, i) => expect(normals[i]).toBeCloseTo(x, 6));
  });

  it("a vertex without triangles gets a unit normal, and none is NaN", () => {
    const normals = new Float32Array(6);
    vertexNormalsInto(Float32Array.of(0, 0, 0, 1, 1, 1), Uint32Array.of(0, 0, 1), normals);
    expect([...normals]).toEqual([0, 0, 1, 0, 0, 1]);
  });

  it("an octahedron has twelve edges", () => {
    const edges = uniqueEdges(TRIANGLES, 6);
    expect(edges.length).toBe(24);
  });

  it("picks the front triangle, its point, its normal and the nearest vertex", () => {
    const pick = pickTriangle(new Vector3(0.2, 0.3, 5), new Vector3(0, 0, -1), POSITIONS, TRIANGLES)!;
    expect(pick.triangle).toBe(0);
    expect(pick.point_m.distanceTo(new Vector3(0.2, 0.3, 0.5))).toBeLessThan(1e-12);
    expect(pick.distance_m).toBeCloseTo(4.5, 12);
    expect(pick.normal.distanceTo(new Vector3(1, 1, 1).normalize())).toBeLessThan(1e-12);
    expect(pick.vertex).toBe(4);
  });

  it("picks nothing beside it, behind the ray, or from inside", () => {
    const along = new Vector3(0, 0, -1);
    expect(pickTriangle(new Vector3(3, 0, 5), along, POSITIONS, TRIANGLES)).toBeNull();
    expect(pickTriangle(new Vector3(0.1, 0.1, -5), along, POSITIONS, TRIANGLES)).toBeNull();
    expect(pickTriangle(new Vector3(0.1, 0.1, 0), along, POSITIONS, TRIANGLES)).toBeNull();
  });
});

describe("view", () => {
  const orbit = orbitThatShows(new Vector3(-0.14, -0.08, -0.05), new Vector3(0.14, 0.08, 0.05), 1.5);

  it("starts in front of the patient, with the patient's left on the right", () => {
    const { right, up, forward } = viewAxes(orbit);
    expect(forward.y).toBeGreaterThan(0.7);
    expect(right.x).toBeGreaterThan(0.7);
    expect(up.z).toBeGreaterThan(0.7);
    expect(right.clone().cross(up).distanceTo(forward.clone().negate())).toBeLessThan(1e-12);
    expect(cameraPosition(orbit).clone().addScaledVector(forward, orbit.distance_m).distanceTo(orbit.target_m)).toBeLessThan(1e-12);
  });

  it("a full height of the pointer turns by half a turn, never over the poles", () => {
    expect(turned(orbit, 800, 0, 800).azimuth_rad).toBeCloseTo(orbit.azimuth_rad - Math.PI, 12);
    expect(Math.abs(turned(orbit, 0, 1e6, 800).elevation_rad)).toBeLessThan(Math.PI / 2);
  });

  it("panning moves the target by the pointer's way", () => {
    const moved = panned(orbit, 100, 0, 800).target_m.clone().sub(orbit.target_m);
    expect(moved.length()).toBeCloseTo(100 * metresPerPixel(orbit, 800), 12);
    expect(moved.dot(viewAxes(orbit).right)).toBeLessThan(0);
  });

  it("zoom in and out is the same distance again, within bounds", () => {
    expect(zoomed(zoomed(orbit, 3), -3).distance_m).toBeCloseTo(orbit.distance_m, 12);
    expect(zoomed(orbit, 1000).distance_m).toBe(0.02);
    expect(zoomed(orbit, -1000).distance_m).toBe(5);
  });

  it("names six directions, opposite ones opposite, the farthest first", () => {
    const ends = axisEnds(orbit);
    expect(ends.map((e) => e.letter).sort().join("")).toBe("AILPRS");
    const of = (letter: string) => ends.find((e) => e.letter === letter)!;
    expect(of("L").x).toBeCloseTo(-of("R").x, 12);
    expect(of("L").x).toBeGreaterThan(0);
    expect(of("S").y).toBeGreaterThan(0);
    expect(of("A").near).toBeGreaterThan(0);
    expect(ends.every((e, i) => i === 0 || e.near >= ends[i - 1].near)).toBe(true);
  });

  it("the scale bar is 1, 2 or 5 times a power of ten and fits", () => {
    for (let notches = -20; notches < 30; notches++) {
      const zoomedOrbit = zoomed(orbit, notches);
      const bar = scaleBar_m(zoomedOrbit, 800, 140);
      const pixels = bar / metresPerPixel(zoomedOrbit, 800);
      expect(pixels).toBeLessThanOrEqual(140 * (1 + 1e-9));
      expect(pixels).toBeGreaterThan(50);
      expect([1, 2, 5]).toContain(Number(bar.toExponential(6).split("e")[0]));
    }
  });
});

describe("noise", () => {
  it("stays in [0, 1), repeats, and is smooth across lattice points", () => {
    for (let i = 0; i < 500; i++) {
      const [x, y, z] = [0.37 * i - 60, 0.11 * i, -0.23 * i];
      const value = fractalNoise(x, y, z, 4);
      expect(value).toBeGreaterThanOrEqual(0);
      expect(value).toBeLessThan(1);
      expect(fractalNoise(x, y, z, 4)).toBe(value);
    }
    expect(valueNoise(3, 4, 5)).toBe(latticeValue(3, 4, 5));
    expect(Math.abs(valueNoise(3 - 1e-6, 4, 5) - valueNoise(3 + 1e-6, 4, 5))).toBeLessThan(1e-5);
  });
});

describe("connection", () => {
  it("goes to the page's host and folder, wss under https", () => {
    expect(socketAddress("http://127.0.0.1:8080/")).toBe("ws://127.0.0.1:8080/ws");
    expect(socketAddress("https://example.org/sim/?a=1#b")).toBe("wss://example.org/sim/ws");
  });
  it("waits longer each time, four seconds at most", () => {
    expect([1, 2, 3, 4, 5, 6, 1000].map(reconnectDelay_ms)).toEqual([400, 800, 1600, 3200, 4000, 4000, 4000]);
  });
});
