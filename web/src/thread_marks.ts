/** Threads in the picture: a tube along each, its needle of steel, and its clips; and the strands of attachments. */
import { CatmullRomCurve3, Group, Mesh, SphereGeometry, TubeGeometry, Vector3, type ShaderMaterial } from "three";
import type { Vec3 } from "./fields";
import { solidMaterial } from "./materials";
import { StrandMarks } from "./strand_marks";
import type { Thread } from "./threads";

/** What is thinner is not seen in a picture of an organ [m]. */
const LEAST_RADIUS_M = 0.35e-3;
/** A needle is so much thicker than its thread. */
const NEEDLE = 1.6;
const CLIP_RADIUS_M = 1.3e-3;
/** Sides of a tube. */
const SIDES = 8;

export class ThreadMarks {
  readonly group = new Group();
  readonly strands = new StrandMarks();
  private readonly tubes = new Group();
  private readonly violet = solidMaterial({ colour: 0x5a3fb0, metal: 0, softness: 0.3, glow: 0.2 });
  private readonly steel = solidMaterial({ colour: 0xd6dbe0, metal: 1, softness: 0.1 });
  private readonly clip = new SphereGeometry(CLIP_RADIUS_M, 16, 12);
  private drawn: readonly Thread[] = [];

  constructor() {
    this.group.add(this.tubes, this.strands.group);
  }

  show(threads: readonly Thread[]): void {
    if (JSON.stringify(threads) === JSON.stringify(this.drawn)) return;
    this.drawn = threads;
    for (const mesh of this.tubes.children as Mesh[]) if (mesh.geometry !== this.clip) mesh.geometry.dispose();
    this.tubes.clear();
    for (const thread of threads) {
      const radius_m = Math.max(thread.radius_m, LEAST_RADIUS_M);
      this.tube(thread.nodes_m.slice(0, thread.needleNodes), NEEDLE * radius_m, this.steel);
      this.tube(thread.nodes_m.slice(Math.max(0, thread.needleNodes - 1)), radius_m, this.violet);
      for (const place_m of thread.clips_m) {
        const clip = new Mesh(this.clip, this.steel);
        clip.position.set(...place_m);
        this.tubes.add(clip);
      }
    }
  }

  private tube(nodes_m: readonly Vec3[], radius_m: number, material: ShaderMaterial): void {
    if (nodes_m.length < 2) return;
    const curve = new CatmullRomCurve3(nodes_m.map((node) => new Vector3(...node)));
    this.tubes.add(new Mesh(new TubeGeometry(curve, 2 * nodes_m.length, radius_m, SIDES), material));
  }
}
