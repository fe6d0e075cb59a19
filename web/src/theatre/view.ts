/**
 * The theatre view: what the endoscope shows, as a circle on the canvas, and in a corner the picture from outside. Camera and lamp
 * are at the endoscope's tip as the last snapshot has it. A lens that touches tissue is smeared until it is wiped.
 */
import { PerspectiveCamera, Vector3, type Mesh, type Object3D } from "three";
import { isFullDetail } from "../detail";
import type { Ray, ViewAxes } from "../drag";
import { FIELD_OF_VIEW_DEG, viewAxes } from "../orbit";
import type { OperatingField } from "../field/field";
import type { Page } from "../page";
import type { Hello, SnapshotHeader, ToolInfo } from "../protocol";
import type { OtherView, Scene3d } from "../scene3d";
import { eyeOf, type Eye } from "./endoscope";
import { inLampLight, lampPower } from "./lamp";
import { uncutMaterial } from "../tissue/material";
import { Scenery } from "./scenery";
import { LampShadow } from "./shadow";
import { distanceToWalls_m, newWalls, placeWalls } from "./walls";
import { throughLens, type Stereo } from "./stereo";
import { isInCircle, LensPass, MOST_DISTORTION, rayThrough, seenAt, USUAL_DISTORTION, type Circle } from "./lens";

/** Of the endoscope's camera [m]: tissue at the lens is seen, and the far side of an abdomen. */
const NEAR_M = 5e-4;
const FAR_M = 2;
/** Contact this much further from the tip's centre than its radius is at the lens [m]; further up it is at the shaft. */
const AT_LENS_M = 1.5e-3;
/** A circle smaller than this lies over the panel instead of beside it [CSS pixels]. */
const SMALLEST_RADIUS = 150;
const RIM = 10;
/** Irradiance of the organ at 10 cm, in the picture's own measure. */
const EXPOSURE = 2.3;
/** The camera makes up for a part of what distance takes, as cameras of endoscopes do: exponent of the distance, 2 for all of it. */
const MADE_UP = 1.75;
const NEAREST_EXPOSED_M = 0.005;
const FURTHEST_EXPOSED_M = 0.3;
/** Places of the circle whose distance sets the exposure. */
const METERED: ReadonlyArray<readonly [number, number]> = [[0, 0], [0.4, 0], [-0.4, 0], [0, 0.4], [0, -0.4]];
/** Pixels of a smeared picture to CSS pixels. */
const SMEARED_RATIO = 0.1;
/** How much further away the picture from outside is taken than the laboratory view. */
const FURTHER_OUT = 0.5;
const HALF_DEGREE_RAD = Math.PI / 360;
const DEEP_RED = 0x0d0303;
const OUTSIDE = 0x141c23;

/** What tests read. */
export interface TheatreReport {
  readonly on: boolean;
  /** Number of the endoscope; null for a scene without. */
  readonly endoscope: number | null;
  readonly smear: number;
  readonly outside: boolean;
  readonly field: ReturnType<OperatingField["report"]>;
  /** Whether the falciform ligament is before the liver. */
  readonly ligament: boolean;
  readonly stereo: Stereo;
  readonly second_px: number;
  /** The picture's circle on the canvas [CSS pixels]. */
  readonly circle: Circle;
  /** Of the camera that draws it, in the patient frame. */
  readonly camera: { readonly position_m: number[]; readonly forward: number[]; readonly up: number[]; readonly field_of_view_rad: number };
}

/** Distortion of the lens as the page's address asks for it, `?distortion=0.2`. */
export function distortionOf(search: string): number {
  const asked = new URLSearchParams(search).get("distortion");
  const share = asked === null ? USUAL_DISTORTION : Number(asked);
  return share >= 0 && share <= MOST_DISTORTION ? share : USUAL_DISTORTION;
}

export class Theatre implements OtherView {
  /** Number of the endoscope; null for a scene without. */
  endoscope: number | null = null;
  smear = 0;
  private isDark = false;
  private metered_m = FURTHEST_EXPOSED_M;
  /** Whether the picture from outside is beside that of the endoscope. */
  outside = true;
  /** Whether scenes with an endoscope begin with its picture, where the page's address does not say. */
  beginsOn = false;
  private eye: Eye | null = null;
  private pictures: Stereo = "off";
  /** The right eye's picture is so far beside the left one [CSS pixels]; 0 where there is no other. */
  private second_px = 0;
  private circle: Circle = { x: 0, y: 0, radius: 1 };
  private hello: Hello | null = null;
  private readonly camera = new PerspectiveCamera(70, 1, NEAR_M, FAR_M);
  private readonly outsideCamera = new PerspectiveCamera();
  private readonly walls: Mesh;
  private readonly scenery: Scenery;
  private readonly lens: LensPass;
  private readonly shadow = new LampShadow();
  private readonly distortion = distortionOf(window.location.search);

  constructor(
    private readonly scene: Scene3d,
    private readonly page: Pick<Page, "panel" | "toolbar" | "orientation" | "hint" | "outside"> & Partial<Pick<Page, "task">>,
  ) {
    this.lens = new LensPass(scene.software ? 0 : 4, this.distortion);
    this.walls = newWalls(scene.tissue, scene.patterns);
    this.scenery = new Scenery(uncutMaterial(scene.material));
    scene.scene.add(this.walls, this.scenery.group);
  }

  get stereo(): Stereo {
    return this.pictures;
  }

  set stereo(stereo: Stereo) {
    this.pictures = stereo;
    this.layOut();
  }

  get on(): boolean {
    return this.scene.other === this;
  }

  /** The endoscope; null for a scene without. */
  get info(): ToolInfo | null {
    return (this.endoscope === null ? null : this.hello?.tools[this.endoscope]) ?? null;
  }

  /** A scene: the view stays as it is where that has an endoscope too, and begins with what the page's address asks for. */
  begin(hello: Hello, chosen: number): void {
    const isFirst = this.hello === null;
    this.hello = hello;
    this.eye = null;
    this.choose(chosen);
    placeWalls(this.walls, hello);
    this.scenery.begin(hello);
    const view = new URLSearchParams(window.location.search).get("view");
    const asked = isFirst && (view === null ? this.beginsOn : view === "theatre");
    this.turn((this.on || asked) && this.endoscope !== null);
  }

  /** Of several endoscopes the one in the hand shows, else the first. */
  choose(chosen: number): void {
    const tools = this.hello?.tools ?? [];
    const first = tools.findIndex((tool) => tool.optics !== null);
    this.endoscope = (tools[chosen]?.optics ?? null) !== null ? chosen : first < 0 ? null : first;
  }

  turn(on: boolean): void {
    this.scene.other = on ? this : null;
    for (const part of [this.page.orientation, this.page.hint]) part.hidden = on;
    this.layOut();
  }

  toggleOutside(): void {
    this.outside = !this.outside;
    this.layOut();
  }

  get showsOutside(): boolean {
    return this.on && this.outside;
  }

  /** True if the endoscope is the instrument in the hand: dragging leads it, and nothing is pushed. */
  leads(chosen: number): boolean {
    return this.on && this.endoscope === chosen;
  }

  /** The page's size or its buttons changed: the circle fills what they leave free. */
  layOut(): void {
    const { panel, toolbar, outside, task } = this.page;
    const [panelBox, toolbarBox] = [panel.getBoundingClientRect(), toolbar.getBoundingClientRect()];
    // On a narrow page panel and task are above the picture.
    const isAbove = panelBox.width > 0.6 * this.scene.width;
    const top = isAbove ? Math.max(panelBox.bottom, task?.getBoundingClientRect().bottom ?? 0) : 0;
    const bottom = toolbarBox.height > 0 ? Math.min(toolbarBox.top, this.scene.height) : this.scene.height;
    const right = this.scene.width - this.scene.covered.right;
    const pictures = this.stereo === "side_by_side" ? 2 : 1;
    const beside = (left: number): Circle => ({
      x: left + (right - left) / (2 * pictures),
      y: (top + bottom) / 2,
      radius: Math.max(1, Math.min((right - left) / pictures, bottom - top) / 2 - RIM),
    });
    const free = beside(isAbove ? 0 : Math.min(panelBox.right, 0.6 * this.scene.width));
    this.circle = free.radius < SMALLEST_RADIUS ? beside(0) : free;
    // Each has half of the width: the middle of the left one is a quarter of it from the left.
    this.second_px = pictures === 1 ? 0 : (2 * (right - this.circle.x)) / 3;
    outside.hidden = !this.showsOutside;
    outside.style.bottom = `${this.scene.height - bottom + RIM}px`;
  }

  /** A snapshot is shown. */
  take({ tools }: SnapshotHeader): void {
    const tool = this.endoscope === null ? undefined : tools[this.endoscope];
    const { info } = this;
    if (tool === undefined || info === null || info.optics === null) return;
    this.eye = eyeOf(tool, info.optics);
    this.look(this.eye);
    const isAtLens = tool.contact && new Vector3(...tool.contactPoint_m).distanceTo(this.eye.position_m) < info.tip_radius_m + AT_LENS_M;
    if (isAtLens) this.smear = 1;
  }

  /** Puts the camera behind the lens. */
  private look({ position_m, forward, up, field_of_view_rad }: Eye): void {
    this.camera.position.copy(position_m);
    this.camera.up.copy(up);
    this.camera.lookAt(position_m.clone().add(forward));
    this.camera.fov = (field_of_view_rad * 180) / Math.PI;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
  }

  /** The lamp is out, or shines; answers whether that is new. */
  setDark(isDark: boolean): boolean {
    const isNew = isDark !== this.isDark;
    this.isDark = isDark;
    return isNew;
  }

  /** Angle of the picture that a pixel covers [rad]. */
  get pixel_rad(): number {
    return (this.eye?.field_of_view_rad ?? 1) / (2 * this.circle.radius);
  }

  // ---- where the picture's points are ----

  /** The same place of the left eye's picture. */
  private inLeft(x: number): number {
    return this.second_px > 0 && x > this.circle.x + this.second_px / 2 ? x - this.second_px : x;
  }

  shows(x: number, y: number): boolean {
    return this.eye !== null && isInCircle(this.inLeft(x), y, this.circle);
  }

  ray(x: number, y: number): Ray | null {
    return this.eye && rayThrough(this.inLeft(x), y, this.circle, this.eye, this.distortion);
  }

  project(point_m: Vector3): [number, number] | null {
    return this.eye && seenAt(point_m, this.circle, this.eye, this.distortion);
  }

  middle(): [number, number] {
    return [this.circle.x, this.circle.y];
  }

  axes(): ViewAxes | null {
    return this.eye;
  }

  get distance_m(): number {
    return (this.metered_m * Math.tan(this.camera.fov * HALF_DEGREE_RAD)) / Math.tan(FIELD_OF_VIEW_DEG * HALF_DEGREE_RAD);
  }

  // ---- drawing ----

  draw(): void {
    const { renderer } = this.scene;
    // What is smeared needs few pixels.
    this.lens.fit(this.circle, this.smear > 0 ? SMEARED_RATIO : renderer.getPixelRatio());
    this.seenByEndoscope(true);
    const { height } = this.scene;
    if (this.stereo === "off" || this.eye === null) {
      this.drawInside();
      this.lens.draw(renderer, this.circle, height, this.smear);
    } else {
      const isBeside = this.stereo === "side_by_side";
      for (const side of [-1, 1] as const) {
        this.look(this.eye);
        throughLens(this.camera, side, this.metered_m);
        this.drawInside();
        const circle = isBeside && side === 1 ? { ...this.circle, x: this.circle.x + this.second_px } : this.circle;
        this.lens.draw(renderer, circle, height, this.smear, isBeside ? [1, 1, 1] : side < 0 ? [1, 0, 0] : [0, 1, 1], side === 1);
      }
      this.look(this.eye);
    }
    this.seenByEndoscope(false);
    if (this.showsOutside) this.drawOutside();
    renderer.setClearColor(0x000000, 0);
  }

  /** The picture behind the lens, by its camera. */
  private drawInside(): void {
    const { renderer, scene } = this.scene;
    if (isFullDetail()) this.shadow.draw(this.scene, this.camera, this.castNone);
    renderer.setRenderTarget(this.lens.target);
    // Nothing but the lamp shines inside.
    renderer.setClearColor(this.isDark ? 0x000000 : DEEP_RED, 1);
    if (this.isDark) renderer.clear();
    else inLampLight(scene, () => renderer.render(scene, this.camera));
    renderer.setRenderTarget(null);
  }

  /** What is in no light's way. */
  private get castNone(): Object3D[] {
    const { field, contactMarks, taskMarks, instruments } = this.scene;
    return [this.walls, this.scenery.group, field.group, contactMarks.group, taskMarks.group, ...instruments.map(({ jet }) => jet)];
  }

  /** The endoscope does not see itself, nor what is drawn to explain the scene; its lamp alone shines. */
  private seenByEndoscope(seen: boolean): void {
    this.scene.instruments.forEach((instrument, i) => {
      instrument.overlays.visible = !seen;
      if (i === this.endoscope) instrument.group.visible = !seen;
    });
    this.walls.visible = seen;
    this.scenery.show(seen, this.scene.organs.get(0)?.topology ?? null);
    this.scene.field.showGround(seen);
    this.scene.shadeByTool(seen && this.endoscope === this.scene.chosen);
    if (seen) lampPower.value = this.power();
  }

  /** Power of the lamp for what is seen now, and its distance. */
  private power(): number {
    const { x, y, radius } = this.circle;
    const distances = METERED.map(([a, b]) => {
      const at = [x + a * radius, y + b * radius] as const;
      const ray = this.scene.ray(...at);
      return this.scene.pick(...at)?.distance_m ?? Math.min(this.scenery.distance_m(ray), distanceToWalls_m(this.walls, ray));
    });
    const middle_m = distances.sort((a, b) => a - b)[Math.floor(METERED.length / 2)];
    this.metered_m = Math.min(FURTHEST_EXPOSED_M, Math.max(NEAREST_EXPOSED_M, middle_m));
    return EXPOSURE * 0.1 ** 2 * (this.metered_m / 0.1) ** MADE_UP;
  }

  private drawOutside(): void {
    const { renderer, scene, camera, canvas, orbit } = this.scene;
    const [box, whole] = [this.page.outside.getBoundingClientRect(), canvas.getBoundingClientRect()];
    const [x, y, width, height] = [box.left - whole.left, whole.bottom - box.bottom, box.width, box.height];
    if (!(width > 0 && height > 0)) return;
    this.outsideCamera.copy(camera, false);
    // From further away, so that it shows the instruments too.
    this.outsideCamera.position.addScaledVector(viewAxes(orbit).forward, -FURTHER_OUT * orbit.distance_m);
    this.outsideCamera.updateMatrixWorld();
    this.outsideCamera.clearViewOffset();
    this.outsideCamera.aspect = width / height;
    this.outsideCamera.updateProjectionMatrix();
    renderer.setScissorTest(true);
    renderer.setScissor(x, y, width, height);
    renderer.setViewport(x, y, width, height);
    renderer.setClearColor(OUTSIDE, 1);
    renderer.render(scene, this.outsideCamera);
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, this.scene.width, this.scene.height);
  }

  report(): TheatreReport {
    const { on, endoscope, smear, circle, camera, stereo, second_px } = this;
    const [, up, back] = [0, 1, 2].map((column) => new Vector3().setFromMatrixColumn(camera.matrixWorld, column));
    const view = { position_m: camera.position.toArray(), forward: back.negate().toArray(), up: up.toArray() };
    return { on, endoscope, smear, outside: this.showsOutside, field: this.scene.field.report(), ligament: this.scenery.showsLigament, stereo, second_px, circle: { ...circle }, camera: { ...view, field_of_view_rad: (camera.fov * Math.PI) / 180 } };
  }
}
