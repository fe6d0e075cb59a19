/**
 * One studio for all shaders, and solids in it: soft boxes fixed to the camera, evaluated in closed form (no environment map to
 * download or to filter, cheap enough for drawing in software). Fresnel: Schlick, "An inexpensive BRDF model for
 * physically-based rendering", Computer Graphics Forum 13(3), 1994, doi 10.1111/1467-8659.1330233.
 *
 * Through an endoscope there is no studio: the lamp beside its lens, whose light falls off with the square of the distance, lights
 * everything (`theatre/lamp.ts`).
 */
import { Color, Vector3, type ShaderMaterial } from "three";
import { LAMP, withLampTwin } from "./theatre/lamp";

type Triple = readonly [number, number, number];
const glsl = (v: Vector3): string => `vec3(${v.toArray().map((x) => x.toFixed(5)).join(", ")})`;

/** A call of `softBox` for a box seen in direction `centre` (view space: +x right, +y up, +z to the viewer). */
function softBox(centre: Triple, halfSize: readonly [number, number]): string {
  const c = new Vector3(...centre).normalize();
  const right = new Vector3(0, 1, 0).cross(c).normalize();
  const up = c.clone().cross(right);
  return `softBox(d, ${glsl(c)}, ${glsl(right)}, ${glsl(up)}, vec2(${halfSize.map((x) => x.toFixed(3)).join(", ")}), w)`;
}

const KEY: Triple = [-0.404, 0.687, 0.604];
const FILL: Triple = [0.857, 0.214, 0.469];
const BACK: Triple = [0.12, 0.6, -0.79];

/** Also has `schlick`. */
export const STUDIO = /* glsl */ `
// A rectangular soft box seen in direction d, edge softness w.
float softBox(vec3 d, vec3 centre, vec3 right, vec3 up, vec2 halfSize, float w) {
  float facing = dot(d, centre);
  vec2 p = abs(vec2(dot(d, right), dot(d, up))) / max(facing, 0.05) - halfSize;
  vec2 inside = clamp(0.5 - 0.5 * p / w, 0.0, 1.0);
  inside = inside * inside * (3.0 - 2.0 * inside);
  return inside.x * inside.y * clamp(5.0 * facing, 0.0, 1.0);
}
vec3 studioReflection(vec3 d, float w) {
  vec3 light = mix(vec3(0.030, 0.028, 0.030), vec3(0.16, 0.19, 0.23), clamp(0.45 + 0.6 * d.y, 0.0, 1.0));
  light += vec3(4.6, 4.4, 4.1) * ${softBox(KEY, [0.34, 0.2])};
  light += vec3(1.5, 1.7, 2.1) * ${softBox(FILL, [0.12, 0.62])};
  light += vec3(0.5, 0.5, 0.55) * ${softBox(BACK, [0.8, 0.18])};
  return light;
}
vec3 studioDiffuse(vec3 n, vec3 wrap) {
  vec3 sky = mix(vec3(0.10, 0.085, 0.085), vec3(0.30, 0.33, 0.38), 0.5 + 0.5 * n.y);
  float key = dot(n, vec3(-0.404, 0.687, 0.604));
  float fill = dot(n, vec3(0.857, 0.214, 0.469));
  vec3 keyLight = max((vec3(key) + wrap) / (1.0 + wrap), 0.0);
  vec3 fillLight = max((vec3(fill) + wrap) / (1.0 + wrap), 0.0);
  return sky + vec3(1.75, 1.70, 1.60) * keyLight + vec3(0.26, 0.31, 0.40) * fillLight;
}
// f90: at grazing angles, 1 for a smooth surface and less for a rough one.
float schlick(float f0, float f90, float cosine) {
  float m = 1.0 - cosine;
  float m2 = m * m;
  return f0 + (f90 - f0) * m2 * m2 * m;
}
`;

const SOLID_VERTEX = /* glsl */ `
varying vec3 vViewNormal;
varying vec3 vViewPosition;
varying vec3 vLocal;
void main() {
  vec3 place = position;
  vec3 outward = normal;
#ifdef USE_INSTANCING
  mat3 axes = mat3(instanceMatrix);
  place = axes * place + instanceMatrix[3].xyz;
  outward = axes * (outward / vec3(dot(axes[0], axes[0]), dot(axes[1], axes[1]), dot(axes[2], axes[2])));
#endif
  vec4 inView = modelViewMatrix * vec4(place, 1.0);
  vViewNormal = normalMatrix * outward;
  vViewPosition = inView.xyz;
  vLocal = position;
  gl_Position = projectionMatrix * inView;
}
`;

const SOLID_FRAGMENT = /* glsl */ `
uniform vec3 colour;
uniform float metal;
uniform float softness;
uniform float bandSpacing;
uniform vec3 bandColour;
uniform float glow;
varying vec3 vViewNormal;
varying vec3 vViewPosition;
varying vec3 vLocal;
${STUDIO}
#ifdef IN_LAMP
${LAMP}
#endif
void main() {
  vec3 n = normalize(vViewNormal);
  vec3 v = normalize(-vViewPosition);
  float facing = clamp(dot(n, v), 0.0, 1.0);
  vec3 tint = colour;
  float soft = softness;
  if (bandSpacing > 0.0 && vLocal.z > 0.5 * bandSpacing) {
    // Depth marks on the shaft, one each bandSpacing.
    float place = vLocal.z / bandSpacing;
    float along = abs(fract(place + 0.5) - 0.5) * bandSpacing;
    // Each fifth mark is broader.
    float broader = step(abs(fract(place / 5.0 + 0.5) - 0.5) * 5.0, 0.5);
    float mark = 1.0 - smoothstep(0.0, 0.0002, along - 0.00025 - 0.0007 * broader);
    tint = mix(tint, bandColour, 0.85 * mark);
    soft += 0.25 * mark;
  }
#ifdef IN_LAMP
  vec3 lit = solidInLamp(tint, metal, soft, n, v, vViewPosition);
#else
  vec3 mirror = studioReflection(reflect(-v, n), soft);
  vec3 diffuse = tint * studioDiffuse(n, vec3(0.1));
  vec3 polished = mirror * mix(tint, vec3(1.0), schlick(0.0, 0.5, facing)) + 0.16 * diffuse;
  vec3 matte = diffuse + mirror * schlick(0.04, 1.0, facing);
  vec3 lit = mix(matte, polished, metal);
#endif
  gl_FragColor = vec4(lit + glow * tint, 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
}
`;

export interface SolidLook {
  readonly colour: number;
  /** 0 = matte, 1 = metal. */
  readonly metal: number;
  /** Blur of what it mirrors, 0.03 (polished) to 0.6. */
  readonly softness: number;
  /** Depth marks along local z. */
  readonly bands?: { readonly spacing_m: number; readonly colour: number };
  /** Own light, as a share of the colour. */
  readonly glow?: number;
}

export function solidMaterial(look: SolidLook): ShaderMaterial {
  return withLampTwin({
    vertexShader: SOLID_VERTEX,
    fragmentShader: SOLID_FRAGMENT,
    uniforms: {
      colour: { value: new Color(look.colour) },
      metal: { value: look.metal },
      softness: { value: look.softness },
      bandSpacing: { value: look.bands?.spacing_m ?? 0 },
      bandColour: { value: new Color(look.bands?.colour ?? 0) },
      glow: { value: look.glow ?? 0 },
    },
  });
}
