/** The bar below the picture: force over the whole recording, stages, moments that went wrong, and the place that is shown. */
import { forceText } from "../panel";
import { text } from "../language";
import { drawCurve, fitted, niceCeiling } from "../plot";
import { clockText } from "../task";
import type { Recording } from "./recording";

/** Half of the slider's thumb [CSS pixels]: there its middle is at the ends. */
const THUMB = 7;
const TOP = 4;
const STAGES = ["rgba(88,208,255,0.10)", "rgba(88,208,255,0.20)"];
const MOMENT = "#ff6f61";
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

export class Timeline {
  private readonly curve = document.createElement("canvas");
  private readonly slider = document.createElement("input");
  private readonly time = document.createElement("output");
  private readonly speed = document.createElement("output");
  private readonly about = document.createElement("span");
  private tool = 0;
  /** What is drawn below the cursor. */
  private still: { readonly key: string; readonly picture: HTMLCanvasElement } | null = null;

  constructor(root: HTMLElement, private readonly recording: Recording, private readonly toFrame: (frame: number) => void) {
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
    Object.assign(this.slider, { type: "range", min: "0", max: String(recording.nFrames - 1), step: "1", value: "0" });
    this.slider.setAttribute("aria-label", text("replay_place"));
    this.slider.addEventListener("input", () => this.toFrame(Number(this.slider.value)));
    track.append(this.curve, this.slider);
    root.append(words, track);
  }

  choose(tool: number, name: string): void {
    this.tool = tool;
    const largest_n = this.recording.forces_n.reduce((max, forces) => Math.max(max, forces[tool] ?? 0), 0);
    this.about.textContent = text("replay_force_on", { name, force: forceText(largest_n) });
    this.curve.setAttribute("aria-label", text("replay_curve", { about: this.about.textContent ?? "" }));
  }

  show(frame: number, time_s: number, speed: number): void {
    const { begin_s, end_s } = this.recording;
    const words = `${timeText(time_s)} / ${timeText(end_s)}`;
    if (this.time.textContent !== words) this.time.textContent = words;
    const speedText = `${speed} ×`;
    if (this.speed.textContent !== speedText) this.speed.textContent = speedText;
    if (this.slider.value !== String(frame)) this.slider.value = String(frame);
    this.slider.setAttribute("aria-valuetext", text("replay_time_of", { time: time_s.toFixed(2), from: begin_s.toFixed(2), to: end_s.toFixed(2) }));
    this.draw(frame / Math.max(1, this.recording.nFrames - 1));
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
    const { recording } = this;
    const area = { left: THUMB, top: TOP, width: width - 2 * THUMB, height: height - TOP - 1 };
    const xOf = (time_s: number): number => area.left + (area.width * recording.frameAt(time_s)) / Math.max(1, recording.nFrames - 1);
    recording.story?.stages.forEach(({ began_s, ended_s }, i) => {
      context.fillStyle = STAGES[i % STAGES.length];
      context.fillRect(xOf(began_s), 0, xOf(ended_s) - xOf(began_s), height);
    });
    const points = envelope(recording.forces_n, this.tool, Math.floor(area.width));
    const top_n = niceCeiling(points.reduce((max, [, force_n]) => Math.max(max, force_n), 0));
    drawCurve(context, points.map(([at, force_n]) => [area.left + at * area.width, area.top + area.height * (1 - force_n / top_n)] as const), area);
    for (const { from_s, to_s } of recording.story?.moments ?? []) {
      context.fillStyle = "rgba(255,111,97,0.22)";
      context.fillRect(xOf(from_s), 0, Math.max(2, xOf(to_s) - xOf(from_s)), height);
      context.fillStyle = MOMENT;
      context.fillRect(xOf(from_s) - 1, 0, 2, height);
    }
  }
}
