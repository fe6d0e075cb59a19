/** Contact points in the picture: a disc on the surface, a line along its normal, an arrow for the force. */
import {
  Color,
  ConeGeometry,
  CylinderGeometry,
  GreaterDepth,
  Group,
  InstancedMesh,
  LessEqualDepth,
  Matrix4,
  MeshBasicMaterial,
  Quaternion,
  Vector3,
  type BufferGeometry,
} from "three";
import type { ContactKind, ContactPoints } from "./contact_points";

export const KIND_COLOURS: Readonly<Record<ContactKind, string>> = {
  tool_organ: "#58d0ff",
  tool_rigid: "#c79bff",
  bodies: "#8dff6a",
  itself: "#ff86d0",
  tool_tool: "#ffd24a",
};
const NORMAL_COLOUR = "#ffffff";

/** Marks at one time at most: what a server sends. */
const MOST_MARKS = 320;
/** Sizes as shares of the distance of the eye, so that marks stay readable: radius of a disc, its thickness, length of a normal ... */
const DISC = 0.0036;
const THICKNESS = 0.001;
const NORMAL = 0.018;
/** ... radius of its line, radius of an arrow's shaft and greatest length of its head. */
const LINE = 0.0006;
const SHAFT = 0.0011;
const HEAD = 0.016;
/** What lies behind something is this opaque. */
const BEHIND = 0.5;

const Z = new Vector3(0, 0, 1);

/** Shapes of one sort, drawn twice: where nothing is before them, and faintly where something is. */
class Shapes {
  readonly meshes: readonly InstancedMesh[];

  constructor(geometry: BufferGeometry) {
    this.meshes = [false, true].map((behind) => {
      const material = new MeshBasicMaterial({
        toneMapped: false,
        transparent: true,
        depthWrite: !behind,
        depthFunc: behind ? GreaterDepth : LessEqualDepth,
        opacity: behind ? BEHIND : 1,
      });
      const mesh = new InstancedMesh(geometry, material, MOST_MARKS);
      mesh.frustumCulled = false;
      mesh.count = 0;
      // After all tissue, and what is behind something first.
      mesh.renderOrder = behind ? 10 : 11;
      return mesh;
    });
  }

  clear(): void {
    for (const mesh of this.meshes) mesh.count = 0;
  }

  add(matrix: Matrix4, colour: Color): void {
    for (const mesh of this.meshes) {
      mesh.setMatrixAt(mesh.count, matrix);
      mesh.setColorAt(mesh.count, colour);
      mesh.count += 1;
    }
  }

  upload(): void {
    for (const mesh of this.meshes) {
      mesh.visible = mesh.count > 0;
      mesh.instanceMatrix.needsUpdate = true;
      if (mesh.instanceColor !== null) mesh.instanceColor.needsUpdate = true;
    }
  }
}

const cylinder = (): BufferGeometry => new CylinderGeometry(1, 1, 1, 14).rotateX(Math.PI / 2).translate(0, 0, 0.5);

export class ContactMarks {
  readonly group = new Group();
  private readonly discs = new Shapes(cylinder());
  private readonly lines = new Shapes(cylinder());
  private readonly shafts = new Shapes(cylinder());
  private readonly heads = new Shapes(new ConeGeometry(1, 1, 14).rotateX(Math.PI / 2).translate(0, 0, 0.5));
  private readonly all = [this.lines, this.discs, this.shafts, this.heads];
  private readonly colours = Object.fromEntries(
    Object.entries(KIND_COLOURS).map(([kind, colour]) => [kind, new Color(colour)]),
  ) as Record<ContactKind, Color>;
  private readonly white = new Color(NORMAL_COLOUR);

  constructor() {
    for (const shapes of this.all) this.group.add(...shapes.meshes);
  }

  /** Shows the points, none for null, to an eye at `distance_m`, with arrows of so much for a newton. */
  show(contacts: ContactPoints | null, distance_m: number, arrowScale_m_per_n: number): void {
    for (const shapes of this.all) shapes.clear();
    const [matrix, turn, scale, from] = [new Matrix4(), new Quaternion(), new Vector3(), new Vector3()];
    const put = (shapes: Shapes, colour: Color, width_m: number, length_m: number): void =>
      shapes.add(matrix.compose(from, turn, scale.set(width_m, width_m, length_m)), colour);
    for (const point of contacts?.points.slice(0, MOST_MARKS) ?? []) {
      const colour = this.colours[point.kind];
      const force_n = new Vector3(...point.force_n);
      const normal = new Vector3(...point.normal);
      const hasNormal = normal.lengthSq() > 0;
      from.set(...point.place_m);
      turn.setFromUnitVectors(Z, hasNormal ? normal.normalize() : force_n.clone().normalize());
      put(this.discs, colour, DISC * distance_m, THICKNESS * distance_m);
      if (hasNormal) put(this.lines, this.white, LINE * distance_m, NORMAL * distance_m);
      const length_m = force_n.length() * arrowScale_m_per_n;
      const head_m = Math.min(0.45 * length_m, HEAD * distance_m);
      const shaft_m = Math.min(SHAFT * distance_m, 0.16 * length_m);
      turn.setFromUnitVectors(Z, force_n.normalize());
      put(this.shafts, colour, shaft_m, length_m - 0.9 * head_m);
      from.addScaledVector(force_n, length_m - head_m);
      put(this.heads, colour, 2.8 * shaft_m, head_m);
    }
    for (const shapes of this.all) shapes.upload();
  }
}
