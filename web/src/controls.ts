/**
 * Pointer and wheel on the canvas. Left button: on the organ it pushes, on the background it turns the view
 * (Alt: always). Right button: turns. Shift + left on the background, or middle button: moves the view. Wheel: zooms, or while
 * pushing, deeper and shallower.
 */

export type Gesture = "push" | "turn" | "move";

export interface GestureStart {
  readonly button: number;
  readonly altKey: boolean;
  readonly shiftKey: boolean;
  readonly onOrgan: boolean;
}

/** What a pressed button begins, or null for nothing. */
export function gestureOf(start: GestureStart): Gesture | null {
  if (start.button === 1) return "move";
  if (start.button === 2) return "turn";
  if (start.button !== 0) return null;
  if (start.altKey) return "turn";
  if (start.onOrgan) return "push";
  return start.shiftKey ? "move" : "turn";
}

/** Wheel events in notches, forward (away from the hand) positive; pixels, lines and pages are unified. */
export function wheelNotches(deltaY: number, deltaMode: number): number {
  const perNotch = [100, 3, 1][deltaMode] ?? 100;
  const notches = -deltaY / perNotch;
  return Number.isFinite(notches) ? Math.min(5, Math.max(-5, notches)) : 0;
}

export interface ControlEvents {
  isOnOrgan(x: number, y: number): boolean;
  pushBegin(x: number, y: number): void;
  pushMove(x: number, y: number): void;
  pushEnd(): void;
  turn(dx: number, dy: number): void;
  move(dx: number, dy: number): void;
  wheel(notches: number): void;
}

export class Controls {
  private gesture: { readonly kind: Gesture; readonly pointer: number } | null = null;
  private last: [number, number] = [0, 0];
  private hovered: [number, number] | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly events: ControlEvents,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.moved(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.up(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    // The middle button would start the browser's own scrolling.
    canvas.addEventListener("mousedown", (event) => event.button === 1 && event.preventDefault());
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        events.wheel(wheelNotches(event.deltaY, event.deltaMode));
      },
      { passive: false },
    );
  }

  private at(event: MouseEvent): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  private down(event: PointerEvent): void {
    if (this.gesture !== null) return;
    const [x, y] = this.at(event);
    const kind = gestureOf({
      button: event.button,
      altKey: event.altKey,
      shiftKey: event.shiftKey,
      onOrgan: event.button === 0 && !event.altKey && this.events.isOnOrgan(x, y),
    });
    if (kind === null) return;
    this.gesture = { kind, pointer: event.pointerId };
    this.last = [x, y];
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.style.cursor = kind === "push" ? "none" : "grabbing";
    if (kind === "push") this.events.pushBegin(x, y);
  }

  private moved(event: PointerEvent): void {
    const [x, y] = this.at(event);
    if (this.gesture === null) {
      this.hover(x, y);
      return;
    }
    if (event.pointerId !== this.gesture.pointer) return;
    const [dx, dy] = [x - this.last[0], y - this.last[1]];
    this.last = [x, y];
    if (this.gesture.kind === "push") this.events.pushMove(x, y);
    else if (this.gesture.kind === "turn") this.events.turn(dx, dy);
    else this.events.move(dx, dy);
  }

  private up(event: PointerEvent): void {
    if (this.gesture === null || event.pointerId !== this.gesture.pointer) return;
    const { kind } = this.gesture;
    this.gesture = null;
    this.canvas.style.cursor = "";
    if (kind === "push") this.events.pushEnd();
  }

  /** Ends a push from elsewhere (a key). */
  cancel(): void {
    if (this.gesture === null) return;
    const { kind, pointer } = this.gesture;
    this.gesture = null;
    this.canvas.style.cursor = "";
    if (this.canvas.hasPointerCapture(pointer)) this.canvas.releasePointerCapture(pointer);
    if (kind === "push") this.events.pushEnd();
  }

  /** The cursor tells what a press would do; looked up once a frame at most. */
  private hover(x: number, y: number): void {
    const waiting = this.hovered !== null;
    this.hovered = [x, y];
    if (waiting) return;
    requestAnimationFrame(() => {
      const at = this.hovered;
      this.hovered = null;
      if (at === null || this.gesture !== null) return;
      this.canvas.style.cursor = this.events.isOnOrgan(at[0], at[1]) ? "crosshair" : "grab";
    });
  }
}
