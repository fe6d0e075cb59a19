/** The drops and puddles of `blood_flow.ts` as they are drawn: flat caps that overlap to a film. */
import { DynamicDrawUsage, Group, InstancedMesh, Matrix4, SphereGeometry, Vector3 } from "three";
import { solidMaterial } from "../materials";
import { dropRadius_m, normalOf, PUDDLE_DEPTH_M, puddleRadius_m, type BloodFlow } from "./blood_flow";
import { placeIn } from "../on_surface";

/** Instances at most: drops and puddles. */
const MOST = 440;
/** Height of a drop to its radius, and how much longer one is that runs. */
const FLAT = 0.34;
const STRETCHED = 1.7;

export class BloodView {
  readonly group = new Group();
  private readonly drops: InstancedMesh;
  private readonly puddles: InstancedMesh;

  constructor() {
    const blood = solidMaterial({ colour: 0x7a0609, metal: 0, softness: 0.03 });
    this.drops = new InstancedMesh(new SphereGeometry(1, 12, 8), blood, MOST);
    this.puddles = new InstancedMesh(new SphereGeometry(1, 40, 10), blood, 16);
    for (const mesh of [this.drops, this.puddles]) {
      mesh.count = 0;
      mesh.frustumCulled = false;
      mesh.instanceMatrix.setUsage(DynamicDrawUsage);
      this.group.add(mesh);
    }
    this.showGround(false);
  }

  /** Puddles lie on scenery, and are shown with it. */
  showGround(shown: boolean): void {
    this.puddles.visible = shown;
  }

  show(flow: BloodFlow | null, positions_m: Float32Array, down: Vector3): void {
    const [matrix, at, across] = [new Matrix4(), new Vector3(), new Vector3()];
    const drops = flow?.drops.slice(0, MOST) ?? [];
    drops.forEach(({ place, volume_m3, way }, i) => {
      const normal = normalOf(positions_m, place);
      // Along where it runs; else along the slope, so that stains make streaks.
      const along = (way !== null && way.lengthSq() > 0 ? way.clone() : down.clone()).addScaledVector(normal, -normal.dot(way ?? down));
      if (along.lengthSq() < 1e-6) along.set(normal.y, normal.z, normal.x).addScaledVector(normal, -normal.dot(along));
      along.normalize();
      across.crossVectors(normal, along);
      const radius = dropRadius_m(volume_m3);
      const isSmall = radius < 2e-3;
      matrix.makeBasis(along.multiplyScalar(radius * (isSmall ? STRETCHED : 1.15)), across.multiplyScalar(radius), normal.multiplyScalar(FLAT * radius));
      this.drops.setMatrixAt(i, matrix.setPosition(placeIn(positions_m, place, at)));
    });
    this.drops.count = drops.length;
    const puddles = flow?.puddles ?? [];
    puddles.forEach((puddle, i) => {
      const up = down.clone().negate();
      const along = new Vector3(up.y, up.z, up.x).addScaledVector(up, -up.dot(new Vector3(up.y, up.z, up.x))).normalize();
      across.crossVectors(up, along);
      const radius = Math.max(puddleRadius_m(puddle), 1e-3);
      matrix.makeBasis(along.multiplyScalar(radius), across.multiplyScalar(0.82 * radius), up.multiplyScalar(1.5 * PUDDLE_DEPTH_M));
      this.puddles.setMatrixAt(i, matrix.setPosition(puddle.middle_m));
    });
    this.puddles.count = puddles.length;
    for (const mesh of [this.drops, this.puddles]) mesh.instanceMatrix.needsUpdate = true;
  }
}
