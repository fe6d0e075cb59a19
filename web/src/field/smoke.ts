/**
 * Smoke where hot instruments are: puffs that rise against gravity, spread, and fade, in the time of the simulation; suction takes
 * them in. For the eye alone; numbers are bounded.
 */
import { BufferAttribute, BufferGeometry, DynamicDrawUsage, NormalBlending, Points, ShaderMaterial, Vector3 } from "three";
import { latticeValue } from "../noise";
import { lampPower } from "../theatre/lamp";

const MOST_PUFFS = 72;
const EVERY_S = 0.07;
const LIFE_S = 3.2;
const RISE_M_PER_S = 0.028;
/** Radius of a puff when it comes, and by how much it grows [m, m/s]. */
const RADIUS_M = 0.003;
const GROWS_M_PER_S = 0.007;

/** Suction takes in smoke that is so near to its tip [m]: there it is gone so much sooner. Choices. */
const SUCKED_M = 0.025;
const SOONER = 12;

interface Puff {
  readonly at_m: Vector3;
  readonly drift_m_per_s: Vector3;
  age_s: number;
}

const VERTEX = /* glsl */ `
attribute float radius;
attribute float thick;
uniform float height;
uniform float lamp;
varying float vThick;
varying float vLight;
void main() {
  vec4 inView = modelViewMatrix * vec4(position, 1.0);
  gl_Position = projectionMatrix * inView;
  gl_PointSize = min(height * projectionMatrix[1][1] * radius / max(-inView.z, 0.002), 0.6 * height);
  // What is at the lens itself is no puff any more.
  vThick = thick * smoothstep(0.004, 0.02, -inView.z);
  vLight = lamp > 0.0 ? clamp(lamp / (dot(inView.xyz, inView.xyz) + 4e-4) * 0.16, 0.05, 1.1) : 0.55;
}
`;

const FRAGMENT = /* glsl */ `
varying float vThick;
varying float vLight;
void main() {
  vec2 p = 2.0 * gl_PointCoord - 1.0;
  float soft = 1.0 - dot(p, p);
  if (soft <= 0.0) discard;
  gl_FragColor = vec4(vLight * vec3(0.80, 0.79, 0.77), vThick * soft * soft);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
}
`;

export class Smoke {
  readonly points: Points<BufferGeometry, ShaderMaterial>;
  private puffs: Puff[] = [];
  private since_s = 0;
  private nPuffs = 0;

  constructor() {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * MOST_PUFFS), 3).setUsage(DynamicDrawUsage));
    for (const name of ["radius", "thick"]) geometry.setAttribute(name, new BufferAttribute(new Float32Array(MOST_PUFFS), 1).setUsage(DynamicDrawUsage));
    const uniforms = { height: { value: 1 }, lamp: lampPower };
    const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms, transparent: true, depthWrite: false, blending: NormalBlending });
    this.points = new Points(geometry, material);
    this.points.frustumCulled = false;
    this.points.renderOrder = 8;
    // Points are as large as the picture that they are drawn into says.
    this.points.onBeforeRender = (renderer) => {
      material.uniforms.height.value = renderer.getRenderTarget()?.height ?? renderer.domElement.height;
    };
    this.clear();
  }

  get count(): number {
    return this.puffs.length;
  }

  clear(): void {
    this.puffs = [];
    this.fill();
  }

  /** So much time has gone by, tissue smokes at these places, and smoke is sucked away at those. */
  advance(dt_s: number, sources_m: readonly Vector3[], down: Vector3, sucked_m: readonly Vector3[] = []): void {
    if (this.puffs.length === 0 && sources_m.length === 0) return;
    for (const puff of this.puffs) {
      const isSucked = sucked_m.some((at_m) => at_m.distanceTo(puff.at_m) < SUCKED_M);
      puff.age_s += isSucked ? SOONER * dt_s : dt_s;
      puff.at_m.addScaledVector(puff.drift_m_per_s, dt_s);
    }
    this.puffs = this.puffs.filter(({ age_s }) => age_s < LIFE_S);
    this.since_s += dt_s;
    if (this.since_s >= EVERY_S) {
      this.since_s = 0;
      for (const source of sources_m) this.puff(source, down);
    }
    this.fill();
  }

  private puff(source: Vector3, down: Vector3): void {
    const n = this.nPuffs++;
    const random = (axis: number): number => 2 * latticeValue(n, axis, 77) - 1;
    const drift = down.clone().multiplyScalar(-RISE_M_PER_S * (1 + 0.4 * random(0)));
    drift.add(new Vector3(random(1), random(2), random(3)).multiplyScalar(0.3 * RISE_M_PER_S));
    this.puffs.push({ at_m: source.clone(), drift_m_per_s: drift, age_s: 0 });
    if (this.puffs.length > MOST_PUFFS) this.puffs.shift();
  }

  private fill(): void {
    const { geometry } = this.points;
    const [position, radius, thick] = ["position", "radius", "thick"].map((name) => geometry.getAttribute(name) as BufferAttribute);
    this.puffs.forEach(({ at_m, age_s }, i) => {
      at_m.toArray(position.array, 3 * i);
      radius.setX(i, RADIUS_M + GROWS_M_PER_S * age_s);
      thick.setX(i, 0.3 * Math.min(1, age_s / 0.15) * (1 - age_s / LIFE_S) ** 1.5);
    });
    for (const attribute of [position, radius, thick]) attribute.needsUpdate = true;
    geometry.setDrawRange(0, this.puffs.length);
    this.points.visible = this.puffs.length > 0;
  }
}
