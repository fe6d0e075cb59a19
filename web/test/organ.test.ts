import { Texture, type Mesh } from "three";
import { describe, expect, it } from "vitest";
import { Organ } from "../src/organ";
import type { Topology } from "../src/protocol";
import { lookOf } from "../src/tissue/looks";
import { organMaterial, uncutMaterial } from "../src/tissue/material";

/** A triangle. */
const TOPOLOGY = {
  organ: 0,
  version: 0,
  rest_m: new Float32Array([0, 0, 0, 1, 0, 0, 0, 1, 0]),
  triangles: new Uint32Array([0, 1, 2]),
  nodeIds: new Uint32Array([0, 1, 2]),
  bodyOf: new Uint32Array(3),
  isCut: new Uint8Array(1),
} as unknown as Topology;

describe("the surface of an organ", () => {
  const material = organMaterial(new Texture(), new Texture());

  it("is coloured by values at its vertices, and burnt by its place at rest, each without the other", () => {
    const organ = new Organ(TOPOLOGY, new Set(), material, [lookOf("liver")]);
    const { geometry } = organ.group.children[0] as Mesh;
    const shown = (): number[] => [0, 1, 2].map((vertex) => geometry.getAttribute("paint").getW(vertex));
    expect(shown()).toEqual([0, 0, 0]);
    organ.colour(new Float32Array([0, 1, 2]), 2);
    expect(shown()).toEqual([1, 1, 1]);
    // Dark blue to yellow.
    const paint = geometry.getAttribute("paint");
    expect(paint.getX(2)).toBeGreaterThan(paint.getX(0));
    organ.burn((rest_m, offset) => rest_m[offset]);
    organ.colour(null, 1);
    expect(shown()).toEqual([0, 0, 0]);
    expect(Array.from(geometry.getAttribute("burnt").array)).toEqual([0, 1, 0]);
  });

  it("is cut open alone: what is around it has the same looks, and stays whole", () => {
    const around = uncutMaterial(material);
    expect(around.uniforms.tissue).toBe(material.uniforms.tissue);
    material.uniforms.cutPlane.value.set(0, 0, 1, 0.1);
    expect(around.uniforms.cutPlane.value.toArray()).toEqual([0, 0, 0, 1]);
  });
});
