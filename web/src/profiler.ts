/** Times of the viewer's own work and of what arrives: a moving window, and the text that shows it. */

import type { Hello, SnapshotHeader } from "./protocol";
import { timingLines, type Timing } from "./timing";

const WINDOW_MS = 2000;

interface Frame {
  readonly at_ms: number;
  /** Processor time of the frame's work [ms]. */
  readonly work_ms: number;
  readonly draw_ms: number;
}

interface Arrival {
  readonly at_ms: number;
  readonly bytes: number;
}

export interface ProfileSummary {
  readonly frames_per_s: number;
  readonly work_ms: number;
  readonly draw_ms: number;
  readonly longestWork_ms: number;
  readonly snapshots_per_s: number;
  readonly megabytes_per_s: number;
}

function within<T extends { readonly at_ms: number }>(items: T[], now_ms: number): T[] {
  return items.filter((item) => now_ms - item.at_ms <= WINDOW_MS);
}

const mean = (values: readonly number[]): number =>
  values.length === 0 ? 0 : values.reduce((sum, x) => sum + x, 0) / values.length;

export class Profile {
  private frames: Frame[] = [];
  private arrivals: Arrival[] = [];

  frame(frame: Frame): void {
    this.frames = within(this.frames, frame.at_ms);
    this.frames.push(frame);
  }

  arrival(arrival: Arrival): void {
    this.arrivals = within(this.arrivals, arrival.at_ms);
    this.arrivals.push(arrival);
  }

  summary(now_ms: number): ProfileSummary {
    const frames = within(this.frames, now_ms);
    const arrivals = within(this.arrivals, now_ms);
    const seconds = WINDOW_MS / 1000;
    return {
      frames_per_s: frames.length / seconds,
      work_ms: mean(frames.map((f) => f.work_ms)),
      draw_ms: mean(frames.map((f) => f.draw_ms)),
      longestWork_ms: frames.reduce((max, f) => Math.max(max, f.work_ms), 0),
      snapshots_per_s: arrivals.length / seconds,
      megabytes_per_s: arrivals.reduce((sum, a) => sum + a.bytes, 0) / seconds / 1e6,
    };
  }
}

export interface ProfilerFacts extends ProfileSummary {
  readonly rate_steps_per_s: number;
  readonly timeStep_s: number;
  readonly triangles: number;
  readonly drawCalls: number;
  readonly software: boolean;
}

export function profilerText(facts: ProfilerFacts): string {
  const step_ms = facts.rate_steps_per_s > 0 ? 1000 / facts.rate_steps_per_s : 0;
  return [
    `frames        ${facts.frames_per_s.toFixed(1)} /s (drawn on change)`,
    `frame work    ${facts.work_ms.toFixed(2)} ms, longest ${facts.longestWork_ms.toFixed(2)} ms`,
    `draw calls    ${facts.draw_ms.toFixed(2)} ms in ${facts.drawCalls}, ${facts.triangles} triangles`,
    `snapshots     ${facts.snapshots_per_s.toFixed(1)} /s, ${facts.megabytes_per_s.toFixed(2)} MB/s`,
    `simulation    ${step_ms.toFixed(3)} ms a step, time step ${(1000 * facts.timeStep_s).toFixed(3)} ms`,
    `drawn by      ${facts.software ? "processor (no GPU found)" : "GPU"}`,
  ].join("\n");
}

/** The profiler's text from what the viewer has at hand. */
export function profilerReport(
  summary: ProfileSummary,
  drawn: { readonly triangles: number; readonly calls: number },
  software: boolean,
  header: SnapshotHeader | null,
  hello: Hello | null,
  timing: Timing | null = null,
): string {
  const text = profilerText({
    ...summary,
    rate_steps_per_s: header?.rate_steps_per_s ?? 0,
    timeStep_s: hello?.scene.time_step_s ?? 0,
    triangles: drawn.triangles,
    drawCalls: drawn.calls,
    software,
  });
  return [text, ...timingLines(timing)].join("\n");
}
