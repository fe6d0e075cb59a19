/** An instrument as it is shown: its parts with moving jaws, its trocar, the contact point and the force arrow. */
import { ConeGeometry, CylinderGeometry, DoubleSide, Group, Mesh, MeshBasicMaterial, Quaternion, SphereGeometry, Vector3 } from "three";
import { isRinsing } from "./field/suction";
import { instrumentParts, JET_M, jetOf, trocarParts, type Part } from "./instruments/parts";
import { Surfaces } from "./instruments/surfaces";
import { solidMaterial } from "./materials";
import type { ToolInfo, ToolState, Vec3 } from "./protocol";

const Z = new Vector3(0, 0, 1);
const FRONT = new Vector3(0, -1, 0);
/** Tool axes of a shaft to the front: x to the left, y to the head, z to the front. */
const FRONT_AXES = new Quaternion().setFromUnitVectors(Z, FRONT);
/** Forces below this show no arrow [N]: it would be shorter than its head. */
const SMALLEST_ARROW_M = 0.002;

function directed(vector: Vec3): Vector3 {
  const v = new Vector3(...vector);
  return v.lengthSq() > 0 ? v.normalize() : Z.clone();
}

export class Instrument {
  readonly group = new Group();
  /** What is drawn to explain: the force and the contact. */
  readonly overlays = new Group();
  private readonly probe = new Group();
  private readonly jaws: Group[] = [];
  /** In the abdominal wall, where the shaft goes through it. */
  private readonly trocar = new Group();
  /** Water, while it rinses. */
  readonly jet = new Group();
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
    this.tipRadius_m = tool.tip_radius_m;
    const surfaces = new Surfaces();
    const put = (into: Group, parts: readonly Part[]): void => {
      for (const { geometry, look } of parts) into.add(new Mesh(geometry, surfaces.of(look)));
    };
    const { fixed, jaws, hinge_m } = instrumentParts(tool);
    put(this.probe, fixed);
    for (const parts of jaws) {
      const jaw = new Group();
      jaw.position.set(0, 0, hinge_m);
      put(jaw, parts);
      this.jaws.push(jaw);
      this.probe.add(jaw);
    }
    if (tool.trocar_m !== null) {
      this.trocar.position.set(...tool.trocar_m);
      put(this.trocar, trocarParts(tool.shaft_radius_m));
    }

    if (tool.kind === "suction") this.jet.add(new Mesh(jetOf(tool), new MeshBasicMaterial({ color: 0xbfd8de, transparent: true, opacity: 0.3, depthWrite: false, side: DoubleSide })));
    this.jet.visible = false;
    this.probe.add(this.jet);

    const amber = solidMaterial({ colour: 0xffa028, metal: 0, softness: 0.4, glow: 0.55 });
    this.arrowShaft = new Mesh(new CylinderGeometry(1, 1, 1, 20).rotateX(Math.PI / 2).translate(0, 0, 0.5), amber);
    this.arrowHead = new Mesh(new ConeGeometry(1, 1, 28).rotateX(Math.PI / 2).translate(0, 0, 0.5), amber);
    this.arrow.add(this.arrowShaft, this.arrowHead);
    const blue = solidMaterial({ colour: 0x58d0ff, metal: 0, softness: 0.4, glow: 0.9 });
    this.contactMark = new Mesh(new SphereGeometry(1, 20, 14), blue);
    this.overlays.add(this.arrow, this.contactMark);
    this.group.add(this.probe, this.trocar, this.overlays);
    for (const part of [this.arrow, this.contactMark]) part.visible = false;
    this.pose(tool.home_tip_m, tool.home_shaft, 0, [0, 0, 0]);
    this.openJaws(tool.home_jaw);
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
    this.trocar.quaternion.copy(this.probe.quaternion);
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
    this.jet.visible = isRinsing(this.tool.kind, header);
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

  /** Tissue is so far ahead of the tip's centre: water goes no further. */
  endJet(ahead_m: number): void {
    this.jet.scale.z = Math.min(1, Math.max(ahead_m, this.tipRadius_m) / JET_M);
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
