/**
 * The lamp of an endoscope in shaders: it shines from beside the lens, so that light and view nearly agree; its light falls off
 * with the square of the distance and towards the rim. Wet tissue mirrors it in small bright spots: a sharp lobe of the film and a
 * broad one of what is below, both of B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007
 * (GGX). What else shines is light that walls throw back, red. The looks are chosen by eye.
 */

import { followsDetail } from "../detail";
import { Matrix4, Mesh, ShaderMaterial, Vector2, Vector3, type Texture, type Object3D, type ShaderMaterialParameters } from "three";

/** Power of the lamp: irradiance at a metre. Shared by all materials. */
export const lampPower = { value: 0 };

/** Beside the lens, where its fibres end, in view space [m]. */
export const LAMP_AT_M = new Vector3(0, 0.0042, 0);

/** What the shaders know of the lamp's shadows (`shadow.ts`), in full detail. Shared by all materials. */
export const shadows = {
  depth: { value: null as Texture | null },
  fromView: { value: new Matrix4() },
  /** Nearest and furthest depth [m]. */
  range: { value: new Vector2(0, 1) },
};

/** The uniforms of {@link LAMP}. */
export const lampUniforms = { lamp: lampPower, shadowDepth: shadows.depth, shadowFromView: shadows.fromView, shadowRange: shadows.range };

const twins = new WeakMap<ShaderMaterial, ShaderMaterial>();

/**
 * A material with a twin for the lamp, of the same uniforms, whose shader is compiled with `IN_LAMP`. A condition in one shader would
 * cost both ways where the processor draws.
 */
export function withLampTwin(parameters: ShaderMaterialParameters): ShaderMaterial {
  const uniforms = { ...parameters.uniforms, ...lampUniforms };
  const material = new ShaderMaterial({ ...parameters, uniforms });
  const twin = new ShaderMaterial({ ...parameters, uniforms, defines: { IN_LAMP: "" } });
  twins.set(material, twin);
  for (const either of [material, twin]) followsDetail(either);
  material.addEventListener("dispose", () => twin.dispose());
  return material;
}

/** Draws with the lamp's light alone: `draw` sees every material's twin. */
export function inLampLight(scene: Object3D, draw: () => void): void {
  const swapped: Array<[Mesh, ShaderMaterial]> = [];
  scene.traverse((part) => {
    if (!(part instanceof Mesh) || !(part.material instanceof ShaderMaterial)) return;
    const twin = twins.get(part.material);
    if (twin === undefined) return;
    swapped.push([part, part.material]);
    part.material = twin;
  });
  draw();
  for (const [part, material] of swapped) part.material = material;
}

/** Needs `schlick`. Places and directions in view space. */
export const LAMP = /* glsl */ `
uniform float lamp;
const vec3 LAMP_AT = vec3(${LAMP_AT_M.toArray().map((x) => x.toFixed(4)).join(", ")});
const vec3 LAMP_COLOUR = vec3(1.0, 0.97, 0.93);
const vec3 THROWN_BACK = vec3(0.075, 0.026, 0.020);
#ifdef FULL_DETAIL
uniform sampler2D shadowDepth;
uniform mat4 shadowFromView;
uniform vec2 shadowRange;
// The share of its light that comes to a place [view space].
float unshadowed(vec3 p) {
  vec4 q = shadowFromView * vec4(p, 1.0);
  vec2 at = 0.5 + 0.5 * q.xy / q.w;
  float free = 0.0;
  for (int i = 0; i < 9; i++) {
    vec2 beside = vec2(float(i % 3) - 1.0, float(i / 3) - 1.0) * 0.0011;
    float depth = texture2D(shadowDepth, at + beside).r;
    float ahead = shadowRange.x * shadowRange.y / (shadowRange.y - depth * (shadowRange.y - shadowRange.x));
    free += step(q.w, ahead + 0.0012 + 0.004 * q.w);
  }
  return 0.12 + 0.88 * free / 9.0;
}
#endif
// Irradiance of a surface that faces it, and the direction to it.
float lampAt(vec3 p, out vec3 to) {
  vec3 way = LAMP_AT - p;
  float distance2 = dot(way, way);
  to = way * inversesqrt(distance2);
  float power = lamp * to.z * to.z / (distance2 + 2.5e-5);
#ifdef FULL_DETAIL
  power *= unshadowed(p);
#endif
  return power;
}
float lobe(float cosine, float roughness) {
  float a2 = roughness * roughness;
  float t = cosine * cosine * (a2 - 1.0) + 1.0;
  return a2 / (3.1416 * t * t);
}
vec3 wetInLamp(vec3 albedo, vec3 n, vec3 broad, vec3 v, vec3 p, float wet) {
  vec3 to;
  float power = lampAt(p, to);
  vec3 h = normalize(to + v);
  vec3 wrap = vec3(0.34, 0.16, 0.13);
  vec3 lit = max((vec3(dot(broad, to)) + wrap) / (1.0 + wrap), 0.0);
  float rim = 1.0 - clamp(dot(broad, v), 0.0, 1.0);
  vec3 colour = albedo * (power * LAMP_COLOUR * lit + 3.0 * THROWN_BACK);
  // Light that went into the tissue comes out redder where it is seen from the side.
  colour += power * vec3(0.030, 0.0035, 0.002) * rim * lit;
  float facing = clamp(dot(n, to), 0.0, 1.0);
  float film = lobe(clamp(dot(n, h), 0.0, 1.0), 0.085) * schlick(0.03, 0.8, facing) * wet;
  float below = lobe(clamp(dot(broad, h), 0.0, 1.0), 0.30) * 0.022;
  colour += power * LAMP_COLOUR * 0.25 * facing * (film + below);
  return colour + THROWN_BACK * schlick(0.03, 0.7, clamp(dot(n, v), 0.0, 1.0)) * wet;
}
vec3 solidInLamp(vec3 tint, float metal, float softness, vec3 n, vec3 v, vec3 p) {
  vec3 to;
  float power = lampAt(p, to);
  vec3 h = normalize(to + v);
  float facing = clamp(dot(n, to), 0.0, 1.0);
  float mirrored = lobe(clamp(dot(n, h), 0.0, 1.0), 0.10 + softness);
  vec3 matte = tint * (power * facing * 0.32 + 3.0 * THROWN_BACK) + power * 0.01 * mirrored * facing;
  // Metal shows the walls around it, dark and red, and the lamp.
  vec3 around = THROWN_BACK * (1.2 + 1.6 * n.y);
  vec3 polished = tint * (around + power * LAMP_COLOUR * (0.05 * facing + 0.075 * mirrored * facing));
  return mix(matte, polished, metal);
}
`;
