import { describe, expect, it } from "vitest";
import { decodeText } from "../src/protocol";
import { clockText, timeText, type TaskStatus } from "../src/task";

const STATUS: TaskStatus = {
  title: "Find the nodule",
  begins_in_theatre: true,
  stage: "Touch the liver",
  n_done: 0,
  n_stages: 2,
  share: 0.25,
  hint: null,
  mark: { kind: "line", points_m: [[0, -0.05, 0], [0.05, -0.05, 0]] },
  n_mistakes: 0,
  mistake: null,
  began_s: null,
  ended_s: null,
  time_limit_s: 180,
  is_dark: false,
  events: [{ title: "The light fails", came_s: null }, { title: "The patient coughs", came_s: 12.5 }],
  outcome: null,
};

const read = (status: unknown): TaskStatus | null => {
  const news = decodeText(JSON.stringify({ type: "task", status }));
  if (news.type !== "task") throw new Error(news.type);
  return news.status;
};

describe("the task's message", () => {
  it("is read as it was sent", () => {
    expect(read(STATUS)).toEqual(STATUS);
    const over = { ...STATUS, began_s: 1.5, hint: "left", mistake: "marked 30 mm from the place", n_mistakes: 1, outcome: "time_over" };
    expect(read(over)).toEqual(over);
  });

  it("is refused with the field that is wrong", () => {
    expect(() => read({ ...STATUS, outcome: "won" })).toThrow(/task.outcome is "won"; it may be done/);
    expect(() => read({ ...STATUS, stage: 3 })).toThrow(/task.stage must be a string/);
    expect(() => read({ ...STATUS, mark: { kind: "place", points_m: [] } })).toThrow(/a line has two or more, a place one/);
    const circle = { kind: "line", points_m: [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0]] };
    expect(read({ ...STATUS, mark: circle })?.mark).toEqual(circle);
    expect(() => read({ ...STATUS, events: [{ title: "a", came_s: "now" }] })).toThrow(/task.events.came_s/);
    expect(() => read({ ...STATUS, events: {} })).toThrow(/task.events is no list/);
    expect(() => read({ ...STATUS, n_stages: 0 })).toThrow(/at least 1/);
  });
});

describe("the task's time", () => {
  it("counts from the first motion, in minutes and seconds", () => {
    expect(clockText(65.9)).toBe("1:05");
    expect(timeText(STATUS, 12)).toBe("begins when you move an instrument");
    expect(timeText({ ...STATUS, began_s: 2 }, 75.5)).toBe("1:13 of 3:00");
    expect(timeText({ ...STATUS, began_s: 2 }, 2)).toBe("0:00 of 3:00");
    expect(read(null)).toBe(null);
  });
});
