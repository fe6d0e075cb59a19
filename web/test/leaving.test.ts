import { describe, expect, it, vi } from "vitest";
import { Leaving, SURE_MS } from "../src/leaving";
import { taskFacts } from "../src/start/lists";

describe("the way back to the start page", () => {
  const pressed = () => {
    const events = { leave: vi.fn(() => true), notice: vi.fn(), changed: vi.fn() };
    return { events, leaving: new Leaving(events) };
  };

  it("is gone when it was asked for twice", () => {
    const { events, leaving } = pressed();
    leaving.press(true, 1000);
    expect(events.leave).not.toHaveBeenCalled();
    expect(leaving.isAsked(1000 + SURE_MS - 1)).toBe(true);
    leaving.press(true, 1000 + SURE_MS - 1);
    expect(events.leave).toHaveBeenCalledTimes(1);
    expect(leaving.isAsked(1000 + SURE_MS)).toBe(false);
  });

  it("the second time does not come too late", () => {
    const { events, leaving } = pressed();
    leaving.press(true, 1000);
    leaving.press(true, 1000 + SURE_MS);
    expect(events.leave).not.toHaveBeenCalled();
    leaving.press(true, 1000 + SURE_MS + 1);
    expect(events.leave).toHaveBeenCalledTimes(1);
  });

  it("leads nowhere where no start page is", () => {
    const { events, leaving } = pressed();
    leaving.press(false, 1);
    leaving.press(false, 2);
    expect(events.leave).not.toHaveBeenCalled();
    expect(events.notice).toHaveBeenCalledTimes(2);
  });
});

it("a task says how much it is", () => {
  expect(taskFacts({ stages: ["a"], time_limit_s: 90 })).toBe("1 stage, at most 1:30");
  expect(taskFacts({ stages: ["a", "b"], time_limit_s: 180 })).toBe("2 stages, at most 3:00");
});
