/** The bar below the picture: force over the whole recording, stages, moments that went wrong, and the place that is shown. */
import { forceText } from "../panel";
import { text } from "../language";
import { drawCurve, fitted, niceCeiling } from "../plot";
import { clockText } from "../task";
import { frameIn, type Recording } from "./recording";

/** Half of the slider's thumb [CSS pixels]: there its middle is at the ends. */
const THUMB = 7;
const TOP = 4;
const STAGES = ["rgba(88,208,255,0.10)", "rgba(88,208,255,0.20)"];
const MOMENT = "#ff6f61";
const BOOKMARK = "#ffd166";
const CURSOR = "#e8f2fa";

/** The largest force on instrument `tool` in each of at most `n` stretches of equal length; with the share of the whole where it is. */
export function envelope(forces_n: readonly (readonly number[])[], tool: number, n: number): Array<readonly [number, number]> {
  const last = Math.max(1, forces_n.length - 1);
  const stretch = Math.max(1, Math.ceil(forces_n.length / Math.max(1, n)));
  const points: Array<readonly [number, number]> = [];
  for (let from = 0; from < forces_n.length; from += stretch) {
    let at = from;
    for (let i = from; i < Math.min(from + stretch, forces_n.length); i++) {
      if ((forces_n[i][tool] ?? 0) > (forces_n[at][tool] ?? 0)) at = i;
    }
    points.push([at / last, forces_n[at][tool] ?? 0]);
  }
  return points;
}

/** Minutes, seconds and hundredths: `0:05.25`. */
export function timeText(time_s: number): string {
  const hundredths = Math.round(100 * Math.max(0, time_s));
  return `${clockText(hundredths / 100)}.${String(hundredths % 100).padStart(2, "0")}`;
}

/** A recording on the clock. */
export interface Track {
  readonly recording: Recording;
  /** Its time at which the clock begins [s]. */
  readonly start_s: number;
  readonly colour: string;
}

export class Timeline {
  private readonly curve = document.createElement("canvas");
  private readonly slider = document.createElement("input");
  private readonly time = document.createElement("output");
  private readonly speed = document.createElement("output");
  private readonly about = document.createElement("span");
  private tracks: readonly Track[] = [];
  private frames_s: readonly number[] = [0];
  private tool = 0;
  private bookmarks_s: readonly number[] = [];
  /** What is drawn below the cursor. */
  private still: { readonly key: string; readonly picture: HTMLCanvasElement } | null = null;

  constructor(root: HTMLElement, private readonly toFrame: (frame: number) => void) {
    const words = document.createElement("div");
    words.className = "timeline-words";
    this.time.className = "timeline-time";
    this.time.setAttribute("aria-label", text("replay_time"));
    this.speed.setAttribute("aria-label", text("replay_speed"));
    this.about.className = "timeline-about";
    words.append(this.time, this.speed, this.about);
    const track = document.createElement("div");
    track.className = "timeline-track";
    this.curve.setAttribute("role", "img");
    Object.assign(this.slider, { type: "range", min: "0", step: "1", value: "0" });
    this.slider.setAttribute("aria-label", text("replay_place"));
    this.slider.addEventListener("input", () => this.toFrame(Number(this.slider.value)));
    track.append(this.curve, this.slider);
    root.append(words, track);
  }

  /** What is on the clock, and its times with a frame. */
  begin(tracks: readonly Track[], frames_s: readonly number[]): void {
    this.tracks = tracks;
    this.frames_s = frames_s;
    this.slider.max = String(frames_s.length - 1);
    this.still = null;
  }

  /** The instrument whose forces are drawn. */
  choose(tool: number, name: string): void {
    this.tool = tool;
    const largest = this.tracks.map(({ recording: { forces_n } }) => forceText(forces_n.reduce((max, forces) => Math.max(max, forces[tool] ?? 0), 0)));
    const [force, b] = largest;
    this.about.textContent = b === undefined ? text("replay_force_on", { name, force }) : text("replay_force_on_both", { name, a: force, b });
    this.curve.setAttribute("aria-label", text("replay_curve", { about: this.about.textContent ?? "" }));
  }

  /** Where bookmarks are. */
  mark(times_s: readonly number[]): void {
    this.bookmarks_s = times_s;
    this.still = null;
  }

  show(frame: number, time_s: number, speed: number): void {
    const [begin_s, end_s] = [this.frames_s[0], this.frames_s[this.frames_s.length - 1]];
    const words = `${timeText(time_s)} / ${timeText(end_s)}`;
    if (this.time.textContent !== words) this.time.textContent = words;
    const speedText = `${speed} ×`;
    if (this.speed.textContent !== speedText) this.speed.textContent = speedText;
    if (this.slider.value !== String(frame)) this.slider.value = String(frame);
    this.slider.setAttribute("aria-valuetext", text("replay_time_of", { time: time_s.toFixed(2), from: begin_s.toFixed(2), to: end_s.toFixed(2) }));
    this.draw(frame / Math.max(1, this.frames_s.length - 1));
  }

  private draw(share: number): void {
    const sheet = fitted(this.curve);
    if (sheet === null) return;
    const { context, width, height } = sheet;
    const key = `${this.tool} ${this.curve.width} ${this.curve.height}`;
    if (this.still?.key !== key) {
      this.drawStill(context, width, height);
      const picture = document.createElement("canvas");
      [picture.width, picture.height] = [this.curve.width, this.curve.height];
      if (picture.width === 0 || picture.height === 0) return;
      picture.getContext("2d")?.drawImage(this.curve, 0, 0);
      this.still = { key, picture };
    } else {
      context.drawImage(this.still.picture, 0, 0, width, height);
    }
    const x = THUMB + (width - 2 * THUMB) * share;
    context.fillStyle = CURSOR;
    context.fillRect(x - 0.75, 0, 1.5, height);
  }

  private drawStill(context: CanvasRenderingContext2D, width: number, height: number): void {
    const { tracks, frames_s } = this;
    const area = { left: THUMB, top: TOP, width: width - 2 * THUMB, height: height - TOP - 1 };
    const xOf = (clock_s: number): number => area.left + (area.width * frameIn(frames_s, clock_s)) / Math.max(1, frames_s.length - 1);
    const isOne = tracks.length === 1;
    if (isOne) {
      tracks[0].recording.story?.stages.forEach(({ began_s, ended_s }, i) => {
        context.fillStyle = STAGES[i % STAGES.length];
        context.fillRect(xOf(began_s), 0, xOf(ended_s) - xOf(began_s), height);
      });
    }
    const envelopes = tracks.map(({ recording }) => envelope(recording.forces_n, this.tool, Math.floor(area.width)));
    const top_n = niceCeiling(envelopes.flat().reduce((max, [, force_n]) => Math.max(max, force_n), 0));
    tracks.forEach(({ recording: { times_s }, start_s, colour }, i) => {
      const timeAt = (share: number): number => times_s[Math.round(share * (times_s.length - 1))] - start_s;
      drawCurve(context, envelopes[i].map(([at, force_n]) => [xOf(timeAt(at)), area.top + area.height * (1 - force_n / top_n)] as const), area, colour, isOne);
    });
    for (const { recording, start_s, colour } of tracks) {
      for (const { from_s, to_s } of recording.story?.moments ?? []) {
        const x = xOf(from_s - start_s);
        if (isOne) {
          context.fillStyle = "rgba(255,111,97,0.22)";
          context.fillRect(x, 0, Math.max(2, xOf(to_s) - x), height);
        }
        context.fillStyle = isOne ? MOMENT : colour;
        context.fillRect(x - 1, isOne ? 0 : height - 8, 2, height);
      }
    }
    context.fillStyle = BOOKMARK;
    for (const time_s of this.bookmarks_s) {
      const x = xOf(time_s);
      context.fillRect(x - 0.75, 0, 1.5, height);
      context.beginPath();
      context.moveTo(x - 4, 0);
      context.lineTo(x + 4, 0);
      context.lineTo(x, 6);
      context.fill();
    }
  }
}
