/** The instrument (a metal probe with depth marks), the contact point and the force arrow. */
import {
  CapsuleGeometry,
  ConeGeometry,
  CylinderGeometry,
  Group,
  LatheGeometry,
  Mesh,
  Quaternion,
  SphereGeometry,
  Vector2,
  Vector3,
  type BufferGeometry,
} from "three";
import { solidMaterial } from "./materials";
import type { JawsInfo, ToolInfo, ToolState, Vec3 } from "./protocol";

const Z = new Vector3(0, 0, 1);
const FRONT = new Vector3(0, -1, 0);
/** Tool axes of a shaft to the front: x to the left, y to the head, z to the front. */
const FRONT_AXES = new Quaternion().setFromUnitVectors(Z, FRONT);
/** Distance of the marks on the shaft [m]. */
export const MARK_SPACING_M = 0.01;
/** Forces below this show no arrow [N]: it would be shorter than its head. */
const SMALLEST_ARROW_M = 0.002;

function directed(vector: Vec3): Vector3 {
  const v = new Vector3(...vector);
  return v.lengthSq() > 0 ? v.normalize() : Z.clone();
}

/** A surface of revolution about z from (radius, z) pairs. */
function revolved(profile: ReadonlyArray<readonly [number, number]>): BufferGeometry {
  const geometry = new LatheGeometry(
    profile.map(([radius, z]) => new Vector2(Math.max(radius, 0), z)),
    40,
  );
  // The lathe turns about y; the shaft runs along z.
  return geometry.rotateX(Math.PI / 2);
}

export class Instrument {
  readonly group = new Group();
  /** What is drawn to explain: the force and the contact. */
  readonly overlays = new Group();
  private readonly probe = new Group();
  private readonly jaws: Group[] = [];
  private readonly arrow = new Group();
  private readonly arrowShaft: Mesh;
  private readonly arrowHead: Mesh;
  private readonly contactMark: Mesh;
  private readonly tipRadius_m: number;
  private readonly tip_m = new Vector3();
  /** Turn about the shaft, as shown [rad]. */
  roll_rad = 0;
  private showsForces = true;
  private showsContactMark = true;
  /** Force at the hand that holds it as a device [N]; the simulation's where none does. */
  private felt_n: Vec3 | null = null;
  /** Length of the arrow for a newton [m/N]. */
  arrowScale_m_per_n = 0.02;

  constructor(private readonly tool: ToolInfo) {
    const tip = tool.tip_radius_m;
    const shaft = Math.min(tool.shaft_radius_m, tip > 0 ? Math.max(tip * 0.98, 1e-4) : tool.shaft_radius_m);
    const length = Math.max(tool.shaft_length_m, 4 * tip);
    this.tipRadius_m = tip;

    const steel = solidMaterial({ colour: 0xc9ced4, metal: 1, softness: 0.14, bandSpacing_m: MARK_SPACING_M });
    const polished = solidMaterial({ colour: 0xe4e8ec, metal: 1, softness: 0.06 });
    const grip = solidMaterial({ colour: 0x20262c, metal: 0, softness: 0.3 });
    // The neck leaves the sphere where its radius has come down to the shaft's.
    const neck = tool.jaws?.length_m ?? Math.sqrt(Math.max(tip * tip - shaft * shaft, 0));
    const glass = solidMaterial({ colour: 0x0b1620, metal: 0, softness: 0.04 });
    if (tool.jaws === null) this.probe.add(new Mesh(new SphereGeometry(tip, 40, 28), tool.optics === null ? polished : glass));
    else this.addJaws(tool.jaws, polished);
    this.probe.add(new Mesh(new CylinderGeometry(shaft, shaft, length - neck, 40, 1, true)
      .rotateX(Math.PI / 2)
      .translate(0, 0, neck + (length - neck) / 2), steel));
    const handle = 1.9 * shaft;
    const gripLength = Math.min(0.09, 0.4 * length);
    this.probe.add(new Mesh(revolved([
      [shaft, length - gripLength],
      [handle, length - gripLength + 0.006],
      [handle, length - 0.004],
      [handle * 0.7, length],
      [0, length],
    ]), grip));

    const amber = solidMaterial({ colour: 0xffa028, metal: 0, softness: 0.4, glow: 0.55 });
    this.arrowShaft = new Mesh(new CylinderGeometry(1, 1, 1, 20).rotateX(Math.PI / 2).translate(0, 0, 0.5), amber);
    this.arrowHead = new Mesh(new ConeGeometry(1, 1, 28).rotateX(Math.PI / 2).translate(0, 0, 0.5), amber);
    this.arrow.add(this.arrowShaft, this.arrowHead);
    const blue = solidMaterial({ colour: 0x58d0ff, metal: 0, softness: 0.4, glow: 0.9 });
    this.contactMark = new Mesh(new SphereGeometry(1, 20, 14), blue);
    this.overlays.add(this.arrow, this.contactMark);
    this.group.add(this.probe, this.overlays);
    for (const part of [this.arrow, this.contactMark]) part.visible = false;
    this.pose(tool.home_tip_m, tool.home_shaft, 0, [0, 0, 0]);
    this.openJaws(tool.home_jaw);
  }

  /** Two jaws about the hinge, each a rod along -z in the frame of the hinge. */
  private addJaws(jaws: JawsInfo, material: ReturnType<typeof solidMaterial>): void {
    const { length_m } = jaws;
    for (let side = 0; side < 2; side++) {
      const jaw = new Group();
      jaw.position.set(0, 0, length_m);
      const rod = new CapsuleGeometry(this.tipRadius_m, length_m, 8, 16).rotateX(Math.PI / 2).translate(0, 0, -length_m / 2);
      jaw.add(new Mesh(rod, material));
      this.jaws.push(jaw);
      this.probe.add(jaw);
    }
  }

  /** Direction of the shaft as shown, tip to handle. */
  shaft(): Vector3 {
    return Z.clone().applyQuaternion(this.probe.quaternion);
  }

  /** Where the tip is; it is drawn further out where the mesh is too coarse to show its dimple. */
  tip(): Vector3 {
    return this.tip_m.clone();
  }

  /** Axes of the tool's frame: those of a shaft to the front (x left, y head), by the shortest turn, rolled. */
  private pose(tip_m: Vec3, shaft: Vec3, roll_rad: number, furtherOut_m: Vec3): void {
    this.tip_m.set(...tip_m);
    this.roll_rad = roll_rad;
    this.probe.position.copy(this.tip_m).add(new Vector3(...furtherOut_m));
    const turn = new Quaternion().setFromUnitVectors(FRONT, directed(shaft));
    const roll = new Quaternion().setFromAxisAngle(Z, roll_rad);
    this.probe.quaternion.copy(turn.multiply(FRONT_AXES).multiply(roll));
  }

  private openJaws(jaw: number): void {
    const angle = 0.5 * (this.tool.jaws?.greatest_opening_rad ?? 0) * Math.min(Math.max(jaw, 0), 1);
    this.jaws.forEach((part, i) => {
      part.rotation.y = i === 0 ? -angle : angle;
    });
  }

  /** A device holds it, whose force the arrow shows from now on. */
  feels(force_n: Vec3): void {
    this.felt_n = force_n;
  }

  show(header: ToolState): void {
    this.pose(header.tip_m, header.shaft, header.roll_rad, header.shownFurtherOut_m);
    this.openJaws(header.jaw);
    const force = new Vector3(...(this.felt_n ?? header.forceOnTool_n));
    const length = force.length() * this.arrowScale_m_per_n;
    this.arrow.visible = this.showsForces && length > SMALLEST_ARROW_M;
    if (this.arrow.visible) {
      const head = Math.min(0.4 * length, 0.012);
      const radius = Math.min(0.0016, 0.08 * length);
      this.arrowShaft.scale.set(radius, radius, length - 0.9 * head);
      this.arrowHead.scale.set(2.6 * radius, 2.6 * radius, head);
      this.arrowHead.position.z = length - head;
      // Beside the shaft rather than inside it: it starts at the contact point, which the tip covers.
      this.arrow.position.set(...(header.contact ? header.contactPoint_m : header.tip_m));
      this.arrow.quaternion.copy(new Quaternion().setFromUnitVectors(Z, force.normalize()));
    }
    this.contactMark.visible = this.showsContactMark && header.contact;
    if (this.contactMark.visible) {
      this.contactMark.position.set(...header.contactPoint_m);
      this.contactMark.scale.setScalar(Math.max(0.45 * this.tipRadius_m, 0.0015));
    }
  }

  setForces(shown: boolean): void {
    this.showsForces = shown;
  }

  setContactMark(shown: boolean): void {
    this.showsContactMark = shown;
  }

  dispose(): void {
    this.group.traverse((part) => {
      if (!(part instanceof Mesh)) return;
      part.geometry.dispose();
      part.material.dispose();
    });
  }
}
