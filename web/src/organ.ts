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
import { tissueGeometry } from "./tissue/geometry";
import type { TissueLook } from "./tissue/looks";
import { ProtocolError, type Snapshot, type Topology } from "./protocol";

export type SurfaceStyle = "surface" | "surface_with_edges" | "edges";
export const SURFACE_STYLES: readonly SurfaceStyle[] = ["surface", "surface_with_edges", "edges"];

/** 1 for each vertex that lies in cuts alone, 0 where the organ's own surface is. */
export function insideOf({ nodeIds, triangles, isCut }: Topology): Float32Array {
  const inside = new Float32Array(nodeIds.length).fill(1);
  triangles.forEach((vertex, i) => {
    if (isCut[Math.floor(i / 3)] === 0) inside[vertex] = 0;
  });
  return inside;
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
  private readonly burnt: BufferAttribute;
  /** Of the bodies that are shown: what can be picked. */
  triangles: Uint32Array;
  private readonly surface: Mesh;
  private readonly edges: LineSegments;
  private readonly fixed: Points;
  private readonly geometries: BufferGeometry[];
  private readonly paint: BufferAttribute;
  private isColoured = false;

  constructor(
    readonly topology: Topology,
    fixedNodes: ReadonlySet<number>,
    material: ShaderMaterial,
    looks: readonly TissueLook[],
  ) {
    const { rest_m, triangles, nodeIds, bodyOf } = topology;
    const geometry = tissueGeometry({ rest_m, triangles, inside: insideOf(topology), lookAt: (vertex) => looks[bodyOf[vertex]] ?? looks[0] });
    this.position = (geometry.getAttribute("position") as BufferAttribute).setUsage(DynamicDrawUsage);
    this.normal = (geometry.getAttribute("normal") as BufferAttribute).setUsage(DynamicDrawUsage);
    this.paint = (geometry.getAttribute("paint") as BufferAttribute).setUsage(DynamicDrawUsage);
    this.burnt = geometry.getAttribute("burnt") as BufferAttribute;
    this.positions_m = this.position.array as Float32Array;
    this.normals = this.normal.array as Float32Array;
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
    if (values === null) paint.fill(0);
    values?.forEach((value, vertex) => {
      colourInto(value / top, paint, 4 * vertex);
      paint[4 * vertex + 3] = 1;
    });
    this.paint.needsUpdate = true;
  }

  /** How much each vertex is burnt, 0 to 1, by its place at rest. */
  burn(amountAt: (rest_m: ArrayLike<number>, offset: number) => number): void {
    const { rest_m } = this.topology;
    for (let i = 0; i < this.burnt.count; i++) this.burnt.setX(i, amountAt(rest_m, 3 * i));
    this.burnt.needsUpdate = true;
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
