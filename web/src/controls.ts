/**
 * Pointers and wheel on the canvas. Left button: on the organ it pushes, on the background it turns the view
 * (Alt: always). Right button: turns. Shift + left on the background, or middle button: moves the view. Wheel: zooms, or while
 * pushing, deeper and shallower. A second finger pushes with another instrument where it comes down on the organ; beside it, it leads the push of the
 * first one deeper and back, or two fingers zoom and move the view.
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

/** A finger that leads another's push goes so far for a notch of the wheel [pixels]. */
const DEPTH_PIXELS = 12;
/** Two fingers that part to so many times their distance zoom by one notch of the wheel. */
const PINCH_PER_NOTCH = 1 / 0.9;

type Place = readonly [x: number, y: number];

/** Notches of the wheel of two fingers that were `before` and are `now`. */
export function pinchNotches(before: readonly [Place, Place], now: readonly [Place, Place]): number {
  const [was, is] = [before, now].map(([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]));
  return was > 0 && is > 0 ? Math.log(is / was) / Math.log(PINCH_PER_NOTCH) : 0;
}

/** Which instrument a pointer pushes with: that in the hand, or the one beside it. */
export type PushHand = "first" | "second";

export interface ControlEvents {
  isOnOrgan(x: number, y: number): boolean;
  /** False if there is nothing to push, or with. */
  pushBegin(x: number, y: number, hand: PushHand): boolean;
  pushMove(x: number, y: number, hand: PushHand): void;
  pushEnd(hand: PushHand): void;
  turn(dx: number, dy: number): void;
  move(dx: number, dy: number): void;
  wheel(notches: number): void;
}

/** What a second finger does beside the first. */
type SecondGesture = "push" | "depth" | "pinch";

interface Pressed<K> {
  readonly kind: K;
  readonly pointer: number;
  at: Place;
}

export class Controls {
  private first: Pressed<Gesture> | null = null;
  private second: Pressed<SecondGesture> | null = null;
  private hovered: Place | null = null;

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

  private at(event: MouseEvent): Place {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  private down(event: PointerEvent): void {
    const at = this.at(event);
    if (this.first !== null) {
      this.downBeside(this.first, event, at);
      return;
    }
    const kind = gestureOf({
      button: event.button,
      altKey: event.altKey,
      shiftKey: event.shiftKey,
      onOrgan: event.button === 0 && !event.altKey && this.events.isOnOrgan(...at),
    });
    if (kind === null) return;
    this.first = { kind, pointer: event.pointerId, at };
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.style.cursor = kind === "push" ? "none" : "grabbing";
    if (kind === "push") this.events.pushBegin(...at, "first");
  }

  /** Another pointer comes down. The buttons of a mouse are one pointer: what they began goes on. */
  private downBeside(first: Pressed<Gesture>, event: PointerEvent, at: Place): void {
    if (this.second !== null || event.pointerId === first.pointer) return;
    const besidePush = (): SecondGesture => (this.events.pushBegin(...at, "second") ? "push" : "depth");
    this.second = { kind: first.kind === "push" ? besidePush() : "pinch", pointer: event.pointerId, at };
    this.canvas.setPointerCapture(event.pointerId);
  }

  private moved(event: PointerEvent): void {
    const at = this.at(event);
    if (this.first === null && this.second === null) {
      this.hover(at);
      return;
    }
    if (event.pointerId === this.second?.pointer) this.movedBeside(this.second, at);
    if (event.pointerId !== this.first?.pointer) return;
    const { kind, at: before } = this.first;
    const [dx, dy] = [at[0] - before[0], at[1] - before[1]];
    if (this.second?.kind === "pinch") this.pinch([before, this.second.at], [at, this.second.at]);
    else if (kind === "push") this.events.pushMove(...at, "first");
    else if (kind === "turn") this.events.turn(dx, dy);
    else this.events.move(dx, dy);
    this.first.at = at;
  }

  private movedBeside(second: Pressed<SecondGesture>, at: Place): void {
    if (second.kind === "push") this.events.pushMove(...at, "second");
    else if (second.kind === "depth") this.events.wheel((second.at[1] - at[1]) / DEPTH_PIXELS);
    else if (this.first !== null) this.pinch([this.first.at, second.at], [this.first.at, at]);
    second.at = at;
  }

  private pinch(before: readonly [Place, Place], now: readonly [Place, Place]): void {
    this.events.wheel(pinchNotches(before, now));
    const middle = (k: 0 | 1): number => (now[0][k] + now[1][k] - before[0][k] - before[1][k]) / 2;
    this.events.move(middle(0), middle(1));
  }

  private up(event: PointerEvent): void {
    if (event.pointerId === this.second?.pointer) {
      if (this.second.kind === "push") this.events.pushEnd("second");
      this.second = null;
    }
    if (event.pointerId !== this.first?.pointer) return;
    const { kind } = this.first;
    this.first = null;
    // What the finger that stays did beside this one it does no more; a push is its own.
    if (this.second?.kind !== "push") this.second = null;
    this.canvas.style.cursor = "";
    if (kind === "push") this.events.pushEnd("first");
  }

  /** Ends what pointers do from elsewhere (a key). */
  cancel(): void {
    const [first, second] = [this.first, this.second];
    this.first = this.second = null;
    this.canvas.style.cursor = "";
    for (const pressed of [first, second]) {
      if (pressed !== null && this.canvas.hasPointerCapture(pressed.pointer)) this.canvas.releasePointerCapture(pressed.pointer);
    }
    if (first?.kind === "push") this.events.pushEnd("first");
    if (second?.kind === "push") this.events.pushEnd("second");
  }

  /** The cursor tells what a press would do; looked up once a frame at most. */
  private hover(place: Place): void {
    const waiting = this.hovered !== null;
    this.hovered = place;
    if (waiting) return;
    requestAnimationFrame(() => {
      const at = this.hovered;
      this.hovered = null;
      if (at === null || this.first !== null) return;
      this.canvas.style.cursor = this.events.isOnOrgan(...at) ? "crosshair" : "grab";
    });
  }
}
