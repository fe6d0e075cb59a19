/**
 * The picture behind an endoscope's lens: a circle in which straight lines bend outwards, and where its points look. Radii are
 * shares of the circle's. With the distortion `k`, what a lens without it would show at `ru` is shown at `rd`:
 *
 *     ru = rd (1 - k) / (1 - k rd^2)
 *
 * the division model of A. W. Fitzgibbon, "Simultaneous linear estimation of multiple view geometry and lens distortion", CVPR
 * 2001, scaled so that the edge stays where it is. One pass over the picture bends it, darkens its rim and smears it.
 */
import {
  AdditiveBlending,
  BufferAttribute,
  BufferGeometry,
  HalfFloatType,
  Mesh,
  NoBlending,
  OrthographicCamera,
  Scene,
  ShaderMaterial,
  Vector2,
  Vector3,
  WebGLRenderTarget,
  type Texture,
  type WebGLRenderer,
} from "three";
import type { Ray } from "../drag";
import type { Eye } from "./endoscope";

/** Distortion unless the page's address says otherwise: a choice. Laparoscopes: 7 to 23 % (doi 10.1089/end.2012.0140). */
export const USUAL_DISTORTION = 0.12;
export const MOST_DISTORTION = 0.3;
/** Rays of places further out than this many radii are those at it. */
const FURTHEST_RADIUS = 1.4;

/** The circle of the picture on the canvas [CSS pixels from its upper left corner]. */
export interface Circle {
  readonly x: number;
  readonly y: number;
  readonly radius: number;
}

export function straightened(radius: number, distortion: number): number {
  return (radius * (1 - distortion)) / (1 - distortion * radius * radius);
}

/** The inverse of {@link straightened}. */
export function bent(radius: number, distortion: number): number {
  const linear = 1 - distortion;
  return (2 * radius) / (linear + Math.sqrt(linear * linear + 4 * distortion * radius * radius));
}

export function isInCircle(x: number, y: number, circle: Circle): boolean {
  return Math.hypot(x - circle.x, y - circle.y) <= circle.radius;
}

/** The ray through a place of the canvas. */
export function rayThrough(x: number, y: number, circle: Circle, eye: Eye, distortion: number): Ray {
  const [a, b] = [(x - circle.x) / circle.radius, (circle.y - y) / circle.radius];
  const radius = Math.hypot(a, b);
  const share = radius === 0 ? 0 : straightened(Math.min(radius, FURTHEST_RADIUS), distortion) / radius;
  const tangent = share * Math.tan(eye.field_of_view_rad / 2);
  const direction = eye.forward.clone().addScaledVector(eye.right, a * tangent).addScaledVector(eye.up, b * tangent);
  return { origin: eye.position_m.clone(), direction: direction.normalize() };
}

/** Where a point is seen on the canvas; not finite behind the eye. */
export function seenAt(point_m: Vector3, circle: Circle, eye: Eye, distortion: number): [number, number] {
  const to = point_m.clone().sub(eye.position_m);
  const ahead = to.dot(eye.forward);
  if (!(ahead > 0)) return [NaN, NaN];
  const scale = 1 / (ahead * Math.tan(eye.field_of_view_rad / 2));
  const [a, b] = [to.dot(eye.right) * scale, to.dot(eye.up) * scale];
  const radius = Math.hypot(a, b);
  const share = radius === 0 ? 0 : (bent(radius, distortion) / radius) * circle.radius;
  return [circle.x + a * share, circle.y - b * share];
}

const VERTEX = /* glsl */ `
void main() {
  gl_Position = vec4(position.xy, 0.0, 1.0);
}
`;

const FRAGMENT = /* glsl */ `
uniform sampler2D picture;
uniform vec2 centre;
uniform float radius;
uniform float distortion;
uniform float smear;
uniform vec3 channels;
vec2 straight(vec2 p) {
  return 0.5 + 0.5 * p * (1.0 - distortion) / (1.0 - distortion * dot(p, p));
}
#ifdef SMEARED
// How thick the film on the lens is, 0 to 1: streaks of a few waves.
float film(vec2 p) {
  float a = sin(3.1 * p.x + 1.7 * p.y + 0.6) * sin(2.3 * p.y - 1.1 * p.x + 1.9);
  float b = sin(7.3 * p.x - 4.1 * p.y + 2.2) * sin(6.1 * p.y + 5.3 * p.x);
  return clamp(0.72 + 0.34 * a + 0.16 * b, 0.0, 1.0);
}
vec3 smeared(vec2 p) {
  float thick = smear * film(p);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 24; i++) {
    float t = (float(i) + 0.5) / 24.0;
    float turn = 2.399963 * float(i);
    sum += texture2D(picture, straight(p + 0.17 * thick * sqrt(t) * vec2(cos(turn), sin(turn)))).rgb;
  }
  vec3 blurred = sum / 24.0;
  float bright = dot(blurred, vec3(0.3, 0.5, 0.2));
  return mix(blurred, vec3(0.42, 0.055, 0.04) * (0.3 + 1.4 * bright), 0.62 * thick);
}
#endif
void main() {
  vec2 p = (gl_FragCoord.xy - centre) / radius;
  float r = length(p);
  vec3 colour = vec3(0.0);
  if (r < 1.0) {
#ifdef SMEARED
    vec3 seen = smeared(p);
#else
    vec3 seen = texture2D(picture, straight(p)).rgb;
#endif
    float rim = smoothstep(0.35, 1.0, r);
    float edge = smoothstep(1.0, 1.0 - 3.0 / radius - 0.006, r);
    colour = edge * seen * (1.0 - 0.5 * rim * rim);
  }
  gl_FragColor = vec4(colour, 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
  // For coloured glasses as light and dark alone: what is red is black through cyan.
  if (channels.r + channels.g + channels.b < 2.5) gl_FragColor.rgb = channels * dot(gl_FragColor.rgb, vec3(0.35, 0.5, 0.15));
}
`;

const ALL_COLOURS = [1, 1, 1] as const;

/** Draws a square picture through the lens onto the canvas. */
export class LensPass {
  readonly target: WebGLRenderTarget;
  private readonly clear: ShaderMaterial;
  /** A condition in one shader would cost both ways where the processor draws. */
  private readonly smeared: ShaderMaterial;
  private readonly triangle: Mesh;
  private readonly scene = new Scene();
  private readonly camera = new OrthographicCamera();

  constructor(samples: number, distortion: number) {
    this.target = new WebGLRenderTarget(1, 1, { type: HalfFloatType, samples });
    const parameters = {
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      depthTest: false,
      depthWrite: false,
      uniforms: {
        picture: { value: this.target.texture as Texture },
        centre: { value: new Vector2() },
        radius: { value: 1 },
        distortion: { value: distortion },
        smear: { value: 0 },
        channels: { value: new Vector3(1, 1, 1) },
      },
    };
    this.clear = new ShaderMaterial(parameters);
    this.smeared = new ShaderMaterial({ ...parameters, defines: { SMEARED: "" } });
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
    this.triangle = new Mesh(geometry, this.clear);
    this.triangle.frustumCulled = false;
    this.scene.add(this.triangle);
  }

  /** So many pixels to a CSS pixel of the circle. */
  fit(circle: Circle, ratio: number): void {
    const side = Math.max(16, Math.round(2 * circle.radius * ratio));
    if (this.target.width !== side) this.target.setSize(side, side);
  }

  /** Draws the target's picture; `height` of the canvas in CSS pixels. As a second picture, into its colours of the first one or beside it. */
  draw(renderer: WebGLRenderer, circle: Circle, height: number, smear: number, channels: readonly [number, number, number] = ALL_COLOURS, isSecond = false): void {
    const ratio = renderer.getPixelRatio();
    this.triangle.material = smear > 0 ? this.smeared : this.clear;
    const { uniforms } = this.clear;
    (uniforms.centre.value as Vector2).set(circle.x * ratio, (height - circle.y) * ratio);
    uniforms.radius.value = circle.radius * ratio;
    uniforms.smear.value = smear;
    (uniforms.channels.value as Vector3).set(...channels);
    for (const material of [this.clear, this.smeared]) {
      material.blending = isSecond ? AdditiveBlending : NoBlending;
      material.transparent = isSecond;
    }
    // Nothing is computed beside the circle.
    if (!isSecond) {
      renderer.setClearColor(0x000000, 1);
      renderer.clear();
    }
    renderer.setScissorTest(true);
    renderer.setScissor(circle.x - circle.radius, height - circle.y - circle.radius, 2 * circle.radius, 2 * circle.radius);
    renderer.autoClear = !isSecond;
    renderer.render(this.scene, this.camera);
    renderer.autoClear = true;
    renderer.setScissorTest(false);
  }

  dispose(): void {
    this.target.dispose();
    this.clear.dispose();
    this.smeared.dispose();
  }
}
