import { expect, it } from "vitest";
import { SlowMotion, SPEEDS } from "../src/slow_motion";

it("goes slower step by step, and then to real time again", () => {
  const slow = new SlowMotion();
  expect(SPEEDS.map(() => slow.next())).toEqual([0.5, 0.25, 0.1, 1]);
});

it("is as fast as the server says: it may have refused, and others may have asked", () => {
  const slow = new SlowMotion();
  slow.next();
  slow.hear({ speed: 1 });
  expect(slow.next()).toBe(0.5);
  slow.hear({ speed: 0.3 });
  expect(slow.next()).toBe(0.25);
  slow.hear({ speed: 0.05 });
  expect(slow.next()).toBe(1);
});
