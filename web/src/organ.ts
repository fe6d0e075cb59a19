/** One organ on the screen: its surface, its edges, its fixed nodes; positions come from snapshots. */
import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DynamicDrawUsage,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  Points,
  PointsMaterial,
  type Material,
  type ShaderMaterial,
} from "three";
import { uniqueEdges, vertexNormalsInto } from "./geometry";
import { colourInto } from "./inside/colours";
import { fractalNoise } from "./noise";
import { ProtocolError, type BodyInfo, type Snapshot, type Topology } from "./protocol";

export type SurfaceStyle = "surface" | "surface_with_edges" | "edges";
export const SURFACE_STYLES: readonly SurfaceStyle[] = ["surface", "surface_with_edges", "edges"];

/** Size of the coarse colour patches [m]. */
const PATCH_SIZE_M = 0.035;

/** Noise in [0, 1] at each rest position: the coarse part of the organ's colour. */
function toneOf(rest_m: Float32Array): Float32Array {
  const tone = new Float32Array(rest_m.length / 3);
  for (let i = 0; i < tone.length; i++) {
    const [x, y, z] = [0, 1, 2].map((k) => rest_m[3 * i + k] / PATCH_SIZE_M) as [number, number, number];
    tone[i] = fractalNoise(x, y, z, 4);
  }
  return tone;
}

/** 1 for each vertex that lies in cuts alone, 0 where the organ's own surface is. */
export function insideOf({ nodeIds, triangles, isCut }: Topology): Float32Array {
  const inside = new Float32Array(nodeIds.length).fill(1);
  triangles.forEach((vertex, i) => {
    if (isCut[Math.floor(i / 3)] === 0) inside[vertex] = 0;
  });
  return inside;
}

/** How much of a field's colour shows: all of it, whatever lies above and below (`materials.ts`). */
const FIELD_PAINT = 2;

/** A rigid body without a colour of its own: bone. */
const RIGID_COLOR = "#d8d0bc";

/** Colour of each vertex by its body, and how much of it shows. */
export function paintOf({ bodyOf }: Topology, bodies: readonly BodyInfo[]): Float32Array {
  const colors = bodies.map(({ color, is_rigid }) => color ?? (is_rigid ? RIGID_COLOR : null));
  const paints = colors.map((color) => (color === null ? [0, 0, 0, 0] : [...new Color(color).toArray(), 0.85]));
  const paint = new Float32Array(4 * bodyOf.length);
  bodyOf.forEach((body, vertex) => paint.set(paints[body] ?? [0, 0, 0, 0], 4 * vertex));
  return paint;
}

/** The triangles of the bodies that are not hidden. */
export function shownTriangles({ triangles, bodyOf }: Topology, hidden: ReadonlySet<number>): Uint32Array {
  if (hidden.size === 0) return triangles;
  return triangles.filter((_, i) => !hidden.has(bodyOf[triangles[i - (i % 3)]]));
}

export class Organ {
  readonly group = new Group();
  /** xyz of each vertex [m]: the very array that the GPU buffer is filled from. */
  readonly positions_m: Float32Array;
  private readonly normals: Float32Array;
  private readonly position: BufferAttribute;
  private readonly normal: BufferAttribute;
  /** Of the bodies that are shown: what can be picked. */
  triangles: Uint32Array;
  private readonly surface: Mesh;
  private readonly edges: LineSegments;
  private readonly fixed: Points;
  private readonly geometries: BufferGeometry[];
  private readonly paint: BufferAttribute;
  private readonly ownPaint: Float32Array;
  private isColoured = false;

  constructor(
    readonly topology: Topology,
    fixedNodes: ReadonlySet<number>,
    material: ShaderMaterial,
    bodies: readonly BodyInfo[] = [],
  ) {
    const { rest_m, triangles, nodeIds } = topology;
    this.positions_m = rest_m.slice();
    this.normals = new Float32Array(rest_m.length);
    vertexNormalsInto(rest_m, triangles, this.normals);
    this.position = new BufferAttribute(this.positions_m, 3).setUsage(DynamicDrawUsage);
    this.normal = new BufferAttribute(this.normals, 3).setUsage(DynamicDrawUsage);

    const geometry = new BufferGeometry();
    geometry.setAttribute("position", this.position);
    geometry.setAttribute("normal", this.normal);
    geometry.setAttribute("restPosition", new BufferAttribute(rest_m.slice(), 3));
    geometry.setAttribute("restNormal", new BufferAttribute(this.normals.slice(), 3));
    geometry.setAttribute("tone", new BufferAttribute(toneOf(rest_m), 1));
    geometry.setAttribute("inside", new BufferAttribute(insideOf(topology), 1));
    this.ownPaint = paintOf(topology, bodies);
    this.paint = new BufferAttribute(this.ownPaint.slice(), 4).setUsage(DynamicDrawUsage);
    geometry.setAttribute("paint", this.paint);
    geometry.setIndex(new BufferAttribute(triangles, 1));
    this.triangles = triangles;
    this.surface = new Mesh(geometry, material);

    const edgeGeometry = new BufferGeometry();
    edgeGeometry.setAttribute("position", this.position);
    edgeGeometry.setIndex(new BufferAttribute(uniqueEdges(triangles, nodeIds.length), 1));
    const edgeMaterial = new LineBasicMaterial({ color: new Color(0xffc9b0), transparent: true, opacity: 0.3 });
    this.edges = new LineSegments(edgeGeometry, edgeMaterial);

    const fixedGeometry = new BufferGeometry();
    fixedGeometry.setAttribute("position", this.position);
    const shown = Array.from(nodeIds.keys()).filter((vertex) => fixedNodes.has(nodeIds[vertex]));
    fixedGeometry.setIndex(shown);
    const fixedMaterial = new PointsMaterial({ color: 0x5ab4ff, size: 6, sizeAttenuation: false });
    this.fixed = new Points(fixedGeometry, fixedMaterial);
    this.fixed.visible = false;

    this.geometries = [geometry, edgeGeometry, fixedGeometry];
    for (const part of [this.surface, this.edges, this.fixed]) {
      // Deforms every frame: a box for culling would cost more than it saves.
      part.frustumCulled = false;
      this.group.add(part);
    }
    this.setStyle("surface");
  }

  get nVertices(): number {
    return this.topology.nodeIds.length;
  }

  get nFixedShown(): number {
    return this.fixed.geometry.index?.count ?? 0;
  }

  /** Shows a snapshot; false if it is what is shown already. @throws ProtocolError if it has another number of vertices than the topology. */
  show(snapshot: Snapshot): boolean {
    if (snapshot.positions_m.length !== this.positions_m.length) {
      throw new ProtocolError(
        `snapshot of step ${snapshot.header.step} has ${snapshot.positions_m.length / 3} vertices, ` +
          `its topology ${this.nVertices}`,
      );
    }
    const { positions_m } = snapshot;
    if (this.positions_m.every((x, i) => x === positions_m[i])) return false;
    this.positions_m.set(snapshot.positions_m);
    vertexNormalsInto(this.positions_m, this.topology.triangles, this.normals);
    this.position.needsUpdate = true;
    this.normal.needsUpdate = true;
    return true;
  }

  /** Colours the surface by a value at each vertex, of which `top` has the scale's upper end; null: as it is. */
  colour(values: Float32Array | null, top: number): void {
    if (values === null && !this.isColoured) return;
    this.isColoured = values !== null;
    const paint = this.paint.array as Float32Array;
    if (values === null) paint.set(this.ownPaint);
    values?.forEach((value, vertex) => {
      colourInto(value / top, paint, 4 * vertex);
      paint[4 * vertex + 3] = FIELD_PAINT;
    });
    this.paint.needsUpdate = true;
  }

  /** Of what is drawn on the surface. */
  get markMaterials(): readonly Material[] {
    return [this.edges.material as LineBasicMaterial, this.fixed.material as PointsMaterial];
  }

  setStyle(style: SurfaceStyle): void {
    this.surface.visible = style !== "edges";
    this.edges.visible = style !== "surface";
    (this.edges.material as LineBasicMaterial).opacity = style === "edges" ? 0.55 : 0.3;
  }

  /** Hides bodies by their numbers. */
  hide(hidden: ReadonlySet<number>): void {
    this.triangles = shownTriangles(this.topology, hidden);
    this.surface.geometry.setIndex(new BufferAttribute(this.triangles, 1));
    this.edges.geometry.setIndex(new BufferAttribute(uniqueEdges(this.triangles, this.nVertices), 1));
  }

  showFixed(shown: boolean): void {
    this.fixed.visible = shown && this.nFixedShown > 0;
  }

  dispose(): void {
    for (const geometry of this.geometries) geometry.dispose();
    (this.edges.material as LineBasicMaterial).dispose();
    (this.fixed.material as PointsMaterial).dispose();
  }
}
