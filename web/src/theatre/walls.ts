/**
 * The inside of the abdomen around the scene, seen through the endoscope alone: an egg of made-up walls that nothing touches, blown
 * up by gas. Towards the head the diaphragm with its pale middle; ribs show through; elsewhere the peritoneum with its vessels.
 */
import { BackSide, Box3, Mesh, ShaderMaterial, SphereGeometry, Vector3, type Texture } from "three";
import { followsDetail } from "../detail";
import type { Hello } from "../protocol";
import { LAMP, lampUniforms } from "./lamp";
import type { Ray } from "../drag";

/** An ellipsoid through the corners of a box is so much larger than the box. */
const THROUGH_CORNERS = Math.sqrt(3);
/** Between the box and the walls, for gas [m]. */
const ROOM_M = 0.02;
/** Half the axes of an abdomen at least, to the left, to the back, to the head [m]: a small scene lies in one of usual size. */
const LEAST_HALF_M = [0.15, 0.105, 0.15] as const;

/** Colour and slope of a place of the walls: `side` is where on the egg, 1 at the patient's left, back, head; `detail` is noise. */
const WALL = /* glsl */ `
// Soft folds: the slope of a few waves across each other.
vec3 folds(vec3 p) {
  vec3 q = p * 95.0 + 1.6 * sin(p.yzx * 61.0 + 0.7);
  return cos(q.yzx) * sin(q.zxy);
}
void wall(vec3 at, vec3 side, float coarse, float vessel, out vec3 albedo, out vec3 slope) {
  // Ribs run from the back down to the front; between them and below are muscle and peritoneum.
  float along = (at.z + 0.45 * at.y + 0.007 * sin(23.0 * at.x + 1.0) + 0.010 * (coarse - 0.5)) / 0.031;
  float across = abs(fract(along) - 0.5);
  float chest = smoothstep(0.10, 0.34, side.z + 0.25 * abs(side.x)) * smoothstep(0.16, 0.36, abs(side.x) + 0.15) * (1.0 - smoothstep(0.1, 0.5, side.y)) * (1.0 - smoothstep(0.55, 0.8, side.z));
  float rib = chest * smoothstep(0.33, 0.20, across);
  float diaphragm = smoothstep(0.30, 0.62, side.z);
  float tendon = smoothstep(0.88, 0.97, side.z + 0.05 * (coarse - 0.5));
  float fibres = 0.5 + 0.5 * sin(46.0 * atan(side.y, side.x) + 3.0 * coarse);
  vec3 peritoneum = mix(vec3(0.15, 0.046, 0.034), vec3(0.26, 0.115, 0.075), smoothstep(0.2, 0.8, coarse));
  vec3 muscle = mix(vec3(0.105, 0.019, 0.014), vec3(0.20, 0.045, 0.032), 0.5 * coarse + 0.5 * fibres);
  albedo = mix(peritoneum, muscle, max(0.8 * diaphragm, 0.3 * chest * smoothstep(0.2, 0.45, across)));
  albedo = mix(albedo, vec3(0.29, 0.165, 0.125), 0.42 * rib);
  albedo = mix(albedo, vec3(0.30, 0.185, 0.15), 0.7 * tendon);
  albedo = mix(albedo, vec3(0.14, 0.014, 0.013), 0.6 * vessel * (1.0 - 0.5 * rib));
  // The bulge of a rib turns the normal about its length.
  slope = 0.22 * folds(at) + chest * 0.42 * smoothstep(0.44, 0.24, across) * sin(6.2832 * (fract(along) - 0.5)) * vec3(0.0, 0.41, 0.91);
}
`;

// Without full detail all that is in the corners, which are few: the walls fill the picture where the organ does not.
const VERTEX = /* glsl */ `
varying vec3 vView;
varying vec3 vNormal;
#ifdef FULL_DETAIL
varying vec3 vAt;
varying vec3 vSide;
#else
varying vec3 vAlbedo;
varying vec2 vUv;
${WALL}
#endif
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vView = (viewMatrix * world).xyz;
  vNormal = normalMatrix * -normal;
#ifdef FULL_DETAIL
  vAt = world.xyz;
  vSide = position;
#else
  vec3 p = world.xyz;
  float patches = 0.5 + 0.5 * sin(37.0 * p.x + 2.0 * sin(29.0 * p.z)) * sin(33.0 * p.z + 1.3 * sin(41.0 * p.y));
  vec3 slope;
  wall(p, position, patches, 0.0, vAlbedo, slope);
  vNormal = normalize(vNormal) + (viewMatrix * vec4(slope, 0.0)).xyz;
  vUv = vec2(10.0, 5.0) * uv;
#endif
  gl_Position = projectionMatrix * viewMatrix * world;
}
`;

const FRAGMENT = /* glsl */ `
uniform sampler2D tissue;
uniform sampler2D patterns;
varying vec3 vView;
varying vec3 vNormal;
#ifdef FULL_DETAIL
varying vec3 vAt;
varying vec3 vSide;
${WALL}
#else
varying vec3 vAlbedo;
varying vec2 vUv;
#endif
float schlick(float f0, float f90, float cosine) {
  float m = 1.0 - cosine;
  float m2 = m * m;
  return f0 + (f90 - f0) * m2 * m2 * m;
}
${LAMP}
void main() {
#ifdef FULL_DETAIL
  vec3 side = normalize(vSide);
  vec3 w = side * side;
  w *= w;
  w /= w.x + w.y + w.z;
  vec3 at = 9.0 * vAt;
  vec4 detail = w.x * texture2D(tissue, at.yz) + w.y * texture2D(tissue, at.xz) + w.z * texture2D(tissue, at.xy);
  float vessel = w.x * texture2D(patterns, 2.2 * at.yz).r + w.y * texture2D(patterns, 2.2 * at.xz).r + w.z * texture2D(patterns, 2.2 * at.xy).r;
  vec3 albedo, slope;
  wall(vAt, side, detail.a, vessel, albedo, slope);
  vec3 broad = normalize(normalize(vNormal) + (viewMatrix * vec4(slope, 0.0)).xyz);
#else
  vec4 detail = texture2D(tissue, vUv);
  vec3 albedo = vAlbedo;
  vec3 broad = normalize(vNormal);
#endif
  albedo *= 0.75 + 0.5 * detail.b;
  vec3 n = normalize(broad + 0.22 * vec3(detail.rg - 0.5, 0.0));
  gl_FragColor = vec4(wetInLamp(albedo, n, broad, normalize(-vView), vView, 0.42), 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
}
`;

/** The walls as they are around a unit ball; not shown yet. */
export function newWalls(tissue: Texture, patterns: Texture): Mesh<SphereGeometry, ShaderMaterial> {
  const uniforms = { ...lampUniforms, tissue: { value: tissue }, patterns: { value: patterns } };
  const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, side: BackSide, uniforms });
  followsDetail(material);
  const walls = new Mesh(new SphereGeometry(1, 80, 60).rotateZ(Math.PI / 2), material);
  // What is hidden by all else costs nothing.
  walls.renderOrder = 3;
  walls.visible = false;
  return walls;
}

/** What the walls are around: the organs of a scene, and the tips of its endoscopes at home. */
export function roomOf({ bounds, tools }: Hello): Box3 {
  const room = new Box3(new Vector3(...bounds.min_m), new Vector3(...bounds.max_m));
  for (const { home_tip_m, optics } of tools) if (optics !== null) room.expandByPoint(new Vector3(...home_tip_m));
  return room;
}

/** An ellipsoid. */
export interface Abdomen {
  readonly middle_m: Vector3;
  readonly half_m: Vector3;
}

/** The egg around a scene. */
export function abdomenOf(hello: Hello): Abdomen {
  const room = roomOf(hello);
  const half_m = room.getSize(new Vector3()).multiplyScalar(0.5 * THROUGH_CORNERS).addScalar(ROOM_M).max(new Vector3(...LEAST_HALF_M));
  return { middle_m: room.getCenter(new Vector3()), half_m };
}

/** Puts the walls around a scene. */
export function placeWalls(walls: Mesh, hello: Hello): void {
  const { middle_m, half_m } = abdomenOf(hello);
  walls.position.copy(middle_m);
  walls.scale.copy(half_m);
}

/** How far along a ray from inside they are. */
export function distanceToWalls_m({ position, scale }: Mesh, { origin, direction }: Ray): number {
  const [from, way] = [origin.clone().sub(position).divide(scale), direction.clone().divide(scale)];
  const [a, b, c] = [way.lengthSq(), from.dot(way), from.lengthSq() - 1];
  return c < 0 ? (Math.sqrt(b * b - a * c) - b) / a : Infinity;
}
