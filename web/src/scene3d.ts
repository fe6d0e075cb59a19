/** The three-dimensional picture: renderer, camera, organs, instrument. It draws only when asked to. */
import {
  ACESFilmicToneMapping,
  PerspectiveCamera,
  Raycaster,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
  type ShaderMaterial,
} from "three";
import { BleedingMarks } from "./bleeding";
import { ClassMarks } from "./class_marks";
import { ClipMarks } from "./clip_marks";
import { OperatingField } from "./field/field";
import { ContactMarks } from "./contact_marks";
import { isFull, setFullDetail, type DetailChoice } from "./detail";
import type { PushStart, Ray, ToolPose, ViewAxes } from "./drag";
import type { Feel } from "./feel";
import { pickTriangle, type Pick } from "./geometry";
import { InsidePicture } from "./inside/picture";
import { Instrument } from "./instrument";
import { patternTexture, tissueTexture } from "./noise";
import { organMaterial } from "./tissue/material";
import { looksOf } from "./tissue/looks";
import { TaskMarks } from "./task_marks";
import { ThreadMarks } from "./thread_marks";
import { cameraPosition, FIELD_OF_VIEW_DEG, orbitThatShows, viewAxes, type Orbit } from "./orbit";
import { Organ, type SurfaceStyle } from "./organ";
import { REST_AFTER_MS, REST_RATIO } from "./resolution";
import type { Hello, Snapshot, SnapshotHeader, Topology } from "./protocol";
import { savedPicture } from "./saved_picture";

/** Another view than the orbiting one from outside. Places on the canvas in CSS pixels; null where there is none yet. */
export interface OtherView {
  /** Whether a place of the canvas shows the scene. */
  shows(x: number, y: number): boolean;
  ray(x: number, y: number): Ray | null;
  project(point_m: Vector3): [number, number] | null;
  middle(): [number, number];
  axes(): ViewAxes | null;
  /** From where the view from outside would show things as large. */
  readonly distance_m: number;
  draw(): void;
}

export interface OrganPick extends Pick {
  readonly organ: number;
}

/** Sharper than this costs more than it shows. */
const LARGEST_PIXEL_RATIO = 2;

/** True if WebGL is drawn by the processor (SwiftShader, llvmpipe, the basic Windows adapter). */
function drawsInSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (gl === null) throw new Error("the browser gives no WebGL 2");
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(info === null ? gl.RENDERER : info.UNMASKED_RENDERER_WEBGL));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

export class Scene3d {
  readonly renderer: WebGLRenderer;
  readonly camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 0.005, 10);
  readonly software: boolean;
  readonly organs = new Map<number, Organ>();
  instruments: Instrument[] = [];
  /** Number of the instrument in the hand. */
  chosen = 0;
  orbit: Orbit;
  /** What a headset looks through, while it shows the scene. */
  inHeadset: PerspectiveCamera | null = null;
  /** Drawn in place of the view from outside. */
  other: OtherView | null = null;
  readonly contactMarks = new ContactMarks();
  readonly taskMarks = new TaskMarks();
  readonly classMarks = new ClassMarks();
  readonly scene = new Scene();
  readonly inside: InsidePicture;
  readonly field: OperatingField;
  private readonly bleeding = new BleedingMarks();
  private readonly threads = new ThreadMarks();
  private readonly clips = new ClipMarks();
  /** Noise of what is made up of tissue. */
  readonly tissue = tissueTexture();
  readonly patterns = patternTexture();
  /** Of all tissue. */
  readonly material: ShaderMaterial;
  private hello: Hello | null = null;
  private style: SurfaceStyle = "surface";
  private fixedShown = false;
  /** Bodies that are not shown, by their numbers. */
  private hidden: ReadonlySet<number> = new Set();
  /** What the page covers of the canvas [CSS pixels]. */
  covered = { left: 0, right: 0, bottom: 0, top: 0 };
  private restTimer: ReturnType<typeof setTimeout> | undefined;

  /** @throws Error if the browser gives no WebGL 2. */
  constructor(readonly canvas: HTMLCanvasElement) {
    this.software = drawsInSoftware();
    // In software, multisampling doubles the cost of each frame; there the picture is drawn finer once it rests.
    this.renderer = new WebGLRenderer({
      canvas,
      antialias: !this.software,
      alpha: true,
      powerPreference: "high-performance",
    });
    this.renderer.toneMapping = ACESFilmicToneMapping;
    this.renderer.toneMappingExposure = 1.08;
    this.renderer.setClearColor(0x000000, 0);
    this.material = organMaterial(this.tissue, this.patterns);
    this.inside = new InsidePicture(this.material);
    this.field = new OperatingField(this.material);
    const { bleeding, contactMarks, taskMarks, classMarks, threads, clips, field } = this;
    this.scene.add(this.inside.group, ...[bleeding, contactMarks, taskMarks, classMarks, threads, clips, field].map((part) => part.group));
    this.camera.up.set(0, 0, 1);
    this.orbit = orbitThatShows(new Vector3(-0.1, -0.1, -0.1), new Vector3(0.1, 0.1, 0.1), 1);
    this.resize();
  }

  get width(): number {
    return Math.max(1, this.canvas.clientWidth);
  }

  get height(): number {
    return Math.max(1, this.canvas.clientHeight);
  }

  resize(): void {
    this.renderer.setPixelRatio(this.software ? 1 : Math.min(window.devicePixelRatio, LARGEST_PIXEL_RATIO));
    this.renderer.setSize(this.width, this.height, false);
    this.camera.aspect = this.width / this.height;
    this.placeCamera();
  }

  /** The page covers so many pixels at the left, at the right, at the bottom and at the top: the organ is centred in what is free. */
  setCovered(left: number, right = 0, bottom = 0, top = 0): void {
    const { width, height } = this;
    this.covered = {
      left: Math.min(left, 0.6 * width),
      right: Math.min(right, 0.3 * width),
      bottom: Math.min(bottom, (top > 0 ? 0.4 : 0.6) * height),
      top: Math.min(top, 0.4 * height),
    };
  }

  /** Middle of the free part of the canvas [CSS pixels]. */
  middle(): [number, number] {
    return this.other?.middle() ?? [(this.width + this.covered.left - this.covered.right) / 2, (this.height - this.covered.bottom + this.covered.top) / 2];
  }

  setOrbit(orbit: Orbit): void {
    this.orbit = orbit;
    this.placeCamera();
  }

  resetView(): void {
    const bounds = this.hello?.bounds;
    if (bounds === undefined) return;
    const { left, right, bottom, top } = this.covered;
    const free_px = this.height - bottom - top;
    const orbit = orbitThatShows(new Vector3(...bounds.min_m), new Vector3(...bounds.max_m), (this.width - left - right) / free_px);
    this.setOrbit({ ...orbit, distance_m: (orbit.distance_m * this.height) / free_px });
  }

  private placeCamera(): void {
    this.camera.position.copy(cameraPosition(this.orbit));
    this.camera.lookAt(this.orbit.target_m);
    this.camera.near = Math.max(0.004, 0.02 * this.orbit.distance_m);
    this.camera.far = this.orbit.distance_m + 3;
    const { left, right, bottom, top } = this.covered;
    // Calls updateProjectionMatrix.
    this.camera.setViewOffset(this.width, this.height, (right - left) / 2, (bottom - top) / 2, this.width, this.height);
    this.camera.updateMatrixWorld();
  }

  /** A new scene: everything of the old one goes; the view is kept if the organ's box is the same. */
  begin(hello: Hello): void {
    const same = JSON.stringify(this.hello?.bounds) === JSON.stringify(hello.bounds);
    this.hello = hello;
    for (const organ of this.organs.values()) {
      this.scene.remove(organ.group);
      organ.dispose();
    }
    this.organs.clear();
    this.field.begin(hello);
    for (const instrument of this.instruments) {
      this.scene.remove(instrument.group);
      instrument.dispose();
    }
    this.instruments = hello.tools.map((tool) => new Instrument(tool));
    for (const instrument of this.instruments) this.scene.add(instrument.group);
    this.choose(0);
    if (!same) this.resetView();
    this.shadeByTool();
  }

  setTopology(topology: Topology): void {
    const old = this.organs.get(topology.organ);
    if (old !== undefined) {
      this.scene.remove(old.group);
      old.dispose();
    }
    const organ = new Organ(topology, new Set(this.hello?.fixed_nodes ?? []), this.material, looksOf(this.hello?.bodies ?? [], this.hello?.scene.material ?? ""));
    this.inside.cutMarks(organ);
    organ.hide(this.hidden);
    organ.setStyle(this.style);
    organ.showFixed(this.fixedShown);
    this.organs.set(topology.organ, organ);
    if (topology.organ === 0) this.field.adopt(organ);
    this.taskMarks.setTopology(topology);
    this.classMarks.setTopology(topology);
    this.scene.add(organ.group);
  }

  /** Takes over a snapshot: whether it changed the organ, or belongs to another topology. @throws ProtocolError */
  show(snapshot: Snapshot): "changed" | "same" | "other_topology" {
    const organ = this.organs.get(snapshot.header.organ);
    if (organ === undefined || organ.topology.version !== snapshot.header.version) return "other_topology";
    const isColoured = this.inside.show(snapshot.header.inside, organ);
    const moved = organ.show(snapshot);
    if (moved) {
      this.taskMarks.follow(organ.positions_m);
      this.classMarks.follow(organ.positions_m);
    }
    const lives = snapshot.header.organ === 0 && this.field.take(snapshot.header, organ);
    return isColoured || moved || lives ? "changed" : "same";
  }

  showTools(header: SnapshotHeader): void {
    this.instruments.forEach((instrument, i) => {
      const tool = header.tools[i];
      if (tool !== undefined) instrument.show(tool);
      if (instrument.jet.visible) instrument.endJet(this.ahead_m(instrument));
    });
    this.bleeding.show(header.bleeding?.ends ?? []);
    this.threads.show(header.threads);
    this.threads.strands.show(header.strands_m);
    this.clips.show(header.clips, this.organs.get(0) ?? null);
    this.shadeByTool();
  }

  /** How far ahead of an instrument's tip tissue is; not finite where none is. */
  private ahead_m(instrument: Instrument): number {
    const hits = [...this.organs.values()].map(({ positions_m, triangles }) => pickTriangle(instrument.tip(), instrument.shaft().negate(), positions_m, triangles));
    return Math.min(...hits.map((hit) => hit?.distance_m ?? Infinity));
  }

  /** Hands hold instruments as devices: their force is what the arrows show from the next picture on. */
  feel(feel: Feel): void {
    for (const { tool, force_n } of feel.hands) this.instruments[tool]?.feels(force_n);
  }

  styleTools(arrowScale_m_per_n: number, forces: boolean, contactMark: boolean): void {
    for (const instrument of this.instruments) {
      instrument.arrowScale_m_per_n = arrowScale_m_per_n;
      instrument.setForces(forces);
      instrument.setContactMark(contactMark);
    }
  }

  /** The instrument in the hand; null before a scene. */
  get instrument(): Instrument | null {
    return this.instruments[this.chosen] ?? null;
  }

  /** Takes another instrument into the hand: the organ is shaded by it. */
  choose(tool: number): void {
    const info = this.hello?.tools[tool];
    if (info === undefined) return;
    this.chosen = tool;
    this.material.uniforms.toolLength.value = info.shaft_length_m;
    this.shadeByTool();
  }

  /** The organ lies in the shade of the instrument in the hand, unless `isBright`. */
  shadeByTool(isBright = false): void {
    if (this.instrument === null) return;
    const info = this.hello?.tools[this.chosen];
    this.material.uniforms.toolRadius.value = isBright || info === undefined ? 0 : Math.max(info.shaft_radius_m, info.tip_radius_m);
    (this.material.uniforms.toolTip.value as Vector3).copy(this.instrument.tip());
    (this.material.uniforms.toolShaft.value as Vector3).copy(this.instrument.shaft());
  }

  setStyle(style: SurfaceStyle): void {
    this.style = style;
    for (const organ of this.organs.values()) organ.setStyle(style);
  }

  /** Hides bodies by their numbers. */
  hide(hidden: ReadonlySet<number>): void {
    this.hidden = hidden;
    for (const organ of this.organs.values()) organ.hide(hidden);
  }

  setDetail(choice: DetailChoice): void {
    setFullDetail(isFull(choice, this.software));
  }

  showFixed(shown: boolean): void {
    this.fixedShown = shown;
    for (const organ of this.organs.values()) organ.showFixed(shown);
  }

  /** The ray into the scene through a point of the canvas [CSS pixels from its upper left corner]. */
  ray(x: number, y: number): Ray {
    const ray = this.other?.ray(x, y);
    if (ray != null) return ray;
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * x) / this.width - 1, 1 - (2 * y) / this.height), this.camera);
    return { origin: caster.ray.origin.clone(), direction: caster.ray.direction.clone() };
  }

  /** The organ's first front triangle under a point of the canvas. */
  pick(x: number, y: number): OrganPick | null {
    if (this.other?.shows(x, y) === false) return null;
    const { origin, direction } = this.ray(x, y);
    let best: OrganPick | null = null;
    for (const [organ, { positions_m, triangles }] of this.organs) {
      const pick = pickTriangle(origin, direction, positions_m, triangles);
      if (pick !== null && (best === null || pick.distance_m < best.distance_m)) best = { ...pick, organ };
    }
    return best;
  }

  /** What a push at a place of the canvas needs to know, and the vertex picked there; null beside the organ. */
  pushStart(x: number, y: number, by = this.chosen): (PushStart & { readonly vertex: number }) | null {
    const pick = this.pick(x, y);
    const tool = this.hello?.tools[by];
    if (pick === null || tool === undefined) return null;
    return { hit_m: pick.point_m, normal: pick.normal, tipRadius_m: tool.tip_radius_m, view: this.axes(), vertex: pick.vertex };
  }

  /** Where an instrument is shown; null if there is none of that number. */
  pose(tool: number): ToolPose | null {
    const instrument = this.instruments[tool];
    return instrument === undefined ? null : { tip_m: instrument.tip(), shaft: instrument.shaft() };
  }

  /** How an instrument is turned about its shaft, as shown [rad]. */
  roll_rad(tool: number): number {
    return this.instruments[tool]?.roll_rad ?? 0;
  }

  /** Where a point of the scene is on the canvas [CSS pixels from its upper left corner]. */
  project(point_m: Vector3): [number, number] {
    const seen = this.other?.project(point_m);
    if (seen != null) return seen;
    const p = point_m.clone().project(this.camera);
    return [((p.x + 1) / 2) * this.width, ((1 - p.y) / 2) * this.height];
  }

  /** From where the view from outside shows things as large as they are shown [m]. */
  get distance_m(): number {
    return this.other?.distance_m ?? this.orbit.distance_m;
  }

  axes(): ViewAxes {
    return this.other?.axes() ?? viewAxes(this.orbit);
  }

  /** Draws; when the processor draws, with `softwareRatio` pixels to a CSS pixel. */
  render(softwareRatio: number): void {
    if (this.inHeadset !== null) return this.renderer.render(this.scene, this.inHeadset);
    if (this.software && this.renderer.getPixelRatio() !== softwareRatio) {
      this.renderer.setPixelRatio(softwareRatio);
      this.renderer.setSize(this.width, this.height, false);
    }
    if (this.other === null) this.renderer.render(this.scene, this.camera);
    else this.other.draw();
  }

  /** When the processor draws: a finer picture once nothing has changed for a while. */
  renderFinerAtRest(hasChanged: () => boolean): void {
    if (!this.software) return;
    clearTimeout(this.restTimer);
    this.restTimer = setTimeout(() => {
      if (!hasChanged()) this.render(REST_RATIO);
    }, REST_AFTER_MS);
  }

  /** The picture as PNG: background, scene, and `overlay` in its lower right corner. */
  async picture(overlay: HTMLCanvasElement): Promise<Blob> {
    this.render(REST_RATIO);
    return savedPicture(this.canvas, this.width, overlay);
  }
}
