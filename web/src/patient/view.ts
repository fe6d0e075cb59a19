/** One plane: its picture, the cross, points and outlines, and what mouse and keys do there. */
import { Loader } from "./loader";
import { aspect, isOneSlice, moved, normalAxis, pointAt, shareOf, type Box } from "./planes";
import type { Outline, PlaneName, Point } from "./state";

export interface ShownPoint {
  readonly at_mm: Point;
  readonly kind: "inside" | "outside";
}

/** What the planes share. */
export interface Cross {
  readonly box: Box;
  /** A voxel along each patient axis. */
  readonly steps_mm: Point;
  readonly at_mm: Point;
}

/** What lies in the planes. */
export interface Marks {
  readonly points: readonly ShownPoint[];
  /** Found in the image. */
  readonly found: readonly Outline[];
  /** Drawn by hand: they count where there are some in a slice. */
  readonly byHand: readonly Outline[];
  /** Corners of an outline that is being drawn, in the plane of the slices. */
  readonly draft: readonly Point[];
  readonly planeOfSlices: PlaneName;
}

export interface PlaneHandlers {
  /** The cross goes there. */
  readonly go: (to_mm: Point) => void;
  /** A point of the chosen kind, or a corner of an outline, is set there. */
  readonly set: (at_mm: Point, plane: PlaneName) => void;
  /** Whether outlines are drawn in this plane now. */
  readonly isDrawing: (plane: PlaneName) => boolean;
  /** The outline that was drawn by dragging ends. */
  readonly finish: () => void;
}

const STEPS: Readonly<Record<string, readonly [number, number, number]>> = {
  ArrowLeft: [-1, 0, 0],
  ArrowRight: [1, 0, 0],
  ArrowUp: [0, -1, 0],
  ArrowDown: [0, 1, 0],
  PageUp: [0, 0, 1],
  PageDown: [0, 0, -1],
};
/** Turn of the wheel for a slice [pixels]: less than a notch, more than a trackpad's events. */
const WHEEL_STEP = 30;
/** Voxels of an arrow with the shift key. */
const FAST = 10;
/** Places of a line that is drawn by dragging are so far apart at least [pixels]. */
const DRAWN_STEP = 3;
/** Points further from the plane than this are not shown in it [mm]. */
const NEAR_MM = 6;

export class PlaneView {
  private readonly loader: Loader;
  private readonly marks = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  private cross: Cross | null = null;
  /** How far the wheel was turned since the last slice. */
  private turned = 0;
  /** Where the line that is being drawn is, and how many places it has. */
  private drawn: { at: readonly [number, number]; n: number } | null = null;

  constructor(
    private readonly plane: PlaneName,
    private readonly node: HTMLElement,
    private readonly handlers: PlaneHandlers,
    pictureOf: (name: string) => Promise<string>,
  ) {
    this.loader = new Loader(pictureOf);
    // Lines are given in hundredths of the picture's sides.
    this.marks.setAttribute("viewBox", "0 0 100 100");
    this.marks.setAttribute("preserveAspectRatio", "none");
    // What they show is in the lists of points and outlines.
    this.marks.setAttribute("aria-hidden", "true");
    node.append(this.loader.picture, this.marks);
    node.addEventListener("pointerdown", (event) => this.press(event));
    node.addEventListener("pointermove", (event) => this.draw(event));
    for (const end of ["pointerup", "pointercancel"]) node.addEventListener(end, () => this.endDrawing());
    node.addEventListener("wheel", (event) => this.turn(event), { passive: false });
    node.addEventListener("keydown", (event) => this.key(event));
  }

  /** Shows the slice of this name. */
  load(name: string): void {
    this.loader.load(name);
  }

  /** Shows the cross, the points near the plane and the outlines in it. */
  mark(cross: Cross, marks: Marks): void {
    this.cross = cross;
    this.node.style.aspectRatio = String(aspect(this.plane, cross.box));
    const at = (point: Point): string => shareOf(this.plane, cross.box, point).map((share) => (100 * share).toFixed(3)).join(",");
    const [x, y] = shareOf(this.plane, cross.box, cross.at_mm).map((share) => (100 * share).toFixed(3));
    const normal = normalAxis(this.plane);
    const near = marks.points.filter((point) => Math.abs(point.at_mm[normal]! - cross.at_mm[normal]!) <= NEAR_MM);
    // Without width of its own a line of no length is a dot as wide as its stroke, whatever the picture's sides are.
    const dots = near.map((point) => `<path class="dot ${point.kind}" d="M ${at(point.at_mm)} h 0"/>`);
    this.marks.innerHTML =
      `<path class="cross" d="M ${x},0 V 100 M 0,${y} H 100"/>` + dots.join("") + (this.plane === marks.planeOfSlices ? this.outlines(cross, marks, at) : "");
  }

  private outlines(cross: Cross, marks: Marks, at: (point: Point) => string): string {
    const isHere = ({ through_mm }: Outline): boolean => isOneSlice(this.plane, cross, through_mm);
    const byHand = marks.byHand.filter(isHere);
    const shown = byHand.length > 0 ? byHand : marks.found.filter(isHere);
    const closed = shown
      .filter(({ points_mm }) => points_mm.length > 0)
      .map(({ points_mm }) => `<path class="${byHand.length > 0 ? "by-hand" : "found"}" d="M ${points_mm.map(at).join(" L ")} Z"/>`);
    const isDraftHere = marks.draft[0] !== undefined && isOneSlice(this.plane, cross, marks.draft[0]);
    const draft = isDraftHere ? `<path class="draft" d="M ${marks.draft.map(at).join(" L ")} h 0"/>` : "";
    return closed.join("") + draft;
  }

  /** Where the mouse is: shares of the picture's sides. */
  private sharesOf(event: PointerEvent): [number, number] {
    const frame = this.node.getBoundingClientRect();
    return [(event.clientX - frame.left) / frame.width, (event.clientY - frame.top) / frame.height];
  }

  private press(event: PointerEvent): void {
    if (this.cross === null || event.button !== 0) return;
    const at = pointAt(this.plane, this.cross.box, this.cross.at_mm, this.sharesOf(event));
    if (this.handlers.isDrawing(this.plane) && !event.ctrlKey) {
      this.drawn = { at: [event.clientX, event.clientY], n: 1 };
      this.node.setPointerCapture(event.pointerId);
    } else {
      this.handlers.go(at);
    }
    // With the control key only the cross goes there.
    if (!event.ctrlKey) this.handlers.set(at, this.plane);
  }

  private draw(event: PointerEvent): void {
    if (this.cross === null || this.drawn === null) return;
    const { at, n } = this.drawn;
    if (Math.hypot(event.clientX - at[0], event.clientY - at[1]) < DRAWN_STEP) return;
    this.drawn = { at: [event.clientX, event.clientY], n: n + 1 };
    this.handlers.set(pointAt(this.plane, this.cross.box, this.cross.at_mm, this.sharesOf(event)), this.plane);
  }

  /** A line that was dragged is closed; a click was a corner. */
  private endDrawing(): void {
    const isLine = (this.drawn?.n ?? 0) > 2;
    this.drawn = null;
    if (isLine) this.handlers.finish();
  }

  private turn(event: WheelEvent): void {
    if (this.cross === null) return;
    event.preventDefault();
    // With the shift key browsers turn the wheel sideways; trackpads send many small turns.
    this.turned += event.deltaY === 0 && event.shiftKey ? event.deltaX : event.deltaY;
    if (Math.abs(this.turned) < WHEEL_STEP) return;
    const by = this.turned > 0 ? -1 : 1;
    this.turned = 0;
    this.step([0, 0, by], event.shiftKey);
  }

  private key(event: KeyboardEvent): void {
    if (this.cross === null || event.ctrlKey || event.altKey || event.metaKey) return;
    const by = STEPS[event.key];
    if (by !== undefined) {
      event.preventDefault();
      this.step(by, event.shiftKey);
    } else if (event.key === "Enter") {
      this.handlers.set(this.cross.at_mm, this.plane);
    }
  }

  private step(by: readonly [number, number, number], isFast: boolean): void {
    const cross = this.cross;
    if (cross === null) return;
    const times = isFast ? FAST : 1;
    this.handlers.go(moved(this.plane, cross.box, cross.at_mm, cross.steps_mm, by.map((x) => times * x) as [number, number, number]));
  }
}
