/** Open ends of vessels: dark red drops where blood comes out. */
import { Group, Mesh, SphereGeometry, type ShaderMaterial } from "three";
import type { BleedingEnd } from "./blood";
import { solidMaterial } from "./materials";

/** Flow and diameter of a portal vein (`world/vessels.rs`): the flow of a vessel goes with the cube of its diameter. */
const PORTAL_FLOW_M3_PER_S = (13.5e-6 * 73) / 60;
const PORTAL_DIAMETER_M = 15.5e-3;
/** A smaller drop is not seen [m]. */
const SMALLEST_RADIUS_M = 1.5e-3;

/** Diameter of the vessel that bleeds at this rate [m]. */
export function vesselDiameter_m(rate_m3_per_s: number): number {
  return PORTAL_DIAMETER_M * Math.cbrt(Math.max(rate_m3_per_s, 0) / PORTAL_FLOW_M3_PER_S);
}

export class BleedingMarks {
  readonly group = new Group();
  private readonly drops: Mesh[] = [];
  private readonly shape = new SphereGeometry(1, 20, 14);
  private readonly material: ShaderMaterial = solidMaterial({ colour: 0xa00010, metal: 0, softness: 0.05, glow: 0.25 });

  show(ends: readonly BleedingEnd[]): void {
    while (this.drops.length < ends.length) {
      const drop = new Mesh(this.shape, this.material);
      this.drops.push(drop);
      this.group.add(drop);
    }
    this.drops.forEach((drop, i) => {
      drop.visible = i < ends.length;
      if (!drop.visible) return;
      drop.position.set(...ends[i].position_m);
      drop.scale.setScalar(Math.max(0.5 * vesselDiameter_m(ends[i].rate_m3_per_s), SMALLEST_RADIUS_M));
    });
  }
}
