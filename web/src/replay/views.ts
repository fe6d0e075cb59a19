/** The pictures of one recording, or of two beside each other on one clock, and cameras that go together. */
import type { Orbit } from "../orbit";
import { Clock } from "./clock";
import type { Recording } from "./recording";
import { RecordedView, type ViewEvents, type ViewParts } from "./view";

export class Views {
  readonly all: readonly RecordedView[];
  readonly clock: Clock;
  /** Whether cameras go together. */
  coupled = true;
  /** The one whose camera was moved last. */
  active = 0;

  constructor(parts: readonly ViewParts[], recordings: readonly Recording[], events: ViewEvents) {
    this.all = recordings.map((recording, i) => new RecordedView(parts[i], recording, events));
    this.clock = new Clock(recordings);
  }

  get first(): RecordedView {
    return this.all[0];
  }

  get isPair(): boolean {
    return this.all.length > 1;
  }

  take(clock_s: number): void {
    this.all.forEach((view, i) => view.take(this.clock.timeIn(i, clock_s)));
  }

  draw(now_ms: number, showsForces: boolean): void {
    for (const view of this.all) view.draw(now_ms, showsForces);
  }

  /** Everything is drawn anew. */
  change(): void {
    for (const view of this.all) view.changed = true;
  }

  /** Moves the camera of a view, and of the other one where they go together. */
  look(view: number, change: (orbit: Orbit, height_px: number) => Orbit): void {
    const { scene, theatre } = this.all[view];
    this.active = view;
    // Through an endoscope the recording looks where it looked.
    if (theatre.on) return;
    scene.setOrbit(change(scene.orbit, scene.height));
    if (this.coupled) this.follow(view);
  }

  /** All cameras are as that of one: each at the same place beside the middle of its own organ. */
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
