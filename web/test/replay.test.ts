import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { BINDINGS } from "../src/keys";
import { PLAYER_BINDINGS, PLAYER_BUTTONS } from "../src/replay/keys";
import { between } from "../src/replay/between";
import { Taker } from "../src/bytes";
import { timeInFragment } from "../src/replay/fragment";
import { bytesOfBase64 } from "../src/base64";
import { neighbour, Playback } from "../src/replay/playback";
import { Recording, type Shown } from "../src/replay/recording";
import { decodeStory, endingText } from "../src/replay/story";
import { Bookmarks, bookmarksInFragment, fragmentOf, LONGEST_TEXT, nameOfRecording } from "../src/replay/bookmarks";
import { Clock } from "../src/replay/clock";
import { decodeNotes, drawnAt } from "../src/replay/notes";
import { envelope, timeText } from "../src/replay/timeline";

/** Written by `crates/glisson-view/src/recording/tests.rs`: a sheet of 9 by 9 nodes that sinks where an instrument goes over it. */
const FIXTURE = bytesOfBase64(readFileSync(new URL("recording.glsr.txt", import.meta.url), "utf8").trim());
const SIDE = 9;
const STEP_M = 5e-5;

async function frameOf(recording: Recording, frame: number): Promise<Shown> {
  const failed = (error: unknown): never => { throw error; };
  await recording.load(frame);
  const shown = recording.at(frame, () => undefined, failed);
  expect(shown).not.toBeNull();
  return shown!;
}

/** Where the test of the program puts a node at a frame [m]. */
function placeOf(node: number, time_s: number): number[] {
  const rest = [5e-3 * (node % SIDE), node === SIDE * SIDE ? 5e-3 : 0, 5e-3 * Math.floor(node / SIDE)].map((x) => x - 0.0123);
  const tip = [0.01 * time_s, -0.01, 0.004];
  const square = rest.reduce((sum, x, k) => sum + (x - tip[k]) ** 2, 0);
  return [rest[0], rest[1] + 0.008 * Math.exp(-square / 4e-4), rest[2]];
}

describe("a recording", () => {
  it("says at once how long it is and which forces there were", async () => {
    const recording = await Recording.read(FIXTURE);
    expect([recording.nFrames, recording.rate_hz, recording.step_m]).toEqual([80, 30, STEP_M]);
    expect(recording.end_s).toBeCloseTo(80 / 30, 4);
    expect(recording.forces_n[29]).toEqual([1, 1]);
    expect(recording.helloAt(0).tools.map(({ name }) => name)).toEqual(["first", "second"]);
    expect(recording.helloAt(79)).toBe(recording.helloAt(0));
    expect(recording.story).toBeNull();
    expect([-1, 0, 0.5, 1.0001, 99].map((t) => recording.frameAt(t))).toEqual([0, 0, 14, 29, 79]);
  });

  it.each([0, 1, 39, 40, 41, 59, 60, 69, 70, 79])("shows frame %i within half a step", async (frame) => {
    const recording = await Recording.read(FIXTURE);
    const { snapshot: { header, positions_m }, topology } = await frameOf(recording, frame);
    const time_s = (frame + 1) / 30;
    const version = frame < 40 ? 0 : frame < 70 ? 1 : 2;
    expect([header.step, header.version, topology.version]).toEqual([10 * (frame + 1), version, version]);
    expect(topology.nodeIds.length).toBe([81, 80, 82][version]);
    expect(topology.triangles.length).toBe(3 * [128, 127, 129][version]);
    expect(topology.isCut.reduce((sum, x) => sum + x, 0)).toBe(version === 2 ? 1 : 0);
    expect(topology.bodyOf[topology.nodeIds.indexOf(20)]).toBe(1);
    topology.nodeIds.forEach((node, i) => {
      placeOf(node, time_s).forEach((x, k) => expect(Math.abs(positions_m[3 * i + k] - x)).toBeLessThan(0.5 * STEP_M + 1e-7));
    });
    expect(header.tools.length).toBe(2);
    const [tool] = header.tools;
    expect(tool.forceOnTool_n[1]).toBeCloseTo(-time_s, 12);
    expect([tool.contact, tool.heldNodes, tool.jaw]).toEqual([true, frame % 2, 0.5]);
    expect(header.bleeding?.ends.length).toBe(version === 0 ? 0 : 1);
    expect(header.threads.length).toBe(version === 2 ? 1 : 0);
  });

  it("is the same whichever way one comes to a frame", async () => {
    const recording = await Recording.read(FIXTURE);
    const first = await frameOf(recording, 45);
    for (const frame of [46, 70, 79, 20, 0]) await frameOf(recording, frame);
    const again = await frameOf(recording, 45);
    expect(again.snapshot).toEqual(first.snapshot);
    expect(again.topology).toEqual(first.topology);
  });

  it("that is broken is refused with a reason", async () => {
    await expect(Recording.read(new Uint8Array(4))).rejects.toThrow(/does not begin with GLSR/);
    const newer = FIXTURE.slice();
    newer[4] = 2;
    await expect(Recording.read(newer)).rejects.toThrow(/version 2 of the format, this page plays 1/);
    await expect(Recording.read(FIXTURE.slice(0, FIXTURE.length - 10))).rejects.toThrow(/ends too early/);
    await expect(Recording.read(FIXTURE.slice(0, 40))).rejects.toThrow();
    const changed = FIXTURE.slice();
    changed[FIXTURE.length - 100] ^= 0xff;
    const recording = await Recording.read(changed);
    await expect(recording.load(70)).rejects.toThrow();
  });
});

describe("between two frames", () => {
  it("things are on straight lines, but where another surface follows", async () => {
    const recording = await Recording.read(FIXTURE);
    const [a, b, c] = [(await frameOf(recording, 38)).snapshot, (await frameOf(recording, 39)).snapshot, (await frameOf(recording, 40)).snapshot];
    const half = between(a, b, 0.5);
    half.positions_m.forEach((x, i) => expect(x).toBeCloseTo((a.positions_m[i] + b.positions_m[i]) / 2, 7));
    expect(half.header.tools[0].tip_m[0]).toBeCloseTo((a.header.tools[0].tip_m[0] + b.header.tools[0].tip_m[0]) / 2, 12);
    expect(half.header.tools[0].heldNodes).toBe(a.header.tools[0].heldNodes);
    expect(between(a, b, 0)).toBe(a);
    expect(between(b, c, 0.5)).toBe(b);
  });

  it("an instrument that was put elsewhere does not fly there", async () => {
    const recording = await Recording.read(FIXTURE);
    const a = (await frameOf(recording, 0)).snapshot;
    const far = { ...a, header: { ...a.header, tools: a.header.tools.map((tool) => ({ ...tool, tip_m: [1, 0, 0] as const })) } };
    expect(between(a, far, 0.5).header.tools).toEqual(a.header.tools);
  });
});

describe("numbers", () => {
  it("are read as the program writes them", () => {
    const taker = new Taker(Uint8Array.from([0, 1, 2, 0xfe, 0xff, 0xff, 0xff, 0x0f, 0xff, 0xff, 0xff, 0xff, 0x0f]));
    expect([0, 1, 2, 3, 4].map(() => taker.signed())).toEqual([0, -1, 1, 2 ** 31 - 1, -(2 ** 31)]);
    expect(() => taker.byte()).toThrow(/ends too early/);
    expect(() => new Taker(Uint8Array.from([0xff, 0xff, 0xff, 0xff, 0x1f])).number()).toThrow(/32 bits/);
  });
});

describe("the clock", () => {
  it("goes at its speed, stands at the end and begins anew from there", () => {
    const playback = new Playback(1, 3);
    playback.advance(1);
    expect(playback.time_s).toBe(1);
    playback.toggle();
    playback.faster(-1);
    playback.advance(1);
    expect([playback.time_s, playback.speed]).toEqual([1.5, 0.5]);
    playback.faster(99);
    expect(playback.speed).toBe(8);
    playback.advance(1);
    expect([playback.time_s, playback.playing]).toEqual([3, false]);
    playback.toggle();
    expect([playback.time_s, playback.playing]).toEqual([1, true]);
    playback.faster(-99);
    expect(playback.speed).toBe(0.1);
    playback.jump(-5);
    expect(playback.time_s).toBe(1);
  });

  it("finds the moments beside a time", () => {
    expect(neighbour([1, 2, 3], 2, true)).toBe(3);
    expect(neighbour([1, 2, 3], 2, false)).toBe(1);
    expect(neighbour([1, 2, 3], 3, true)).toBeNull();
    expect(neighbour([], 3, false)).toBeNull();
  });
});

describe("the timeline", () => {
  it("keeps the largest force of each stretch and its place", () => {
    const forces = [[0], [5], [1], [0], [2], [9]];
    expect(envelope(forces, 0, 2)).toEqual([[0.2, 5], [1, 9]]);
    expect(envelope(forces, 0, 100).length).toBe(6);
    expect(envelope(forces, 3, 2).map(([, force]) => force)).toEqual([0, 0]);
  });

  it("writes times to a hundredth", () => {
    expect([0, 5.254, 65.999, -1].map(timeText)).toEqual(["0:00.00", "0:05.25", "1:06.00", "0:00.00"]);
  });
});

describe("the story of a task", () => {
  const result = { title: "Find it", began_s: 10, outcome: "done", is_passed: true, n_stages: 2, stages: [{ title: "Touch", began_s: 0, ended_s: 1 }], moments: [{ fault: "force", from_s: 1, to_s: 2, tool: null, detail: "5 N" }] };

  it("is read with the titles of what went wrong", () => {
    const story = decodeStory({ result, titles: ["Too much force"] })!;
    // Ten seconds in, an instrument moved: the result counts from then on, the recording from its beginning.
    expect(story.moments).toEqual([{ title: "Too much force", detail: "5 N", from_s: 11, to_s: 12, tool: null }]);
    expect(story.stages).toEqual([{ title: "Touch", began_s: 10, ended_s: 11 }]);
    expect(endingText(story)).toBe("1 of 2 stages: passed");
    expect(endingText({ ...story, outcome: null })).toBe("1 of 2 stages; not finished");
    expect(() => decodeStory({ result: { ...result, stages: 3 }, titles: [] })).toThrow(/task.stages must be an array/);
  });
});

describe("the player's keys", () => {
  it("mean one thing each, and buttons tell keys that there are", () => {
    const chords = PLAYER_BINDINGS.flatMap((b) => b.chords.map((c) => `${c.shift} ${c.key}`));
    expect(new Set(chords).size).toBe(chords.length);
    for (const { action } of PLAYER_BUTTONS.flat()) expect(PLAYER_BINDINGS.some((b) => b.action === action), action).toBe(true);
  });

  it("are those of the viewer where they do the same", () => {
    for (const action of ["reset_view", "wireframe", "forces", "fixed_nodes", "theatre", "wipe", "outside", "screenshot", "help"] as const) {
      const chordsOf = (bindings: ReadonlyArray<{ readonly action: string; readonly chords: unknown }>): unknown => bindings.find((b) => b.action === action)?.chords;
      expect(chordsOf(PLAYER_BINDINGS)).toEqual(chordsOf(BINDINGS));
    }
  });
});

describe("the page's address", () => {
  it.each([["#t=12.3", 12.3], ["t=0", 0], ["#view=theatre&t=7", 7], ["#t=007.50", 7.5]])("%s asks for %f s", (fragment, time_s) => {
    expect(timeInFragment(fragment)).toBe(time_s);
  });

  it.each(["", "#", "#t=", "#t=-1", "#t=abc", "#t=1e3", "#t=0x10", "#t=Infinity", "#t=1.", "#time=3"])("%j asks for none", (fragment) => {
    expect(timeInFragment(fragment)).toBeNull();
  });
});

describe("what was kept of a session", () => {
  const bookmark = (time_s: number, text = "") => ({ kind: "bookmark", time_s, text });

  it("is the last text of each moment, in the order of time", () => {
    const { bookmarks } = decodeNotes([bookmark(3, "c"), bookmark(1), bookmark(1, "a"), { kind: "erased", time_s: 2 }]);
    expect(bookmarks.map(({ time_s, text }) => [time_s, text])).toEqual([[1, "a"], [3, "c"]]);
    expect(decodeNotes(undefined)).toEqual({ bookmarks: [], drawings: [] });
  });

  it("is drawn from its moment until it is erased", () => {
    const stroke = (x: number) => [[x, 0, 0], [x, 1, 0]];
    const drawing = (time_s: number, x: number) => ({ kind: "drawing", time_s, points_m: stroke(x) });
    const notes = decodeNotes([drawing(1, 1), drawing(2, 2), { kind: "erased", time_s: 3 }, drawing(4, 3)]);
    const drawn = (time_s: number) => drawnAt(notes, time_s).map(([[x]]) => x);
    expect([0.9, 1, 2.5, 3, 4.5].map(drawn)).toEqual([[], [1], [1, 2], [], [3]]);
  });

  it.each([[{}], [[{ kind: "bookmark" }]], [[{ kind: "song", time_s: 1 }]], [[{ kind: "drawing", time_s: 1, points_m: [] }]], [[bookmark(-1)]]])(
    "%j is refused", (notes) => expect(() => decodeNotes(notes)).toThrow(),
  );

  it("stands in the recording", async () => {
    const { notes } = await Recording.read(FIXTURE);
    expect(notes.bookmarks).toEqual([{ time_s: 0.5, text: "here" }]);
    expect([0.5, 1.5, 2.5].map((time_s) => drawnAt(notes, time_s).length)).toEqual([0, 1, 0]);
  });
});

describe("bookmarks of who looks on", () => {
  const memory = () => {
    const kept = new Map<string, string>();
    return { kept, getItem: (key: string) => kept.get(key) ?? null, setItem: (key: string, value: string) => void kept.set(key, value) };
  };
  const recorded = [{ time_s: 1, text: "in it" }];

  it("lie between those of the recording, are named, taken away and kept for it alone", () => {
    const store = memory();
    const bookmarks = new Bookmarks(() => recorded, "x", 10, store);
    expect(bookmarks.set(2.503, "  it\u0007 bleeds ")).toBe(2.5);
    bookmarks.set(0.25, "");
    expect(bookmarks.all.map(({ time_s, text, isOwn }) => [time_s, text, isOwn])).toEqual([[0.25, "", true], [1, "in it", false], [2.5, "it  bleeds", true]]);
    bookmarks.set(2.5, "é".repeat(LONGEST_TEXT + 5));
    expect([...bookmarks.all[2].text].length).toBe(LONGEST_TEXT);
    bookmarks.remove(0.25);
    expect(new Bookmarks(() => recorded, "x", 10, store).all.map(({ time_s }) => time_s)).toEqual([1, 2.5]);
    expect(new Bookmarks(() => recorded, "y", 10, store).all.length).toBe(1);
  });

  it("come and go with an address, whatever stands in it", () => {
    const list = [{ time_s: 1.5, text: "50 % & more ~ #1" }, { time_s: 3, text: "" }];
    const fragment = fragmentOf(12.345, list);
    expect(fragment.startsWith("#t=12.3")).toBe(true);
    expect(bookmarksInFragment(fragment)).toEqual(list);
    expect(bookmarksInFragment("#t=1&b=never&b=&b=1e9&b=-1")).toEqual([]);
    const bookmarks = new Bookmarks(() => recorded, "x", 2, memory());
    expect(bookmarks.take(fragment)).toBe(true);
    expect(bookmarks.ofViewer).toEqual([list[0]]);
    expect(bookmarks.take("#t=1")).toBe(false);
  });

  it("are none where the browser's memory has something else, or none", () => {
    for (const text of ["{", "7", '[{"time_s":"a","text":1},null]']) {
      const store = memory();
      store.setItem("glisson_bookmarks_x", text);
      expect(new Bookmarks(() => [], "x", 1, store).all).toEqual([]);
    }
    const full = { getItem: () => null, setItem: () => { throw new Error("full"); } };
    const bookmarks = new Bookmarks(() => [], "x", 9, full);
    bookmarks.set(1, "");
    expect(bookmarks.all.length).toBe(1);
  });

  it("have a name of their own for each recording", () => {
    expect(nameOfRecording(FIXTURE)).not.toBe(nameOfRecording(FIXTURE.subarray(0, FIXTURE.length - 1)));
    const other = FIXTURE.slice();
    other[40] ^= 1;
    expect(nameOfRecording(other)).not.toBe(nameOfRecording(FIXTURE));
  });
});

describe("the clock", () => {
  const timed = (begin_s: number, end_s: number, began_s: number | null | undefined = undefined, rate_hz = 10) => ({
    begin_s, end_s, rate_hz, times_s: [begin_s, end_s], story: began_s === undefined ? null : { began_s },
  });

  it("of one recording is its time", () => {
    const clock = new Clock([timed(0.1, 3, 1)]);
    expect([clock.begin_s, clock.end_s, clock.start_s(0), clock.timeIn(0, 2), clock.frameAt(2.9)]).toEqual([0.1, 3, 0, 2, 0]);
    expect(clock.canBeginWithTask).toBe(false);
  });

  it("of two begins with the first motion of both tasks, or with the recordings", () => {
    const clock = new Clock([timed(0, 4, 1), timed(0, 6, 2, 20)]);
    expect(clock.beginning).toBe("task");
    expect([clock.begin_s, clock.end_s]).toEqual([-2, 4]);
    // A stands at its beginning until its time comes, and at its end when B goes on.
    expect([-2, -0.5, 0, 1, 4].map((time_s) => clock.timeIn(0, time_s))).toEqual([0, 0.5, 1, 2, 4]);
    expect([-2, 0, 4].map((time_s) => clock.timeIn(1, time_s))).toEqual([0, 2, 6]);
    expect(clock.frames_s.length).toBe(6 * 20 + 1);
    expect(clock.frameAt(-1.45)).toBe(11);
    clock.beginWith("recording");
    expect([clock.begin_s, clock.end_s, clock.start_s(0), clock.start_s(1)]).toEqual([0, 6, 0, 0]);
  });

  it.each([[[timed(0, 4, 1), timed(1, 6)]], [[timed(0, 4, 1), timed(1, 6, null)]]])("begins with the recordings where a task was not begun", (pair) => {
    const clock = new Clock(pair);
    expect([clock.beginning, clock.begin_s, clock.end_s]).toEqual(["recording", 0, 5]);
    expect([clock.timeIn(0, 1), clock.timeIn(1, 1)]).toEqual([1, 2]);
  });
});
