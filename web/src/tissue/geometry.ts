/** What the tissue's shader knows of each vertex: its place at rest, with patterns that are fixed to it, and its look. */
import { BufferAttribute, BufferGeometry } from "three";
import { vertexNormalsInto } from "../geometry";
import { fractalNoise } from "../noise";
import type { TissueLook } from "./looks";

/** Size of the coarse colour patches [m]. */
const PATCH_SIZE_M = 0.035;

/** Noise in [0, 1] at each rest position: the coarse part of the colour. */
function toneOf(rest_m: Float32Array): Float32Array {
  const tone = new Float32Array(rest_m.length / 3);
  for (let i = 0; i < tone.length; i++) {
    const [x, y, z] = [0, 1, 2].map((k) => rest_m[3 * i + k] / PATCH_SIZE_M) as [number, number, number];
    tone[i] = fractalNoise(x, y, z, 4);
  }
  return tone;
}

export interface TissueSurface {
  readonly rest_m: Float32Array;
  readonly triangles: Uint32Array;
  /** 1 for each vertex that lies in cuts alone; none where nothing is cut. */
  readonly inside?: Float32Array;
  readonly lookAt: (vertex: number) => TissueLook;
}

/** At rest; `position` and `normal` are the caller's to change. */
export function tissueGeometry({ rest_m, triangles, inside, lookAt }: TissueSurface): BufferGeometry {
  const n = rest_m.length / 3;
  const normals = new Float32Array(rest_m.length);
  vertexNormalsInto(rest_m, triangles, normals);
  // Colours with how much vessels, and how much lobules show.
  const [dark, light] = [new Float32Array(4 * n), new Float32Array(4 * n)];
  for (let vertex = 0; vertex < n; vertex++) {
    const look = lookAt(vertex);
    dark.set([...look.dark, look.vessels], 4 * vertex);
    light.set([...look.light, look.lobules], 4 * vertex);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(rest_m.slice(), 3));
  geometry.setAttribute("normal", new BufferAttribute(normals, 3));
  geometry.setAttribute("restPosition", new BufferAttribute(rest_m.slice(), 3));
  geometry.setAttribute("restNormal", new BufferAttribute(normals.slice(), 3));
  geometry.setAttribute("tone", new BufferAttribute(toneOf(rest_m), 1));
  geometry.setAttribute("inside", new BufferAttribute(inside ?? new Float32Array(n), 1));
  geometry.setAttribute("burnt", new BufferAttribute(new Float32Array(n), 1));
  geometry.setAttribute("paint", new BufferAttribute(new Float32Array(4 * n), 4));
  geometry.setAttribute("darkLook", new BufferAttribute(dark, 4));
  geometry.setAttribute("lightLook", new BufferAttribute(light, 4));
  geometry.setIndex(new BufferAttribute(triangles, 1));
  return geometry;
}
