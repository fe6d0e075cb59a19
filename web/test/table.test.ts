import { expect, it } from "vitest";
import type { ClientMessage, Hello } from "../src/protocol";
import { Table, turnedAboutLongAxis } from "../src/table";

it("gravity turns about the patient's long axis and keeps its size", () => {
  const turned = turnedAboutLongAxis([0, 9.81, 1], Math.PI / 2);
  [-9.81, 0, 1].forEach((x, i) => expect(turned[i]).toBeCloseTo(x, 12));
});

it("a table tilted there and back is level, and without gravity it does not tilt", () => {
  const table = new Table();
  // Turned to the patient's left, the weight pulls to the left (+x).
  expect(table.tilt([0, 9.81, 0], 1)?.[0]).toBeCloseTo(9.81 * Math.sin(Math.PI / 12), 12);
  expect(table.tilt([0, 9.81, 0], -1)?.[0]).toBeCloseTo(0, 12);
  table.tilt([0, 9.81, 0], 1);
  table.level();
  expect(table.tilt([0, 9.81, 0], -1)?.[0]).toBeCloseTo(-9.81 * Math.sin(Math.PI / 12), 12);
  expect(table.tilt([0, 0, 0], 1)).toBeNull();
});

it("gravity that was turned keeps its size when the table tilts", () => {
  const sent: number[][] = [];
  const hello = { scene: { gravity_m_per_s2: [0, 9.81, 0] } } as unknown as Hello;
  const server = { send: (message: ClientMessage) => sent.push(message.type === "gravity" ? [...message.m_per_s2] : []) > 0 };
  const table = new Table();
  for (const size of [null, 5]) table.press(1, hello, server, { error: (why) => expect(why).toBe("") }, size);
  expect(sent.map((v) => Math.hypot(...v))).toEqual([expect.closeTo(9.81, 12), expect.closeTo(5, 12)]);
});
