/** One plane: its picture, the cross, the points, and what mouse and keys do there. */
import { aspect, moved, normalAxis, pointAt, shareOf, type Box } from "./planes";
import type { PlaneName, Point } from "./state";

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

export interface PlaneHandlers {
  /** The cross goes there. */
  readonly go: (to_mm: Point) => void;
  /** A point is set there; its kind is the chosen one unless it is said. */
  readonly setPoint: (at_mm: Point, kind?: ShownPoint["kind"]) => void;
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
/** Points further from the plane than this are not shown in it [mm]. */
const NEAR_MM = 6;

export class PlaneView {
  private readonly picture = new Image();
  private readonly marks = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  private cross: Cross | null = null;
  /** What is to be shown once the picture under way is there. */
  private next: string | null = null;
  private isLoading = false;
  /** How far the wheel was turned since the last slice. */
  private turned = 0;

  constructor(
    private readonly plane: PlaneName,
    private readonly node: HTMLElement,
    private readonly handlers: PlaneHandlers,
  ) {
    this.picture.alt = "";
    this.picture.draggable = false;
    node.append(this.picture, this.marks);
    const done = (): void => {
      this.isLoading = false;
      if (this.next !== null) this.load(this.next);
    };
    this.picture.addEventListener("load", done);
    this.picture.addEventListener("error", () => {
      // Not the slice before under this one's cross.
      this.picture.removeAttribute("src");
      done();
    });
    node.addEventListener("pointerdown", (event) => this.press(event));
    node.addEventListener("wheel", (event) => this.turn(event), { passive: false });
    node.addEventListener("keydown", (event) => this.key(event));
  }

  /** Shows the slice at an address; of several in a row the last one. */
  load(address: string): void {
    if (this.isLoading) {
      this.next = address;
      return;
    }
    this.next = null;
    if (this.picture.src.endsWith(address)) return;
    this.isLoading = true;
    this.picture.src = address;
  }

  /** Shows the cross and the points near the plane. */
  mark(cross: Cross, points: readonly ShownPoint[]): void {
    this.cross = cross;
    this.node.style.aspectRatio = String(aspect(this.plane, cross.box));
    const [x, y] = shareOf(this.plane, cross.box, cross.at_mm);
    const percent = (share: number): string => `${(100 * share).toFixed(3)}%`;
    const line = (x1: number, y1: number, x2: number, y2: number): string =>
      `<line x1="${percent(x1)}" y1="${percent(y1)}" x2="${percent(x2)}" y2="${percent(y2)}"/>`;
    const normal = normalAxis(this.plane);
    const near = points.filter((point) => Math.abs(point.at_mm[normal]! - cross.at_mm[normal]!) <= NEAR_MM);
    const dots = near.map((point) => {
      const [cx, cy] = shareOf(this.plane, cross.box, point.at_mm);
      return `<circle class="${point.kind}" cx="${percent(cx)}" cy="${percent(cy)}" r="5"/>`;
    });
    this.marks.innerHTML = line(x, 0, x, 1) + line(0, y, 1, y) + dots.join("");
  }

  private press(event: PointerEvent): void {
    if (this.cross === null || event.button !== 0) return;
    const frame = this.node.getBoundingClientRect();
    const shares = [(event.clientX - frame.left) / frame.width, (event.clientY - frame.top) / frame.height] as const;
    const at = pointAt(this.plane, this.cross.box, this.cross.at_mm, shares);
    this.handlers.go(at);
    // With the control key only the cross goes there.
    if (!event.ctrlKey) this.handlers.setPoint(at);
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
      this.handlers.setPoint(this.cross.at_mm);
    }
  }

  private step(by: readonly [number, number, number], isFast: boolean): void {
    const cross = this.cross;
    if (cross === null) return;
    const times = isFast ? FAST : 1;
    this.handlers.go(moved(this.plane, cross.box, cross.at_mm, cross.steps_mm, by.map((x) => times * x) as [number, number, number]));
  }
}
