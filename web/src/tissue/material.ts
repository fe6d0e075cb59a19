/**
 * The shader of organs: wrapped diffuse light with a reddened terminator, two specular lobes (the wet film, sharp; the capsule below
 * it, broad), a pale sheen at grazing angles (Glisson's capsule), and generated patterns that are fixed to the rest shape, so that
 * they move with the tissue. In full detail vessels, lobules and the grain of cut faces show. The looks are chosen by eye.
 */
import { Vector3, Vector4, type ShaderMaterial, type Texture } from "three";
import type { Burn } from "../field/burns";
import { STUDIO } from "../materials";
import { LAMP, withLampTwin } from "../theatre/lamp";

const VARYINGS = /* glsl */ `
varying vec3 vWorld;
varying vec3 vNormal;
varying vec3 vRest;
varying vec3 vRestNormal;
varying float vTone;
varying float vInside;
varying float vBurnt;
varying vec4 vDark;
varying vec4 vLight;
varying vec4 vPaint;
`;

const VERTEX = /* glsl */ `
attribute vec3 restPosition;
attribute vec3 restNormal;
attribute float tone;
attribute float inside;
attribute float burnt;
// Colour, and how much vessels show.
attribute vec4 darkLook;
// Colour, and how much lobules show.
attribute vec4 lightLook;
// Colour that a legend explains, and whether it shows.
attribute vec4 paint;
${VARYINGS}void main() {
  vWorld = position;
  vNormal = normal;
  vRest = restPosition;
  vRestNormal = restNormal;
  vTone = tone;
  vInside = inside;
  vBurnt = burnt;
  vDark = darkLook;
  vLight = lightLook;
  vPaint = paint;
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}
`;

/** So many of the latest burns are drawn sharply in full detail. */
export const MOST_SHARP_BURNS = 48;

const FRAGMENT = /* glsl */ `
uniform sampler2D tissue;
uniform sampler2D patterns;
// What lies on its side is not shown.
uniform vec4 cutPlane;
uniform vec3 toolTip;
uniform vec3 toolShaft;
uniform float toolRadius;
uniform float toolLength;
${VARYINGS}${STUDIO}
#ifdef IN_LAMP
${LAMP}
#endif
#ifdef FULL_DETAIL
// Where hot instruments were, at rest, and radii; and how much they burnt.
uniform vec4 burns[${MOST_SHARP_BURNS}];
uniform float burnAmounts[${MOST_SHARP_BURNS}];
uniform int nBurns;
float heatAt(vec3 rest) {
  float most = 0.0;
  for (int i = 0; i < ${MOST_SHARP_BURNS}; i++) {
    if (i >= nBurns) break;
    most = max(most, burnAmounts[i] * min(1.0, 1.6 - 1.6 * distance(rest, burns[i].xyz) / burns[i].w));
  }
  return most;
}
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
  if (dot(vWorld, cutPlane.xyz) > cutPlane.w) discard;
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
  float patches = clamp(0.62 * vTone + 0.38 * detail.a, 0.0, 1.0);
  vec3 albedo = mix(vDark.rgb, vLight.rgb, smoothstep(0.12, 0.88, patches));
  albedo *= 0.80 + 0.40 * detail.b;
  // Where it was cut there is no capsule: lighter, grainier, bloody; fat stays fat.
  float raw = smoothstep(0.05, 0.6, vInside);
  vec3 open = mix(vec3(0.17, 0.019, 0.014), vLight.rgb * vec3(0.9, 0.62, 0.55), vLight.a * vLight.a);
  float wet = mix(0.75, 1.15, detail.a);

#ifdef FULL_DETAIL
  vec3 fine = vRest * 62.0;
  vec4 px = texture2D(patterns, fine.yz);
  vec4 py = texture2D(patterns, fine.xz + 0.43);
  vec4 pz = texture2D(patterns, fine.xy + 0.17);
  vec4 pattern = weights.x * px + weights.y * py + weights.z * pz;
  // The same larger: broad vessels, and lobules of fat.
  vec3 wide = 0.37 * fine;
  vec4 larger = weights.x * texture2D(patterns, wide.yz) + weights.y * texture2D(patterns, wide.xz) + weights.z * texture2D(patterns, wide.xy);
  pattern.g = mix(pattern.g, larger.g, vLight.a * vLight.a);
  float vessels = vDark.a * (1.0 - raw) * smoothstep(0.3, 0.85, max(larger.r, 0.55 * pattern.r));
  albedo = mix(albedo, vec3(0.17, 0.012, 0.012), 0.72 * vessels);
  // Lobules: a darker border around each, and a bulge.
  float lobules = vLight.a * (1.0 - 0.6 * raw);
  albedo *= mix(vec3(1.0), vec3(0.72, 0.5, 0.42), lobules * (1.0 - 0.5 * lobules) * (1.0 - smoothstep(0.0, 0.75, pattern.g)));
  vec2 bx = px.ba - 0.5;
  vec2 by = py.ba - 0.5;
  vec2 bz = pz.ba - 0.5;
  slope += (0.9 * lobules * lobules + 1.1 * raw) * (weights.x * vec3(0.0, bx) + weights.y * vec3(by.x, 0.0, by.y) + weights.z * vec3(bz, 0.0));
  // A cut face: grains of tissue, mouths of small vessels, blood that lies in it.
  float mouths = smoothstep(0.80, 0.90, pattern.g) * smoothstep(0.5, 0.62, detail.a);
  open *= (0.62 + 0.75 * pattern.g) * (0.72 + 0.6 * detail.a);
  open = mix(open, vec3(0.055, 0.002, 0.004), 0.85 * mouths);
  wet *= 1.0 + 0.9 * raw;
  // The cut edge of the capsule is pale.
  float edge = smoothstep(0.02, 0.08, vInside) * (1.0 - smoothstep(0.12, 0.26, vInside));
  albedo = mix(albedo, mix(open, vec3(0.36, 0.20, 0.16), 0.7 * edge), max(raw, 0.8 * edge));
#else
  albedo = mix(albedo, open * (0.55 + 0.9 * detail.a), raw);
#endif
  // Burnt: blanched, then brown, then black, and dry.
#ifdef FULL_DETAIL
  float heat = nBurns > 0 ? heatAt(vRest) * (0.55 + 0.9 * detail.a) : 0.0;
#else
  float heat = vBurnt * (0.7 + 0.6 * detail.a);
#endif
  if (heat > 0.0) {
    albedo = mix(albedo, vec3(0.19, 0.115, 0.075), 0.7 * smoothstep(0.06, 0.2, heat));
    albedo = mix(albedo, vec3(0.085, 0.034, 0.012), smoothstep(0.22, 0.42, heat));
    albedo = mix(albedo, vec3(0.009, 0.007, 0.006), smoothstep(0.45, 0.75, heat));
    wet *= 1.0 - 0.85 * smoothstep(0.15, 0.5, heat);
  }

  vec3 smoothNormal = normalize(vNormal);
  vec3 world = normalize(smoothNormal - 0.30 * (slope - smoothNormal * dot(slope, smoothNormal)));
  vec3 n = normalize((viewMatrix * vec4(world, 0.0)).xyz);
  vec3 broad = normalize((viewMatrix * vec4(mix(smoothNormal, world, 0.4), 0.0)).xyz);
  vec3 v = normalize(cameraPosition - vWorld);
  v = (viewMatrix * vec4(v, 0.0)).xyz;
  float facing = clamp(dot(broad, v), 0.0, 1.0);
  float rim = 1.0 - facing;
  float unshaded = shade(vWorld, smoothNormal);

#ifdef IN_LAMP
  vec3 colour = unshaded * wetInLamp(albedo, n, broad, v, (viewMatrix * vec4(vWorld, 1.0)).xyz, wet);
#else
  vec3 light = studioDiffuse(broad, vec3(0.42, 0.20, 0.17));
  vec3 colour = albedo * light * unshaded;
  // Light that comes back through the thin rim of the tissue.
  colour += vec3(0.040, 0.005, 0.0035) * rim * rim * unshaded;

  vec3 film = studioReflection(reflect(-v, n), 0.10);
  vec3 capsule = studioReflection(reflect(-v, broad), 0.42);
  colour += film * schlick(0.030, 0.6, clamp(dot(n, v), 0.0, 1.0)) * wet * unshaded;
  colour += (1.0 - 0.8 * raw) * capsule * schlick(0.022, 0.35, facing) * vec3(0.85, 0.88, 0.95) * 0.45 * unshaded;
  colour += vec3(0.34, 0.37, 0.43) * rim * rim * rim * rim * 0.16 * clamp(0.35 + 0.65 * broad.y, 0.0, 1.0) * unshaded;
#endif

  if (vPaint.a > 0.5) {
    // Shaded, but of the same hue in any light.
    gl_FragColor = vec4(vPaint.rgb * (0.62 + 0.38 * facing), 1.0);
  } else {
    gl_FragColor = vec4(colour, 1.0);
    #include <tonemapping_fragment>
  }
  #include <colorspace_fragment>
}
`;

function tissueMaterial(uniforms: ShaderMaterial["uniforms"]): ShaderMaterial {
  return withLampTwin({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
}

/** A plane beyond which nothing is. */
const newCutPlane = () => ({ value: new Vector4(0, 0, 0, 1) });

export function organMaterial(tissue: Texture, patterns: Texture): ShaderMaterial {
  return tissueMaterial({
    tissue: { value: tissue },
    patterns: { value: patterns },
    cutPlane: newCutPlane(),
    burns: { value: Array.from({ length: MOST_SHARP_BURNS }, () => new Vector4()) },
    burnAmounts: { value: new Float32Array(MOST_SHARP_BURNS) },
    nBurns: { value: 0 },
    toolTip: { value: new Vector3(0, 0, 10) },
    toolShaft: { value: new Vector3(0, 0, 1) },
    toolRadius: { value: 0.005 },
    toolLength: { value: 0.3 },
  });
}

/** The same for what stays whole while organs are cut open for the eye. */
export function uncutMaterial({ uniforms }: ShaderMaterial): ShaderMaterial {
  return tissueMaterial({ ...uniforms, cutPlane: newCutPlane() });
}

/** Shows burns: the latest ones. */
export function setBurns({ uniforms }: ShaderMaterial, burns: readonly Burn[]): void {
  const latest = burns.slice(-MOST_SHARP_BURNS);
  uniforms.nBurns.value = latest.length;
  latest.forEach(({ rest_m, radius_m, amount }, i) => {
    (uniforms.burns.value as Vector4[])[i].set(rest_m.x, rest_m.y, rest_m.z, radius_m);
    (uniforms.burnAmounts.value as Float32Array)[i] = amount;
  });
}
