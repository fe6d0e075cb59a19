import { describe, expect, it } from "vitest";
import { gestureOf, wheelNotches } from "../src/controls";
import { actionOf, BINDINGS, toolDirection, type Action } from "../src/keys";

const press = (key: string, more: Partial<Record<"shiftKey" | "ctrlKey" | "altKey" | "metaKey" | "repeat", boolean>> = {}) =>
  actionOf({ key, shiftKey: false, ctrlKey: false, altKey: false, metaKey: false, repeat: false, ...more });

describe("keys", () => {
  it.each<[string, Action]>([
    [" ", "pause"],
    ["ArrowRight", "single_step"],
    [".", "single_step"],
    ["r", "reset_view"],
    ["Backspace", "reset_view"],
    ["w", "wireframe"],
    ["c", "contacts"],
    ["f", "forces"],
    ["t", "fixed_nodes"],
    ["m", "next_model"],
    ["s", "screenshot"],
    ["p", "profiler"],
    ["h", "help"],
    ["F1", "help"],
    ["q", "leave"],
    ["Escape", "leave"],
    ["u", "tool_deeper"],
    ["x", "cut"],
    ["a", "clip"],
  ])("%j does %s", (key, action) => expect(press(key)).toBe(action));

  it("Shift changes R, and lengthens the instrument's steps", () => {
    expect(press("R", { shiftKey: true })).toBe("reset_simulation");
    expect(press("ArrowRight", { shiftKey: true })).toBe("tilt_right");
    expect(press("J", { shiftKey: true })).toBe("tool_left");
    expect(press("W", { shiftKey: true })).toBe("draw");
    expect(press("?", { shiftKey: true })).toBe("help");
  });

  it("with caps lock letters still work", () => expect(press("W")).toBe("wireframe"));

  it("Ctrl, Alt and Meta belong to the browser", () => {
    for (const key of ["ctrlKey", "altKey", "metaKey"] as const) expect(press("r", { [key]: true })).toBeNull();
  });

  it("held down, only steps repeat", () => {
    expect(press(" ", { repeat: true })).toBeNull();
    expect(press("w", { repeat: true })).toBeNull();
    expect(press(".", { repeat: true })).toBe("single_step");
    expect(press("u", { repeat: true })).toBe("tool_deeper");
    expect(press("x", { repeat: true })).toBe("cut");
  });

  it("no chord is bound twice", () => {
    const chords = BINDINGS.flatMap((b) => b.chords.map((c) => `${c.shift} ${c.key}`));
    expect(new Set(chords).size).toBe(chords.length);
  });

  it("movement keys come in opposite pairs", () => {
    const sum = BINDINGS.map((b) => toolDirection(b.action))
      .filter((d) => d !== null)
      .reduce<number[]>((s, d) => s.map((x, i) => x + d[i]), [0, 0, 0]);
    expect(sum).toEqual([0, 0, 0]);
  });
});

describe("mouse", () => {
  const begin = (button: number, onOrgan: boolean, more: { altKey?: boolean; shiftKey?: boolean } = {}) =>
    gestureOf({ button, onOrgan, altKey: false, shiftKey: false, ...more });
  it("left pushes the organ and turns the view beside it", () => {
    expect(begin(0, true)).toBe("push");
    expect(begin(0, false)).toBe("turn");
    expect(begin(0, true, { altKey: true })).toBe("turn");
    expect(begin(0, true, { shiftKey: true })).toBe("push");
    expect(begin(0, false, { shiftKey: true })).toBe("move");
  });
  it("middle moves, right turns, others do nothing", () => {
    expect(begin(1, true)).toBe("move");
    expect(begin(2, true)).toBe("turn");
    expect(begin(3, true)).toBeNull();
  });
  it("wheel in pixels, lines and pages; forward is positive", () => {
    expect(wheelNotches(-100, 0)).toBe(1);
    expect(wheelNotches(3, 1)).toBe(-1);
    expect(wheelNotches(-1, 2)).toBe(1);
    expect(wheelNotches(-1e9, 0)).toBe(5);
    expect(wheelNotches(NaN, 0)).toBe(0);
  });
});
