/** What a recording says of its task: stages, what went wrong, and how it ended. */
import { fieldsOf, fail, numberAt, stringAt, type Fields } from "../fields";
import { text } from "../language";
import type { TaskOutcome } from "../task";

export interface Stage {
  readonly title: string;
  readonly began_s: number;
  readonly ended_s: number;
}

/** A moment that went wrong. */
export interface Moment {
  readonly title: string;
  readonly detail: string;
  readonly from_s: number;
  readonly to_s: number;
  /** Number of the instrument; null if it was none. */
  readonly tool: number | null;
}

/** What became of a task; all times are those of the recording. */
export interface Story {
  readonly title: string;
  /** When an instrument was first moved; null if none was. */
  readonly began_s: number | null;
  readonly outcome: TaskOutcome | null;
  readonly isPassed: boolean;
  readonly nStages: number;
  readonly stages: readonly Stage[];
  readonly moments: readonly Moment[];
}

function listAt(value: unknown, name: string): unknown[] {
  if (!Array.isArray(value)) fail(`task.${name} must be an array`);
  return value;
}

/** Decodes the task of a recording; null for none. @throws ProtocolError */
export function decodeStory(value: unknown): Story | null {
  if (value == null) return null;
  const task = fieldsOf(value, "task");
  const result = fieldsOf(task.result, "task.result");
  const titles = listAt(task.titles, "titles");
  const { outcome } = result;
  if (outcome != null && outcome !== "done" && outcome !== "time_over") fail("task.outcome may be done, time_over or null");
  // The result counts from the first motion of an instrument on.
  const first_s = result.began_s == null ? 0 : numberAt(result, "began_s", "task", 0);
  const timeAt = (of: Fields, name: string, place: string): number => first_s + numberAt(of, name, place);
  return {
    title: stringAt(result, "title", "task"),
    began_s: result.began_s == null ? null : first_s,
    outcome: outcome ?? null,
    isPassed: result.is_passed === true,
    nStages: numberAt(result, "n_stages", "task", 0),
    stages: listAt(result.stages, "stages").map((item) => {
      const stage = fieldsOf(item, "task.stage");
      return { title: stringAt(stage, "title", "stage"), began_s: timeAt(stage, "began_s", "stage"), ended_s: timeAt(stage, "ended_s", "stage") };
    }),
    moments: listAt(result.moments, "moments").map((item, i) => {
      const moment = fieldsOf(item, "task.moment");
      return {
        title: String(titles[i] ?? ""),
        detail: stringAt(moment, "detail", "moment"),
        from_s: timeAt(moment, "from_s", "moment"),
        to_s: timeAt(moment, "to_s", "moment"),
        tool: moment.tool == null ? null : numberAt(moment, "tool", "moment", 0),
      };
    }),
  };
}

/** How the task ended, in words. */
export function endingText({ outcome, isPassed, stages, nStages }: Story): string {
  const share = text("replay_share", { n: stages.length, m: nStages });
  if (outcome === "done") return text(isPassed ? "replay_passed" : "replay_gate", { share });
  return text(outcome === "time_over" ? "replay_time_over" : "replay_not_finished", { share });
}
