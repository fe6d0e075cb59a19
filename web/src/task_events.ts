/** Events of a task, such as a lamp that fails: who teaches lets them come by buttons; those that came say when. */
import { fail, fieldsOf, numberAt, stringAt } from "./fields";
import { text } from "./language";

export interface TaskEventNews {
  readonly title: string;
  /** When it came [s after the task's beginning]; null before. */
  readonly came_s: number | null;
}

/** @throws ProtocolError naming the field that is wrong. */
export function decodeEvents(value: unknown): TaskEventNews[] {
  if (value === undefined) return [];
  if (!Array.isArray(value)) fail("task.events is no list");
  return (value as unknown[]).map((event) => {
    const fields = fieldsOf(event, "task.events");
    const came_s = fields.came_s === null ? null : numberAt(fields, "came_s", "task.events", 0);
    return { title: stringAt(fields, "title", "task.events"), came_s };
  });
}

export class TaskEvents {
  readonly root = document.createElement("details");
  private readonly list = document.createElement("div");
  private shown = "";

  constructor(private readonly letCome: (event: number) => void) {
    const summary = document.createElement("summary");
    summary.textContent = text("task_events");
    this.root.className = "task-events";
    this.root.hidden = true;
    this.root.append(summary, this.list);
  }

  /** `canCome`: whether the task goes on. */
  show(events: readonly TaskEventNews[], canCome: boolean): void {
    const now = JSON.stringify([events, canCome]);
    if (now === this.shown) return;
    this.shown = now;
    this.root.hidden = events.length === 0;
    const focused = [...this.list.children].indexOf(document.activeElement as Element);
    const buttons = events.map(({ title, came_s }, number) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = came_s === null ? title : text("task_event_came", { title, time: came_s.toFixed(1) });
      button.disabled = came_s !== null || !canCome;
      button.addEventListener("click", () => this.letCome(number));
      return button;
    });
    this.list.replaceChildren(...buttons);
    buttons[focused]?.focus();
  }
}
