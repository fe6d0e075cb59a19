/** Draws the inside: bodies coloured by a field, cut open by a plane, with the section that it lays bare. */
import { BufferAttribute, BufferGeometry, Color, DoubleSide, Group, Mesh, MeshBasicMaterial, Plane, Vector3, type Material, type ShaderMaterial, type Vector4, type WebGLRenderer } from "three";
import type { Organ } from "../organ";
import { colourInto, Range } from "./colours";
import type { CutPlane } from "./plane";
import type { InsideSnapshot } from "./snapshot";

/** A section without a field: as tissue that was cut. */
const RAW = new Color(0x8c3a34);

export class InsidePicture {
  readonly group = new Group();
  private readonly range = new Range();
  private readonly section: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly plane = new Plane();
  private hasPlane = false;
  private isShown = false;
  /** Upper end of the scale of colours. */
  top = 1;

  constructor(private readonly surface: ShaderMaterial) {
    const material = new MeshBasicMaterial({ vertexColors: true, side: DoubleSide, toneMapped: false });
    this.section = new Mesh(new BufferGeometry(), material);
    this.section.frustumCulled = false;
    this.section.visible = false;
    this.group.add(this.section);
  }

  /** Takes away what is on a plane's side; null: nothing. */
  cut(plane: CutPlane | null, organs: Iterable<Organ>, renderer: WebGLRenderer): void {
    this.hasPlane = plane !== null;
    const uniform = this.surface.uniforms.cutPlane.value as Vector4;
    if (plane === null) {
      uniform.set(0, 0, 0, 1);
    } else {
      const normal = new Vector3(...plane.normal);
      this.plane.setFromNormalAndCoplanarPoint(normal.clone().negate(), new Vector3(...plane.point_m));
      uniform.set(normal.x, normal.y, normal.z, normal.dot(new Vector3(...plane.point_m)));
    }
    renderer.localClippingEnabled = plane !== null;
    for (const organ of organs) this.cutMarks(organ);
  }

  /** What is on their other side is shown. */
  get planes(): Plane[] | null {
    return this.hasPlane ? [this.plane] : null;
  }

  /** Edges and fixed nodes of an organ end at the plane, too. */
  cutMarks(organ: Organ): void {
    for (const material of organ.markMaterials as readonly Material[]) material.clippingPlanes = this.planes;
  }

  /** Answers whether the picture is another one now. */
  show(inside: InsideSnapshot | null, organ: Organ): boolean {
    const wasShown = this.isShown;
    this.isShown = inside !== null;
    if (!this.isShown && !wasShown) return false;
    const hasField = inside !== null && inside.field !== "none" && inside.values.length === organ.nVertices;
    if (inside !== null && hasField) this.top = this.range.take(inside.field, inside.values);
    organ.colour(hasField ? inside.values : null, this.top);
    const section = this.hasPlane && inside !== null ? inside.section_m : new Float32Array();
    this.section.visible = section.length > 0;
    if (!this.section.visible || inside === null) return true;
    const colours = new Float32Array(section.length);
    for (let i = 0; i < section.length; i += 3) {
      if (hasField) colourInto(inside.sectionValues[i / 3] / this.top, colours, i);
      else RAW.toArray(colours, i);
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(section, 3));
    geometry.setAttribute("color", new BufferAttribute(colours, 3));
    this.section.geometry.dispose();
    this.section.geometry = geometry;
    return true;
  }
}
