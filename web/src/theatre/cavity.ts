/** The inside of the abdomen behind the organ, seen through the endoscope alone: an egg of made-up walls that nothing touches. */
import { BackSide, Mesh, ShaderMaterial, SphereGeometry, Vector3, type Texture } from "three";
import type { Hello } from "../protocol";
import { LAMP, lampPower } from "./lamp";

/** An ellipsoid through the corners of a box is so much larger than the box. */
const THROUGH_CORNERS = Math.sqrt(3);
/** Between the box and the walls, for gas [m]. */
const ROOM_M = 0.02;

// Colour and folds in the corners, which are few: it fills the picture where the organ does not.
const VERTEX = /* glsl */ `
varying vec3 vView;
varying vec3 vNormal;
varying vec3 vAlbedo;
varying vec2 vAt;
// Soft folds: the slope of a few waves across each other.
vec3 folds(vec3 p) {
  vec3 q = p * 95.0 + 1.6 * sin(p.yzx * 61.0 + 0.7);
  return 0.24 * cos(q.yzx) * sin(q.zxy);
}
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vec3 p = world.xyz;
  vView = (viewMatrix * world).xyz;
  vNormal = normalize(-normalMatrix * normal) + (viewMatrix * vec4(folds(p), 0.0)).xyz;
  float patches = 0.5 + 0.5 * sin(37.0 * p.x + 2.0 * sin(29.0 * p.z)) * sin(33.0 * p.z + 1.3 * sin(41.0 * p.y));
  vAlbedo = mix(vec3(0.135, 0.032, 0.026), vec3(0.23, 0.088, 0.052), patches);
  vAt = vec2(10.0, 5.0) * uv;
  gl_Position = projectionMatrix * viewMatrix * world;
}
`;

const FRAGMENT = /* glsl */ `
uniform sampler2D tissue;
varying vec3 vView;
varying vec3 vNormal;
varying vec3 vAlbedo;
varying vec2 vAt;
float schlick(float f0, float f90, float cosine) {
  float m = 1.0 - cosine;
  float m2 = m * m;
  return f0 + (f90 - f0) * m2 * m2 * m;
}
${LAMP}
void main() {
  vec4 detail = texture2D(tissue, vAt);
  vec3 broad = normalize(vNormal);
  vec3 n = normalize(broad + 0.22 * vec3(detail.rg - 0.5, 0.0));
  gl_FragColor = vec4(wetInLamp(vAlbedo * (0.7 + 0.6 * detail.a), n, broad, normalize(-vView), vView, 0.5), 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
}
`;

export function newCavity(tissue: Texture): Mesh<SphereGeometry, ShaderMaterial> {
  const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, side: BackSide, uniforms: { lamp: lampPower, tissue: { value: tissue } } });
  const cavity = new Mesh(new SphereGeometry(1, 72, 54), material);
  cavity.visible = false;
  return cavity;
}

/** Puts the walls around a scene: its organs and the tips of its instruments at home. */
export function placeCavity(cavity: Mesh, { bounds, tools }: Hello): void {
  const min = new Vector3(...bounds.min_m);
  const max = new Vector3(...bounds.max_m);
  for (const { home_tip_m, optics } of tools) {
    if (optics === null) continue;
    min.min(new Vector3(...home_tip_m));
    max.max(new Vector3(...home_tip_m));
  }
  const half = max.clone().sub(min).multiplyScalar(0.5 * THROUGH_CORNERS);
  cavity.position.copy(min.add(max).multiplyScalar(0.5));
  cavity.scale.copy(half.addScalar(ROOM_M));
}
