import { describe, expect, it } from "vitest";
import { Controls, pinchNotches } from "../src/controls";

/** A canvas of 100 x 100 pixels of which the left half is organ, and what was asked for. */
function touched(canPushTwice = true) {
  const listeners = new Map<string, (event: object) => void>();
  const held = new Set<number>();
  const canvas = {
    style: { cursor: "" },
    addEventListener: (name: string, act: (event: object) => void) => listeners.set(name, act),
    getBoundingClientRect: () => ({ left: 0, top: 0 }),
    setPointerCapture: (id: number) => held.add(id),
    hasPointerCapture: (id: number) => held.has(id),
    releasePointerCapture: (id: number) => held.delete(id),
  };
  const asked: string[] = [];
  const note = (...what: unknown[]): void => void asked.push(what.map((x) => (typeof x === "number" ? Number(x.toFixed(3)) : x)).join(" "));
  const controls = new Controls(canvas as unknown as HTMLCanvasElement, {
    isOnOrgan: (x) => x < 50,
    pushBegin: (x, y, hand) => {
      const begins = x < 50 && (hand === "first" || canPushTwice);
      if (begins) note("begin", hand, x, y);
      return begins;
    },
    pushMove: (x, y, hand) => note("push", hand, x, y),
    pushEnd: (hand) => note("end", hand),
    turn: (dx, dy) => note("turn", dx, dy),
    move: (dx, dy) => note("move", dx, dy),
    wheel: (notches) => note("wheel", notches),
  });
  const send = (name: string, pointerId: number, clientX: number, clientY: number): string[] => {
    asked.length = 0;
    listeners.get(name)!({ pointerId, clientX, clientY, button: 0, altKey: false, shiftKey: false });
    return [...asked];
  };
  return { controls, send, asked, held };
}

describe("pointers on the canvas", () => {
  it("two on the organ are two hands, and each is lifted by itself", () => {
    const { send } = touched();
    expect(send("pointerdown", 1, 10, 10)).toEqual(["begin first 10 10"]);
    expect(send("pointerdown", 2, 20, 20)).toEqual(["begin second 20 20"]);
    expect(send("pointermove", 1, 12, 10)).toEqual(["push first 12 10"]);
    expect(send("pointermove", 2, 22, 20)).toEqual(["push second 22 20"]);
    expect(send("pointerup", 1, 12, 10)).toEqual(["end first"]);
    expect(send("pointermove", 2, 24, 20)).toEqual(["push second 24 20"]);
    // The first hand is free again, the second one is not.
    expect(send("pointerdown", 3, 10, 10)).toEqual(["begin first 10 10"]);
    expect(send("pointerup", 2, 24, 20)).toEqual(["end second"]);
    expect(send("pointerup", 3, 10, 10)).toEqual(["end first"]);
  });

  it("one that has nothing to push leads the other deeper and back", () => {
    for (const [x, canPushTwice] of [[80, true], [20, false]] as const) {
      const { send } = touched(canPushTwice);
      send("pointerdown", 1, 10, 10);
      expect(send("pointerdown", 2, x, 60)).toEqual([]);
      expect(send("pointermove", 2, x, 36)).toEqual(["wheel 2"]);
      expect(send("pointermove", 2, x, 48)).toEqual(["wheel -1"]);
      expect(send("pointermove", 1, 11, 10)).toEqual(["push first 11 10"]);
      expect(send("pointerup", 1, 11, 10)).toEqual(["end first"]);
      // It begins anew when it is lifted and comes down again.
      send("pointerup", 2, x, 36);
      expect(send("pointerdown", 2, 10, 10)).toEqual(["begin first 10 10"]);
    }
  });

  it("two beside the organ zoom by their distance and move by their middle", () => {
    const { send } = touched();
    send("pointerdown", 1, 60, 50);
    send("pointerdown", 2, 80, 50);
    const apart = Math.log(40 / 20) / Math.log(1 / 0.9);
    expect(send("pointermove", 2, 100, 50)).toEqual([`wheel ${Number(apart.toFixed(3))}`, "move 10 0"]);
    expect(send("pointermove", 1, 80, 50)).toEqual([`wheel ${Number((-apart).toFixed(3))}`, "move 10 0"]);
    send("pointerup", 2, 100, 50);
    expect(send("pointermove", 1, 81, 52)).toEqual(["turn 1 2"]);
  });

  it("a third finger, and the other buttons of a mouse, change nothing", () => {
    const { send } = touched();
    send("pointerdown", 1, 10, 10);
    expect(send("pointerdown", 1, 10, 10)).toEqual([]);
    send("pointerdown", 2, 20, 20);
    expect(send("pointerdown", 3, 30, 30)).toEqual([]);
    expect(send("pointermove", 3, 40, 30)).toEqual([]);
    expect(send("pointerup", 3, 40, 30)).toEqual([]);
  });

  it("a key ends what both do", () => {
    const { controls, send, asked, held } = touched();
    send("pointerdown", 1, 10, 10);
    send("pointerdown", 2, 20, 20);
    asked.length = 0;
    controls.cancel();
    expect(asked).toEqual(["end first", "end second"]);
    expect(held.size).toBe(0);
    expect(send("pointerup", 1, 10, 10)).toEqual([]);
  });

  it("fingers at one place zoom by nothing", () => {
    expect(pinchNotches([[1, 1], [1, 1]], [[1, 1], [5, 1]])).toBe(0);
  });
});
