/** Loose tissue that ties bodies to each other: two crossed ribbons along each strand, wider at its ends. */
import { BufferAttribute, BufferGeometry, DoubleSide, DynamicDrawUsage, Group, Mesh, Vector3 } from "three";
import { solidMaterial } from "./materials";
import { NUMBERS_OF_STRAND } from "./strands";

/** Half the width of a ribbon at its ends and in its middle [m]. */
const HALF_WIDTHS_M = [1.6e-3, 0.6e-3, 1.6e-3];
/** A strand goes so far on into the tissue at both ends [m], so that no gap is seen. */
const ROOT_M = 0.6e-3;
const RIBBONS = 2;
const POINTS = RIBBONS * 2 * HALF_WIDTHS_M.length;

export class StrandMarks {
  readonly group = new Group();
  private readonly material = solidMaterial({ colour: 0xe6c9a0, metal: 0, softness: 0.35 });
  private mesh: Mesh | null = null;
  private room = 0;
  private drawn = new Float32Array();

  constructor() {
    this.material.side = DoubleSide;
  }

  show(strands_m: Float32Array): void {
    if (strands_m.length === this.drawn.length && strands_m.every((x, i) => x === this.drawn[i])) return;
    this.drawn = Float32Array.from(strands_m);
    const n = strands_m.length / NUMBERS_OF_STRAND;
    const mesh = this.meshFor(n);
    const { position, normal } = mesh.geometry.attributes as Record<"position" | "normal", BufferAttribute>;
    for (let i = 0; i < n; i++) this.place(strands_m.subarray(NUMBERS_OF_STRAND * i), position, normal, POINTS * i);
    position.needsUpdate = true;
    normal.needsUpdate = true;
    mesh.geometry.setDrawRange(0, n * RIBBONS * (HALF_WIDTHS_M.length - 1) * 6);
  }

  private place(ends_m: Float32Array, position: BufferAttribute, normal: BufferAttribute, first: number): void {
    const [from, to] = [new Vector3().fromArray(ends_m), new Vector3().fromArray(ends_m, 3)];
    const along = to.clone().sub(from);
    if (along.lengthSq() < 1e-12) along.set(0, 0, 1e-4);
    along.normalize();
    from.addScaledVector(along, -ROOT_M);
    to.addScaledVector(along, ROOT_M);
    const aside = new Vector3(1, 0, 0).cross(along);
    if (aside.lengthSq() < 1e-3) aside.set(0, 1, 0).cross(along);
    aside.normalize();
    const other = along.clone().cross(aside);
    const at = new Vector3();
    let point = first;
    for (const [wide, out] of [[aside, other], [other, aside]] as const) {
      HALF_WIDTHS_M.forEach((half_m, k) => {
        for (const side of [-half_m, half_m]) {
          at.lerpVectors(from, to, k / (HALF_WIDTHS_M.length - 1)).addScaledVector(wide, side);
          position.setXYZ(point, at.x, at.y, at.z);
          normal.setXYZ(point, out.x, out.y, out.z);
          point += 1;
        }
      });
    }
  }

  /** A mesh with room for so many strands. */
  private meshFor(n: number): Mesh {
    if (this.mesh !== null && n <= this.room) return this.mesh;
    this.mesh?.geometry.dispose();
    this.group.clear();
    this.room = n;
    const geometry = new BufferGeometry();
    for (const name of ["position", "normal"]) {
      geometry.setAttribute(name, new BufferAttribute(new Float32Array(3 * POINTS * n), 3).setUsage(DynamicDrawUsage));
    }
    geometry.setIndex(indices(n));
    this.mesh = new Mesh(geometry, this.material);
    // It moves with the organs, whose bounds it does not know.
    this.mesh.frustumCulled = false;
    this.group.add(this.mesh);
    return this.mesh;
  }
}

/** Two triangles between each two pairs of points of a ribbon. */
function indices(nStrands: number): number[] {
  const list: number[] = [];
  for (let ribbon = 0; ribbon < RIBBONS * nStrands; ribbon++) {
    for (let k = 0; k < HALF_WIDTHS_M.length - 1; k++) {
      const a = 2 * (HALF_WIDTHS_M.length * ribbon + k);
      list.push(a, a + 1, a + 3, a, a + 3, a + 2);
    }
  }
  return list;
}
