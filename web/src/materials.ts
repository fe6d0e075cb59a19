/**
 * Shaders with one studio for all: soft boxes fixed to the camera, evaluated in closed form (no environment map to
 * download or to filter, cheap enough for drawing in software).
 *
 * Organ: wrapped diffuse light with a reddened terminator, two specular lobes (the wet film, sharp; the capsule below
 * it, broad), a pale sheen at grazing angles (Glisson's capsule) and generated noise fixed to the rest shape.
 * Fresnel: Schlick, "An inexpensive BRDF model for physically-based rendering", Computer Graphics Forum 13(3), 1994,
 * doi 10.1111/1467-8659.1330233. The looks are chosen by eye; no optical measurement stands behind them.
 *
 * Through an endoscope there is no studio: the lamp beside its lens, whose light falls off with the square of the distance, lights
 * everything (`theatre/lamp.ts`).
 */
import { Color, ShaderMaterial, Vector3, type Texture } from "three";
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

const STUDIO = /* glsl */ `
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

const ORGAN_VERTEX = /* glsl */ `
attribute vec3 restPosition;
attribute vec3 restNormal;
attribute float tone;
attribute float inside;
attribute vec4 paint;
varying vec4 vPaint;
varying vec3 vWorld;
varying vec3 vNormal;
varying vec3 vRest;
varying vec3 vRestNormal;
varying float vTone;
varying float vInside;
void main() {
  vWorld = position;
  vNormal = normal;
  vRest = restPosition;
  vRestNormal = restNormal;
  vTone = tone;
  vInside = inside;
  vPaint = paint;
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}
`;

const ORGAN_FRAGMENT = /* glsl */ `
uniform sampler2D tissue;
uniform vec3 toolTip;
uniform vec3 toolShaft;
uniform float toolRadius;
uniform float toolLength;
varying vec3 vWorld;
varying vec3 vNormal;
varying vec3 vRest;
varying vec3 vRestNormal;
varying float vTone;
varying float vInside;
varying vec4 vPaint;
${STUDIO}
#ifdef IN_LAMP
${LAMP}
#endif
// Light that the instrument's shaft takes away (a capsule from the tip along the shaft).
float shade(vec3 p, vec3 n) {
  vec3 q = p - toolTip;
  float along = clamp(dot(q, toolShaft), 0.0, toolLength);
  vec3 to = along * toolShaft - q;
  float distance2 = max(dot(to, to), 1e-9);
  float facing = clamp(dot(n, to) * inversesqrt(distance2) + 0.25, 0.0, 1.0);
  return 1.0 - 0.72 * facing * clamp(1.9 * toolRadius * toolRadius / distance2, 0.0, 1.0);
}
void main() {
  vec3 weights = abs(normalize(vRestNormal));
  weights = weights * weights * weights;
  weights /= weights.x + weights.y + weights.z;
  vec3 at = vRest * 21.0;
  vec4 tx = texture2D(tissue, at.yz);
  vec4 ty = texture2D(tissue, at.xz + 0.37);
  vec4 tz = texture2D(tissue, at.xy + 0.71);
  vec4 detail = weights.x * tx + weights.y * ty + weights.z * tz;
  vec2 sx = tx.rg - 0.5;
  vec2 sy = ty.rg - 0.5;
  vec2 sz = tz.rg - 0.5;
  vec3 slope = weights.x * vec3(0.0, sx) + weights.y * vec3(sy.x, 0.0, sy.y) + weights.z * vec3(sz, 0.0);

  vec3 smoothNormal = normalize(vNormal);
  vec3 world = normalize(smoothNormal - 0.30 * (slope - smoothNormal * dot(slope, smoothNormal)));
  vec3 n = normalize((viewMatrix * vec4(world, 0.0)).xyz);
  vec3 broad = normalize((viewMatrix * vec4(mix(smoothNormal, world, 0.4), 0.0)).xyz);
  vec3 v = normalize(cameraPosition - vWorld);
  v = (viewMatrix * vec4(v, 0.0)).xyz;
  float facing = clamp(dot(broad, v), 0.0, 1.0);
  float rim = 1.0 - facing;

  float patches = clamp(0.62 * vTone + 0.38 * detail.a, 0.0, 1.0);
  vec3 albedo = mix(vec3(0.054, 0.0125, 0.0105), vec3(0.128, 0.0315, 0.0225), smoothstep(0.12, 0.88, patches));
  albedo *= 0.80 + 0.40 * detail.b;
  // A body with a colour of its own keeps the light and dark of the tissue, as far as the paint covers it.
  albedo = mix(albedo, vPaint.rgb * (0.75 + 0.5 * patches), vPaint.a);
  // Where it was cut there is no capsule: lighter, grainier, bloody.
  float raw = smoothstep(0.05, 0.6, vInside);
  albedo = mix(albedo, vec3(0.23, 0.030, 0.022) * (0.55 + 0.9 * detail.a), raw);
  float open = shade(vWorld, smoothNormal);

#ifdef IN_LAMP
  vec3 colour = open * wetInLamp(albedo, n, broad, v, (viewMatrix * vec4(vWorld, 1.0)).xyz, mix(0.75, 1.15, detail.a));
#else
  vec3 light = studioDiffuse(broad, vec3(0.42, 0.20, 0.17));
  vec3 colour = albedo * light * open;
  // Light that comes back through the thin rim of the tissue.
  colour += vec3(0.040, 0.005, 0.0035) * rim * rim * open;

  vec3 film = studioReflection(reflect(-v, n), 0.10);
  vec3 capsule = studioReflection(reflect(-v, broad), 0.42);
  colour += film * schlick(0.030, 0.6, clamp(dot(n, v), 0.0, 1.0)) * mix(0.75, 1.15, detail.a) * open;
  colour += (1.0 - 0.8 * raw) * capsule * schlick(0.022, 0.35, facing) * vec3(0.85, 0.88, 0.95) * 0.45 * open;
  colour += vec3(0.34, 0.37, 0.43) * rim * rim * rim * rim * 0.16 * clamp(0.35 + 0.65 * broad.y, 0.0, 1.0) * open;
#endif

  gl_FragColor = vec4(colour, 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
}
`;

const SOLID_VERTEX = /* glsl */ `
varying vec3 vViewNormal;
varying vec3 vViewPosition;
varying vec3 vLocal;
void main() {
  vec4 inView = modelViewMatrix * vec4(position, 1.0);
  vViewNormal = normalMatrix * normal;
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

export function organMaterial(tissue: Texture): ShaderMaterial {
  return withLampTwin({
    vertexShader: ORGAN_VERTEX,
    fragmentShader: ORGAN_FRAGMENT,
    uniforms: {
      tissue: { value: tissue },
      toolTip: { value: new Vector3(0, 0, 10) },
      toolShaft: { value: new Vector3(0, 0, 1) },
      toolRadius: { value: 0.005 },
      toolLength: { value: 0.3 },
    },
    polygonOffset: true,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: 1,
  });
}

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
