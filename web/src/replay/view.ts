/** One recording as it is looked at: its picture at any time, from outside or through its endoscope. */
import { Vector3 } from "three";
import { Contacts } from "../contacts";
import { arrowScale_m_per_n } from "../plot";
import { headerOfHand, type HandHeader, type Hello, type SnapshotHeader, type Topology } from "../protocol";
import { Resolution } from "../resolution";
import { Scene3d } from "../scene3d";
import { Theatre } from "../theatre/view";
import { between } from "./between";
import { drawnAt } from "./notes";
import type { ReplayPage } from "./page";
import type { Recording, Shown } from "./recording";

/** What of the page one recording has. */
export type ViewParts = Pick<ReplayPage, "scene" | "panel" | "orientation" | "outside" | "hint" | "transport" | "contacts">;

export interface ViewEvents {
  /** Another scene begins, or the first one. */
  began(): void;
  /** What was asked for is unpacked. */
  ready(): void;
  failed(error: unknown): void;
}

export class RecordedView {
  readonly scene: Scene3d;
  readonly theatre: Theatre;
  private readonly contacts: Contacts;
  private showsContacts = false;
  /** Of each instrument, the largest force in all of the recording [N]. */
  readonly largest_n: readonly number[];
  hello: Hello;
  /** What is shown; null before it is unpacked. */
  header: HandHeader | null = null;
  shownFrame = -1;
  /** The picture is not what should be shown. */
  changed = true;
  private readonly resolution = new Resolution();
  private topology: Topology | null = null;
  /** As drawn, between that frame and the next. */
  private drawn: SnapshotHeader | null = null;
  private drawn_s = -1;
  /** What is drawn on the tissue, as it was last shown. */
  private marksShown = "";

  constructor(
    parts: ViewParts,
    readonly recording: Recording,
    private readonly events: ViewEvents,
  ) {
    this.hello = recording.helloAt(0);
    this.largest_n = this.hello.tools.map((_, tool) => recording.forces_n.reduce((max, forces) => Math.max(max, forces[tool] ?? 0), 0));
    this.scene = new Scene3d(parts.scene);
    this.theatre = new Theatre(this.scene, { ...parts, toolbar: parts.transport });
    this.contacts = new Contacts(parts.contacts, this.scene.contactMarks);
  }

  get arrowScale_m_per_n(): number {
    return arrowScale_m_per_n(Math.max(...this.largest_n));
  }

  /** Middle of the organ's box [m]. */
  get middle_m(): Vector3 {
    const { min_m, max_m } = this.hello.bounds;
    return new Vector3(...min_m).add(new Vector3(...max_m)).multiplyScalar(0.5);
  }

  begin(hello = this.hello): void {
    const { chosen } = this.scene;
    this.hello = hello;
    this.topology = null;
    this.scene.begin(hello);
    this.theatre.begin(hello, chosen);
    this.choose(Math.min(chosen, hello.tools.length - 1));
    this.events.began();
  }

  /** Shows where surfaces bear forces, or no longer. */
  showContacts(shown: boolean): void {
    this.showsContacts = shown;
    this.contacts.turn(shown, null);
    this.contacts.take(this.drawn?.contactPoints ?? null);
  }

  choose(tool: number): void {
    this.scene.choose(tool);
    this.theatre.choose(tool);
    if (this.header !== null) this.header = headerOfHand(this.header, tool);
  }

  /** Takes what is recorded of a time to the picture, as soon as it is unpacked, and what is on the way to the next frame. */
  take(time_s: number): void {
    const { recording } = this;
    const frame = recording.frameAt(time_s);
    if (frame === this.shownFrame && time_s === this.drawn_s) return;
    try {
      const look = (at: number): Shown | null => recording.at(at, () => this.events.ready(), (error) => this.events.failed(error));
      const found = look(frame);
      if (found === null) return;
      const hello = recording.helloAt(frame);
      if (hello !== this.hello) this.begin(hello);
      if (found.topology.version !== this.topology?.version) {
        this.topology = found.topology;
        this.scene.setTopology(found.topology);
      }
      this.showMarks(recording.times_s[frame]);
      const next = frame + 1 < recording.nFrames ? look(frame + 1) : null;
      const share = next === null ? 0 : (time_s - recording.times_s[frame]) / (recording.times_s[frame + 1] - recording.times_s[frame]);
      const drawn = next === null ? found.snapshot : between(found.snapshot, next.snapshot, Math.min(1, share));
      this.scene.show(drawn);
      this.drawn = drawn.header;
      this.drawn_s = time_s;
      if (frame !== this.shownFrame) this.contacts.take(drawn.header.contactPoints);
      this.header = headerOfHand(found.snapshot.header, this.scene.chosen);
      this.shownFrame = frame;
      this.changed = true;
    } catch (error) {
      this.events.failed(error);
    }
  }

  /** What who teaches had drawn. */
  private showMarks(time_s: number): void {
    const marks = drawnAt(this.recording.notes, time_s);
    const key = JSON.stringify(marks);
    if (key === this.marksShown) return;
    this.marksShown = key;
    this.scene.classMarks.showMarks(marks);
  }

  /** Draws the picture anew, where it is another one. */
  draw(now_ms: number, showsForces: boolean): void {
    if (!this.changed || this.drawn === null) return;
    this.scene.styleTools(this.arrowScale_m_per_n, showsForces, !this.showsContacts);
    this.contacts.show(this.scene.distance_m);
    this.scene.showTools(this.drawn);
    this.theatre.take(this.drawn);
    this.scene.render(this.resolution.moving(now_ms));
    this.changed = false;
    this.scene.renderFinerAtRest(() => this.changed);
  }

  /** The page's size changed. */
  resize(left: number, right: number, bottom: number): void {
    this.scene.setCovered(left, right, bottom);
    this.scene.resize();
    this.theatre.layOut();
  }
}
