/**
 * Pure geometry on indexed triangle meshes: vertex normals, unique edges, the first triangle along a ray.
 *
 * Arrays: positions and normals `3 n_vertices` (xyz), triangles `3 n_triangles` (vertex indices).
 */
import { Vector3 } from "three";

/** Area-weighted unit vertex normals into `normals`. A vertex of no (or only flat) triangles gets (0, 0, 1). */
export function vertexNormalsInto(positions: Float32Array, triangles: Uint32Array, normals: Float32Array): void {
  normals.fill(0);
  for (let t = 0; t < triangles.length; t += 3) {
    const a = 3 * triangles[t];
    const b = 3 * triangles[t + 1];
    const c = 3 * triangles[t + 2];
    const ax = positions[a];
    const ay = positions[a + 1];
    const az = positions[a + 2];
    const ux = positions[b] - ax;
    const uy = positions[b + 1] - ay;
    const uz = positions[b + 2] - az;
    const vx = positions[c] - ax;
    const vy = positions[c + 1] - ay;
    const vz = positions[c + 2] - az;
    const nx = uy * vz - uz * vy;
    const ny = uz * vx - ux * vz;
    const nz = ux * vy - uy * vx;
    normals[a] += nx;
    normals[a + 1] += ny;
    normals[a + 2] += nz;
    normals[b] += nx;
    normals[b + 1] += ny;
    normals[b + 2] += nz;
    normals[c] += nx;
    normals[c + 1] += ny;
    normals[c + 2] += nz;
  }
  for (let i = 0; i < normals.length; i += 3) {
    const x = normals[i];
    const y = normals[i + 1];
    const z = normals[i + 2];
    const length = Math.sqrt(x * x + y * y + z * z);
    if (length > 0) {
      normals[i] = x / length;
      normals[i + 1] = y / length;
      normals[i + 2] = z / length;
    } else {
      normals[i + 2] = 1;
    }
  }
}

/** Each edge once, two vertex indices an edge. */
export function uniqueEdges(triangles: Uint32Array, nVertices: number): Uint32Array {
  const seen = new Set<number>();
  const edges: number[] = [];
  for (let t = 0; t < triangles.length; t += 3) {
    for (let k = 0; k < 3; k++) {
      const a = triangles[t + k];
      const b = triangles[t + ((k + 1) % 3)];
      const key = a < b ? a * nVertices + b : b * nVertices + a;
      if (seen.has(key)) continue;
      seen.add(key);
      edges.push(a, b);
    }
  }
  return Uint32Array.from(edges);
}

export interface Pick {
  /** Distance along the ray [m]. */
  readonly distance_m: number;
  readonly triangle: number;
  readonly point_m: Vector3;
  /** Unit outward normal of the triangle. */
  readonly normal: Vector3;
  /** Vertex of the triangle that is nearest to the point. */
  readonly vertex: number;
}

/**
 * The first triangle that a ray enters from outside (its normal faces the ray's origin), or null.
 * Moller and Trumbore, "Fast, minimum storage ray/triangle intersection", J. Graphics Tools 2(1), 1997,
 * doi 10.1080/10867651.1997.10487468. `direction` is a unit vector.
 */
export function pickTriangle(
  origin: Vector3,
  direction: Vector3,
  positions: Float32Array,
  triangles: Uint32Array,
): Pick | null {
  let best = Infinity;
  let bestTriangle = -1;
  const { x: ox, y: oy, z: oz } = origin;
  const { x: dx, y: dy, z: dz } = direction;
  for (let t = 0; t < triangles.length; t += 3) {
    const a = 3 * triangles[t];
    const b = 3 * triangles[t + 1];
    const c = 3 * triangles[t + 2];
    const ax = positions[a];
    const ay = positions[a + 1];
    const az = positions[a + 2];
    const ux = positions[b] - ax;
    const uy = positions[b + 1] - ay;
    const uz = positions[b + 2] - az;
    const vx = positions[c] - ax;
    const vy = positions[c + 1] - ay;
    const vz = positions[c + 2] - az;
    const px = dy * vz - dz * vy;
    const py = dz * vx - dx * vz;
    const pz = dx * vy - dy * vx;
    const det = ux * px + uy * py + uz * pz;
    // Positive determinant: the ray comes from the side that the normal points to.
    if (!(det > 0)) continue;
    const sx = ox - ax;
    const sy = oy - ay;
    const sz = oz - az;
    const u = sx * px + sy * py + sz * pz;
    if (u < 0 || u > det) continue;
    const qx = sy * uz - sz * uy;
    const qy = sz * ux - sx * uz;
    const qz = sx * uy - sy * ux;
    const v = dx * qx + dy * qy + dz * qz;
    if (v < 0 || u + v > det) continue;
    const distance = (vx * qx + vy * qy + vz * qz) / det;
    if (distance > 0 && distance < best) {
      best = distance;
      bestTriangle = t / 3;
    }
  }
  if (bestTriangle < 0) return null;
  const corners = [0, 1, 2].map((k) => triangles[3 * bestTriangle + k]);
  const points = corners.map((v) => new Vector3().fromArray(positions, 3 * v)) as [Vector3, Vector3, Vector3];
  const point_m = direction.clone().multiplyScalar(best).add(origin);
  const normal = points[1].clone().sub(points[0]).cross(points[2].clone().sub(points[0])).normalize();
  const distances = points.map((p) => p.distanceToSquared(point_m));
  const nearest = distances.indexOf(Math.min(...distances));
  return { distance_m: best, triangle: bestTriangle, point_m, normal, vertex: corners[nearest] };
}
