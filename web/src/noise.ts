/** Generated, seeded noise for the organ's look: nothing is downloaded, and every run shows the same organ. */
import { DataTexture, LinearMipmapNearestFilter, RepeatWrapping, RGBAFormat, UnsignedByteType } from "three";

/** A hash of three lattice coordinates to [0, 1) (integer finaliser of Murmur3, A. Appleby, public domain). */
export function latticeValue(x: number, y: number, z: number): number {
  let h = Math.imul(x, 0x9e3779b1) ^ Math.imul(y, 0x85ebca6b) ^ Math.imul(z, 0xc2b2ae35);
  h = Math.imul(h ^ (h >>> 16), 0x85ebca6b);
  h = Math.imul(h ^ (h >>> 13), 0xc2b2ae35);
  return ((h ^ (h >>> 16)) >>> 0) / 4294967296;
}

const fade = (t: number): number => t * t * t * (t * (6 * t - 15) + 10);
const mix = (a: number, b: number, t: number): number => a + (b - a) * t;

/** Smooth value noise in [0, 1) with lattice distance 1. */
export function valueNoise(x: number, y: number, z: number): number {
  const ix = Math.floor(x);
  const iy = Math.floor(y);
  const iz = Math.floor(z);
  const fx = fade(x - ix);
  const fy = fade(y - iy);
  const fz = fade(z - iz);
  const row = (dy: number, dz: number): number =>
    mix(latticeValue(ix, iy + dy, iz + dz), latticeValue(ix + 1, iy + dy, iz + dz), fx);
  return mix(mix(row(0, 0), row(1, 0), fy), mix(row(0, 1), row(1, 1), fy), fz);
}

/** Sum of `octaves` of value noise, each half as high and twice as fine; in [0, 1). */
export function fractalNoise(x: number, y: number, z: number, octaves: number): number {
  let sum = 0;
  let weight = 0.5;
  let scale = 1;
  let total = 0;
  for (let i = 0; i < octaves; i++) {
    sum += weight * valueNoise(x * scale, y * scale, z * scale);
    total += weight;
    weight *= 0.5;
    scale *= 2;
  }
  return sum / total;
}

/** Tileable value noise of period `period` lattice cells in x and y. */
function tileableNoise(x: number, y: number, period: number, seed: number): number {
  const ix = Math.floor(x);
  const iy = Math.floor(y);
  const fx = fade(x - ix);
  const fy = fade(y - iy);
  const at = (dx: number, dy: number): number => latticeValue((ix + dx) % period, (iy + dy) % period, seed);
  return mix(mix(at(0, 0), at(1, 0), fx), mix(at(0, 1), at(1, 1), fx), fy);
}

/** A square, tileable texture: red and green = slope of a bumpy height, blue = fine mottling, alpha = coarse patches. */
export function tissueTexture(size = 256): DataTexture {
  const height = new Float32Array(size * size);
  const octave = (x: number, y: number, cells: number, seed: number): number =>
    tileableNoise((x * cells) / size, (y * cells) / size, cells, seed);
  for (let y = 0; y < size; y++) {
    for (let x = 0; x < size; x++) {
      height[y * size + x] = 0.55 * octave(x, y, 9, 1) + 0.3 * octave(x, y, 23, 2) + 0.15 * octave(x, y, 61, 3);
    }
  }
  const at = (x: number, y: number): number => height[((y + size) % size) * size + ((x + size) % size)];
  const bytes = new Uint8Array(4 * size * size);
  const slope = (value: number): number => Math.round(Math.min(255, Math.max(0, 127.5 + 127.5 * 9 * value)));
  for (let y = 0; y < size; y++) {
    for (let x = 0; x < size; x++) {
      const i = 4 * (y * size + x);
      bytes[i] = slope(at(x + 1, y) - at(x - 1, y));
      bytes[i + 1] = slope(at(x, y + 1) - at(x, y - 1));
      bytes[i + 2] = Math.round(255 * (0.5 * octave(x, y, 31, 4) + 0.5 * octave(x, y, 64, 5)));
      bytes[i + 3] = Math.round(255 * (0.7 * octave(x, y, 4, 6) + 0.3 * octave(x, y, 11, 7)));
    }
  }
  return tiled(bytes, size);
}

function tiled(bytes: Uint8Array<ArrayBuffer>, size: number): DataTexture {
  const texture = new DataTexture(bytes, size, size, RGBAFormat, UnsignedByteType);
  texture.wrapS = RepeatWrapping;
  texture.wrapT = RepeatWrapping;
  // The nearest mip level only: half the cost when the processor draws.
  texture.minFilter = LinearMipmapNearestFilter;
  texture.generateMipmaps = true;
  texture.needsUpdate = true;
  return texture;
}

/** Distances to the nearest and the next of points of which each cell of a tileable lattice has one, in cells (S. Worley, "A cellular texture basis function", SIGGRAPH 1996). */
function cellDistances(x: number, y: number, period: number, seed: number): [number, number] {
  const [ix, iy] = [Math.floor(x), Math.floor(y)];
  let [first, second] = [Infinity, Infinity];
  for (let cy = iy - 1; cy <= iy + 1; cy++) {
    for (let cx = ix - 1; cx <= ix + 1; cx++) {
      const [tx, ty] = [(cx + period) % period, (cy + period) % period];
      const distance = Math.hypot(cx + latticeValue(tx, ty, seed) - x, cy + latticeValue(tx, ty, seed + 1) - y);
      if (distance < first) [first, second] = [distance, first];
      else if (distance < second) second = distance;
    }
  }
  return [first, second];
}

/** Trees of vessels into the red of a tileable texture: they wind, branch, and get thinner. */
function drawVessels(bytes: Uint8Array, size: number): void {
  let n = 0;
  const random = (): number => latticeValue(n++, 31, 7);
  const dot = (x: number, y: number, radius: number): void => {
    const reach = Math.ceil(radius + 1);
    for (let dy = -reach; dy <= reach; dy++) {
      for (let dx = -reach; dx <= reach; dx++) {
        const [px, py] = [Math.floor(x) + dx, Math.floor(y) + dy];
        const covered = Math.min(1, Math.max(0, radius + 0.5 - Math.hypot(px - x, py - y)));
        const at = 4 * (((py + 4 * size) % size) * size + ((px + 4 * size) % size));
        bytes[at] = Math.max(bytes[at], Math.round(255 * covered * Math.min(1, 0.35 + 0.4 * radius)));
      }
    }
  };
  const grow = (x: number, y: number, turn: number, radius: number, generation: number): void => {
    let bend = 0;
    for (let step = 0; step < 44 * radius + 30 && radius > 0.25; step++) {
      dot(x, y, radius);
      bend = 0.86 * bend + 0.13 * (random() - 0.5);
      turn += bend;
      x += Math.cos(turn);
      y += Math.sin(turn);
      radius *= 0.9945;
      if (generation < 4 && random() < 0.045) grow(x, y, turn + (random() < 0.5 ? -1 : 1) * (0.5 + 0.5 * random()), 0.68 * radius, generation + 1);
    }
  };
  for (let i = 0; i < 7; i++) grow(size * random(), size * random(), 2 * Math.PI * random(), 1.5 + 0.7 * random(), 0);
}

/** A square, tileable texture: red = trees of vessels, green = height of lobules (0 at their borders), blue and alpha = slope of that. */
export function patternTexture(size = 256): DataTexture {
  const cells = 11;
  const height = new Float32Array(size * size);
  const bytes = new Uint8Array(4 * size * size);
  for (let y = 0; y < size; y++) {
    for (let x = 0; x < size; x++) {
      const at = y * size + x;
      const warp = (seed: number): number => 0.5 * (tileableNoise((x * 23) / size, (y * 23) / size, 23, seed) - 0.5);
      const [first, second] = cellDistances((x * cells) / size + warp(20), (y * cells) / size + warp(21), cells, 22);
      height[at] = Math.min(1, 1.5 * (second - first));
      bytes[4 * at + 1] = Math.round(255 * height[at]);
    }
  }
  drawVessels(bytes, size);
  const at = (x: number, y: number): number => height[((y + size) % size) * size + ((x + size) % size)];
  const slope = (value: number): number => Math.round(Math.min(255, Math.max(0, 127.5 + 127.5 * 3 * value)));
  for (let y = 0; y < size; y++) {
    for (let x = 0; x < size; x++) {
      bytes[4 * (y * size + x) + 2] = slope(at(x + 1, y) - at(x - 1, y));
      bytes[4 * (y * size + x) + 3] = slope(at(x, y + 1) - at(x, y - 1));
    }
  }
  return tiled(bytes, size);
}
