import { expect, it } from "vitest";
import { SETTLING_MS, SlowMotion, SPEEDS } from "../src/slow_motion";

it("goes slower step by step, and then to real time again", () => {
  const slow = new SlowMotion();
  expect(SPEEDS.map(() => slow.next())).toEqual([0.5, 0.25, 0.1, 1]);
});

it("is as fast as the server says: it may have refused, and others may have asked", () => {
  const slow = new SlowMotion();
  slow.hear({ speed: 0.3 }, 0);
  expect(slow.next(1)).toBe(0.25);
  slow.hear({ speed: 0.05 }, 1 + SETTLING_MS);
  expect(slow.next(2000)).toBe(1);
});

it("does not listen to what the server said before it was asked", () => {
  const slow = new SlowMotion();
  slow.next(1000);
  slow.hear({ speed: 1 }, 1000 + SETTLING_MS - 1);
  expect(slow.speed).toBe(0.5);
  slow.hear({ speed: 1 }, 1000 + SETTLING_MS);
  expect(slow.speed).toBe(1);
});
