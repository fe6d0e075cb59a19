/** The scene's task: what is to be done now, how far it is, the time, and at its end the way to the report. */
import { download } from "./download";
import { text } from "./language";
import { reasonOf } from "./reason";
import { decodeEvents, TaskEvents, type TaskEventNews } from "./task_events";
import { fail, fieldsOf, numberAt, pointsAt, stringAt, type Fields, type Vec3 } from "./fields";

export type TaskOutcome = "done" | "time_over";

/** Where something is to be done: of the tissue at rest, but for a place in space. */
export interface TaskMark {
  readonly kind: "place" | "line" | "space";
  /** A place, or the points of a line, of a closed one the first again at the end [m]. */
  readonly points_m: readonly Vec3[];
}

/** The message about the task: its status, or null where it cannot be done any more. */
export interface TaskNews {
  readonly type: "task";
  readonly status: TaskStatus | null;
}

export interface TaskStatus {
  readonly title: string;
  readonly begins_in_theatre: boolean;
  /** What is to be done now; empty when it is over. */
  readonly stage: string;
  readonly n_done: number;
  readonly n_stages: number;
  /** How far the stage is, 0 to 1. */
  readonly share: number;
  /** Help, when it takes long. */
  readonly hint: string | null;
  readonly mark: TaskMark | null;
  readonly n_mistakes: number;
  readonly mistake: string | null;
  /** Simulated time at which it began; null before an instrument has moved. */
  readonly began_s: number | null;
  /** Simulated time at which it ended. */
  readonly ended_s: number | null;
  readonly time_limit_s: number;
  /** Whether the endoscope's lamp is out. */
  readonly is_dark: boolean;
  /** What can happen, and what has. */
  readonly events: readonly TaskEventNews[];
  readonly outcome: TaskOutcome | null;
}

function textOrNull(fields: Fields, name: string): string | null {
  return fields[name] === null ? null : stringAt(fields, name, "task");
}

function numberOrNull(fields: Fields, name: string): number | null {
  return fields[name] === null ? null : numberAt(fields, name, "task", 0);
}

function decodeMark(value: unknown): TaskMark | null {
  if (value === null) return null;
  const fields = fieldsOf(value, "task.mark");
  const kind = stringAt(fields, "kind", "task.mark");
  if (kind !== "place" && kind !== "line" && kind !== "space") {
    fail(`task.mark.kind is "${kind.slice(0, 40)}"; it may be place, line or space`);
  }
  const points_m = pointsAt(fields, "points_m", "task.mark");
  const isAllowed = kind === "line" ? points_m.length >= 2 : points_m.length === 1;
  if (!isAllowed) fail(`task.mark has ${points_m.length} points; a line has two or more, a place one`);
  return { kind, points_m };
}

/** @throws ProtocolError naming the field that is wrong. */
export function decodeTask(message: Fields): TaskNews {
  return { type: "task", status: message.status === null ? null : decodeStatus(message.status) };
}

function decodeStatus(value: unknown): TaskStatus {
  const fields = fieldsOf(value, "task");
  const outcome = textOrNull(fields, "outcome");
  if (outcome !== null && outcome !== "done" && outcome !== "time_over") {
    fail(`task.outcome is "${outcome.slice(0, 40)}"; it may be done, time_over or null`);
  }
  return {
    title: stringAt(fields, "title", "task"),
    begins_in_theatre: fields.begins_in_theatre === true,
    stage: stringAt(fields, "stage", "task"),
    n_done: numberAt(fields, "n_done", "task", 0),
    n_stages: numberAt(fields, "n_stages", "task", 1),
    share: numberAt(fields, "share", "task", 0),
    hint: textOrNull(fields, "hint"),
    mark: decodeMark(fields.mark),
    n_mistakes: numberAt(fields, "n_mistakes", "task", 0),
    mistake: textOrNull(fields, "mistake"),
    began_s: numberOrNull(fields, "began_s"),
    ended_s: numberOrNull(fields, "ended_s"),
    time_limit_s: numberAt(fields, "time_limit_s", "task", 0),
    is_dark: fields.is_dark === true,
    events: decodeEvents(fields.events),
    outcome,
  };
}

/** Minutes and seconds: `1:05`. */
export function clockText(time_s: number): string {
  const whole_s = Math.max(0, Math.floor(time_s));
  return `${Math.floor(whole_s / 60)}:${String(whole_s % 60).padStart(2, "0")}`;
}

/** The time that a task has taken at `now_s`, and what it may take: `0:12 of 3:00`. */
export function timeText(task: TaskStatus, now_s: number): string {
  if (task.began_s === null) return text("task_begins");
  return text("task_time", { time: clockText(now_s - task.began_s), limit: clockText(task.time_limit_s) });
}

/** How a task ended, in words. */
export function outcomeText(outcome: TaskOutcome): string {
  return text(outcome === "done" ? "task_done" : "task_time_over");
}

/** Shows a report in a tab of its own, or offers it as a file where there is none. */
async function showReport(report: Promise<string>): Promise<void> {
  // At once: later the browser would take it for one that nobody asked for.
  const tab = window.open("", "_blank");
  try {
    const html = await report;
    if (tab === null || tab.closed) {
      download(new Blob([html], { type: "text/html" }), "report.html");
      return;
    }
    tab.document.write(html);
    tab.document.close();
  } catch (error) {
    tab?.close();
    throw error;
  }
}

/** The way to the report: a link to the server's, or a button where the page makes it. `failed` says why there is none. */
function wayToReport(own: OwnReport | undefined): HTMLElement {
  if (own !== undefined) {
    const button = document.createElement("button");
    button.onclick = () => void showReport(own.report()).catch((error: unknown) => own.failed(reasonOf(error)));
    return button;
  }
  const link = document.createElement("a");
  link.href = "report";
  link.target = "_blank";
  link.rel = "noopener";
  return link;
}

/** A report that the page has, and who says that it has none. */
export interface OwnReport {
  report(): Promise<string>;
  failed(reason: string): void;
}

/** That of a simulation in the page. */
export function ownReport(from: { report?(): Promise<string> }, says: { error(words: string): void }): OwnReport | undefined {
  const report = from.report?.bind(from);
  return report && { report, failed: (reason) => says.error(reason) };
}

export class TaskPanel {
  private status: TaskStatus | null = null;
  private readonly title = document.createElement("h2");
  private readonly time = document.createElement("span");
  private readonly stage = document.createElement("p");
  private readonly bar = document.createElement("progress");
  private readonly hint = document.createElement("p");
  private readonly mistake = document.createElement("p");
  private readonly report: HTMLElement;
  private readonly events: TaskEvents;
  private now_s = 0;

  /** `letCome`: who teaches lets an event come, by its number. `own`: the report, where no server has it. */
  constructor(private readonly root: HTMLElement, letCome: (event: number) => void, own?: OwnReport) {
    this.events = new TaskEvents(letCome);
    const head = document.createElement("header");
    head.append(this.title, this.time);
    this.stage.className = "stage";
    this.stage.setAttribute("role", "status");
    this.bar.max = 1;
    this.bar.setAttribute("aria-label", text("task_progress"));
    this.hint.className = "task-hint";
    this.mistake.className = "mistake";
    this.mistake.setAttribute("role", "status");
    this.report = wayToReport(own);
    this.report.textContent = text("task_report");
    root.append(head, this.stage, this.bar, this.hint, this.mistake, this.report, this.events.root);
  }

  /** Answers whether it is the first one of a task that begins with the endoscope's picture. */
  show(status: TaskStatus | null): boolean {
    const isFirst = this.status === null;
    this.status = status;
    this.root.hidden = status === null;
    if (status === null) return false;
    this.title.textContent = status.title;
    const stage = { n: Math.min(status.n_done + 1, status.n_stages), m: status.n_stages, stage: status.stage };
    this.stage.textContent = status.outcome === null ? text("task_stage", stage) : outcomeText(status.outcome);
    this.stage.dataset.outcome = status.outcome ?? "";
    this.bar.value = (status.n_done + status.share) / status.n_stages;
    this.hint.textContent = status.hint ?? "";
    this.hint.hidden = status.hint === null;
    const mistake = status.mistake ?? "";
    this.mistake.textContent = status.n_mistakes > 1 ? text("task_mistakes", { mistake, n: status.n_mistakes }) : mistake;
    this.mistake.hidden = status.mistake === null;
    this.report.hidden = status.outcome === null;
    this.events.show(status.events, status.began_s !== null && status.outcome === null);
    this.tick(this.now_s);
    return isFirst && status.begins_in_theatre;
  }

  /** The simulated time goes on. */
  tick(now_s: number): void {
    this.now_s = now_s;
    if (this.status === null) return;
    const time = timeText(this.status, this.status.ended_s ?? now_s);
    if (this.time.textContent !== time) this.time.textContent = time;
  }
}
