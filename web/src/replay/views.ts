/** One recording, or two beside each other on one clock: their pictures, and cameras that go together. */
import type { Orbit } from "../orbit";
import type { Recording } from "./recording";
import { frameIn } from "./recording";
import { RecordedView, type ViewEvents, type ViewParts } from "./view";

/** Where two recordings lie on the clock: from their beginnings on, or from the first motion of each one's task. */
export type Beginning = "recording" | "task";

export class Views {
  readonly all: readonly RecordedView[];
  /** Whether cameras go together. */
  coupled = true;
  /** The one whose camera was moved last. */
  active = 0;
  beginning: Beginning;
  /** Times of the clock at which there is a frame [s]. */
  frames_s: readonly number[] = [];

  constructor(parts: readonly ViewParts[], recordings: readonly Recording[], events: ViewEvents) {
    this.all = recordings.map((recording, i) => new RecordedView(parts[i], recording, events));
    this.beginning = this.canBeginWithTask ? "task" : "recording";
    this.beginWith(this.beginning);
  }

  get first(): RecordedView {
    return this.all[0];
  }

  get isPair(): boolean {
    return this.all.length > 1;
  }

  /** Whether both have a task that was begun. */
  get canBeginWithTask(): boolean {
    return this.isPair && this.all.every(({ recording }) => recording.story?.began_s != null);
  }

  beginWith(beginning: Beginning): void {
    this.beginning = beginning;
    // Of one recording the clock is its own.
    if (!this.isPair) {
      this.frames_s = this.first.recording.times_s;
      return;
    }
    const [begin_s, end_s] = [Math.min(...this.ends("begin_s")), Math.max(...this.ends("end_s"))];
    const rate_hz = Math.max(...this.all.map(({ recording }) => recording.rate_hz));
    this.frames_s = Array.from({ length: Math.floor((end_s - begin_s) * rate_hz + 1e-6) + 1 }, (_, i) => begin_s + i / rate_hz);
  }

  private ends(which: "begin_s" | "end_s"): number[] {
    return this.all.map(({ recording }, i) => recording[which] - this.start_s(i));
  }

  get begin_s(): number {
    return this.frames_s[0];
  }

  get end_s(): number {
    return this.frames_s[this.frames_s.length - 1];
  }

  /** The time of a recording at which the clock begins [s]. */
  start_s(view: number): number {
    if (!this.isPair) return 0;
    const { recording } = this.all[view];
    return this.beginning === "task" ? (recording.story?.began_s ?? 0) : recording.begin_s;
  }

  /** The time of a recording [s] at a time of the clock. */
  timeIn(view: number, clock_s: number): number {
    const { begin_s, end_s } = this.all[view].recording;
    return Math.min(end_s, Math.max(begin_s, clock_s + this.start_s(view)));
  }

  frameAt(clock_s: number): number {
    return frameIn(this.frames_s, clock_s);
  }

  take(clock_s: number): void {
    this.all.forEach((view, i) => view.take(this.timeIn(i, clock_s)));
  }

  draw(now_ms: number, showsForces: boolean): void {
    for (const view of this.all) view.draw(now_ms, showsForces);
  }

  /** Everything is drawn anew. */
  change(): void {
    for (const view of this.all) view.changed = true;
  }

  /** Moves the camera of a view, and of the other one where they go together: as far from the middle of its own organ. */
  look(view: number, change: (orbit: Orbit, height_px: number) => Orbit): void {
    const { scene, theatre } = this.all[view];
    this.active = view;
    // Through an endoscope the recording looks where it looked.
    if (theatre.on) return;
    scene.setOrbit(change(scene.orbit, scene.height));
    if (this.coupled) this.follow(view);
  }

  /** All cameras are as that of one. */
  follow(view: number): void {
    const { orbit } = this.all[view].scene;
    const middle = this.all[view].middle_m;
    this.all.forEach((other, i) => {
      if (i !== view) other.scene.setOrbit({ ...orbit, target_m: orbit.target_m.clone().sub(middle).add(other.middle_m) });
    });
  }

  resetView(): void {
    for (const { scene } of this.all) scene.resetView();
  }
}
