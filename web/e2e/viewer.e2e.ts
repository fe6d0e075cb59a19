import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { MAGIC } from "../src/protocol";
import { DIST, openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { checkDragShowsServerState, keepSendingRestShape } from "./drag_check";
import { startFakeServer, type RunningServer } from "./fake_server";

const length = (v: readonly number[]): number => Math.hypot(...v);

describe("the viewer in front of the test ellipsoid", () => {
  let browser: Browser;
  let server: RunningServer;
  let page: Page;
  let problems: string[];

  beforeAll(async () => {
    browser = await startBrowser();
  });
  afterAll(async () => {
    await browser?.close();
  });
  beforeEach(async () => {
    server = await startFakeServer(DIST);
    ({ page, problems } = await openPage(browser));
  });
  afterEach(async () => {
    await page.close();
    await server.close();
  });

  const open = async (): Promise<void> => {
    await page.goto(server.url);
    await waitForOrgan(page);
  };
  const view = () => page.evaluate(() => window.glisson!.view);
  const cell = async (key: string): Promise<string> =>
    (await page.locator(`[data-value="${key}"]`).textContent()) ?? "";
  const until = (what: () => boolean) => page.waitForFunction(what, undefined, { timeout: 15_000 });

  /** The tip that is shown is the one that the hand wants. */
  const arrived = () =>
    until(() => {
      const { tool, header } = window.glisson!;
      const { sentTip, settled } = tool;
      return settled && sentTip !== null && Math.hypot(...header!.tip_m.map((x, i) => x - sentTip[i])) < 1e-9;
    });

  it("drag: shows what the server computed", async () => {
    const report = await checkDragShowsServerState(page, server.url, resultFile("fake-drag.png"));
    console.log(JSON.stringify(report));
    // The contact is sticky and exact here: the vertex stays under the pointer.
    expect(report.pointerDistance_px).toBeLessThan(3);
    expect(problems).toEqual([]);
  });

  it("drag: the check rejects a server that keeps sending the rest shape", async () => {
    const route = await keepSendingRestShape(page);
    await expect(checkDragShowsServerState(page, server.url)).rejects.toThrow(/displayed displacement .* differs by/);
    expect(route.rewritten()).toBeGreaterThan(0);
  });

  it("release takes the tool off the organ, and a tool message goes out at most once a frame", async () => {
    await open();
    // Counted for as long as the hand moves, however slow the machine is.
    const frames = await page.evaluateHandle(() => {
      const counted = { count: 0 };
      const tick = () => {
        counted.count += 1;
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
      return counted;
    });
    await page.mouse.move(720, 420);
    await page.mouse.down();
    await until(() => window.glisson!.header!.contact && window.glisson!.tool.settled);
    for (let i = 0; i < 60; i++) await page.mouse.move(720 + i, 420);
    await page.mouse.up();
    await until(() => !window.glisson!.header!.contact && window.glisson!.tool.settled);
    expect(await cell("contact")).toBe("no");
    const sent = await page.evaluate(() => window.glisson!.counters.sentToolMessages);
    expect(sent).toBeGreaterThan(5);
    expect(sent).toBeLessThanOrEqual(await frames.evaluate((counted) => counted.count));
  });

  it("wheel while pushing goes deeper, wheel otherwise zooms", async () => {
    await open();
    const before = await view();
    await page.mouse.move(720, 420);
    await page.mouse.down();
    await arrived();
    const tip = await page.evaluate(() => window.glisson!.header!.tip_m);
    await page.mouse.wheel(0, -300);
    await page.waitForTimeout(100);
    await arrived();
    const deeper = await page.evaluate(() => window.glisson!.header!.tip_m);
    expect(length(deeper.map((x, i) => x - tip[i]))).toBeCloseTo(0.003, 4);
    expect((await view()).distance_m).toBe(before.distance_m);
    await page.mouse.up();
    await page.mouse.wheel(0, -300);
    await page.waitForTimeout(100);
    expect((await view()).distance_m).toBeLessThan(0.8 * before.distance_m);
  });

  it("mouse on the background turns and moves the view, R resets it", async () => {
    await open();
    const start = await view();
    const drag = async (button: "left" | "middle" | "right", x: number, y: number, key?: string): Promise<void> => {
      if (key !== undefined) await page.keyboard.down(key);
      await page.mouse.move(x, y);
      await page.mouse.down({ button });
      await page.mouse.move(x + 60, y + 40, { steps: 3 });
      await page.mouse.up({ button });
      if (key !== undefined) await page.keyboard.up(key);
    };
    const reset = async (key: string): Promise<void> => {
      await page.keyboard.press(key);
      expect(await view()).toEqual(start);
    };
    await drag("left", 1180, 80);
    expect((await view()).azimuth_rad).not.toBe(start.azimuth_rad);
    await reset("r");
    await drag("left", 720, 420, "Alt");
    expect((await view()).azimuth_rad).not.toBe(start.azimuth_rad);
    await reset("Backspace");
    await drag("left", 1180, 80, "Shift");
    expect((await view()).azimuth_rad).toBe(start.azimuth_rad);
    expect((await view()).target_m).not.toEqual(start.target_m);
    await reset("r");
    await drag("middle", 720, 420);
    expect((await view()).target_m).not.toEqual(start.target_m);
    await reset("r");
    // None of it touched the organ.
    expect(await page.evaluate(() => window.glisson!.counters.sentToolMessages)).toBe(0);
  });

  it("keys: pause, single step, reset", async () => {
    await open();
    await page.keyboard.press("Space");
    await until(() => window.glisson!.header!.paused);
    expect(await cell("state")).toBe("paused");
    const step = await page.evaluate(() => window.glisson!.header!.step);
    await page.keyboard.press("ArrowRight");
    await page.keyboard.press(".");
    await page.waitForFunction((s) => window.glisson!.header!.step === s, step + 2);
    await page.keyboard.press("Shift+R");
    await until(() => window.glisson!.header!.step === 0);
    await page.keyboard.press("Space");
    await until(() => !window.glisson!.header!.paused);
    expect(await cell("state")).toBe("running");
    // The same by buttons, and after a click the space bar still pauses.
    await page.locator('[data-action="pause"]').click();
    await until(() => window.glisson!.header!.paused);
    await page.keyboard.press("Space");
    await until(() => !window.glisson!.header!.paused);
    expect(problems).toEqual([]);
  });

  it("keys: what is shown", async () => {
    await open();
    const drawn = (): Promise<Buffer> => page.screenshot({ clip: { x: 300, y: 60, width: 800, height: 600 } });
    const surface = await drawn();
    await page.keyboard.press("w");
    expect((await view()).style).toBe("surface_with_edges");
    await page.waitForTimeout(900);
    expect(surface.equals(await drawn())).toBe(false);
    await page.screenshot({ path: resultFile("fake-edges.png") });
    await page.keyboard.press("w");
    expect((await view()).style).toBe("edges");
    await page.keyboard.press("w");
    expect((await view()).style).toBe("surface");
    for (const [key, name] of [["c", "contacts"], ["f", "forces"], ["t", "fixedNodes"], ["p", "profiler"]] as const) {
      const before = (await view())[name];
      await page.keyboard.press(key);
      expect((await view())[name]).toBe(!before);
    }
    expect(await page.locator("#profiler").textContent()).toContain("snapshots");
    await page.keyboard.press("F1");
    expect((await view()).help).toBe(true);
    await page.screenshot({ path: resultFile("fake-help.png") });
    await page.keyboard.press("Escape");
    expect((await view()).help).toBe(false);
    await page.keyboard.press("h");
    await page.keyboard.press("q");
    expect((await view()).help).toBe(false);
  });

  it("keys: S saves a PNG", async () => {
    await open();
    const [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("s")]);
    expect(download.suggestedFilename()).toMatch(/^glisson-step-\d+\.png$/);
    const path = resultFile("fake-picture.png");
    await download.saveAs(path);
    const { readFile } = await import("node:fs/promises");
    const bytes = await readFile(path);
    expect(bytes.subarray(1, 4).toString()).toBe("PNG");
    expect(bytes.length).toBeGreaterThan(50_000);
  });

  it("the instrument works without a mouse", async () => {
    await open();
    await page.keyboard.press("g");
    await arrived();
    const force = async () => Number.parseFloat(await cell("force"));
    const light = await force();
    for (let i = 0; i < 4; i++) await page.keyboard.press("u");
    await arrived();
    expect(await force()).toBeGreaterThan(light + 0.5);
    await page.keyboard.press("Shift+L");
    await arrived();
    await page.keyboard.press("Escape");
    await until(() => !window.glisson!.header!.contact);
  });

  it("shows how the haptic loop keeps its time, and where it misses deadlines", async () => {
    await open();
    const canvas = page.locator("canvas.jitter");
    expect(await canvas.isVisible()).toBe(false);
    const times = { p50: 3, p99: 12, p999: 41, max: 2600 };
    const haptics = {
      rate_hz: 1000,
      deadlines: 60_000,
      missed_deadlines: 2,
      jitter_us: times,
      jitter_histogram_us: [[0.512, 400], [1.024, 9000], [2.048, 30_000], [4.096, 15_000], [8.192, 4000], [16.384, 900], [32.768, 60], [65.536, 4], [4194.304, 2]],
      tick_us: times,
      period_us: 1000,
      motion_to_force_us: times,
      local_model_age_ms: times,
      scheduling: "SCHED_FIFO 40, on core 1",
    };
    const figures = { p50: 1, p99: 2, p999: 3, max: 4 };
    const steps = { steps: 100, step_us: figures, step_budget_us: 1000, steps_over_budget: 0, frame_ms: figures, frame_budget_ms: 16 };
    const simulation = { rate_hz: 500, real_time_factor: 1, times_given_up: 0, left_out_s: 0, effort: "full", ...steps };
    // At this machine or at the other one: what is told is shown.
    for (const haptics_at of ["here", "other_machine"]) {
      server.simulator.say(JSON.stringify({ type: "timing", simulation, haptics, haptics_at }));
      await page.locator('[data-value="haptic_jitter"]', { hasText: "3 µs, 99.9 % 41" }).waitFor();
      expect(await canvas.isVisible()).toBe(true);
    }
    const colours = await page.evaluate(() => {
      const drawn = document.querySelector<HTMLCanvasElement>("canvas.jitter")!;
      const { data } = drawn.getContext("2d")!.getImageData(0, 0, drawn.width, drawn.height);
      let [blue, red] = [0, 0];
      for (let i = 0; i < data.length; i += 4) {
        if (data[i + 3] > 200 && data[i + 2] > 180) blue += 1;
        if (data[i + 3] > 200 && data[i] > 240 && data[i + 2] < 120) red += 1;
      }
      return { blue, red };
    });
    expect(colours.blue).toBeGreaterThan(1000);
    expect(colours.red).toBeGreaterThan(20);
    await page.locator("#panel").evaluate((panel) => panel.scrollTo(0, 0));
    await page.screenshot({ path: resultFile("fake-haptics.png") });
    server.simulator.say(JSON.stringify({ type: "timing", simulation, haptics: null, haptics_at: "nowhere" }));
    await page.locator('[data-value="haptics"]', { hasText: "no device" }).waitFor();
    expect(await canvas.isVisible()).toBe(false);
  });

  it("a hand that the page holds as a device is felt: number, arrow, gamepad", async () => {
    await page.addInitScript(() => {
      const effects: number[] = [];
      const pad = {
        connected: true,
        axes: [0, 0, 0, 0],
        buttons: [],
        vibrationActuator: {
          playEffect: (_kind: string, effect: { strongMagnitude: number }) => {
            effects.push(effect.strongMagnitude);
            return Promise.resolve("complete");
          },
        },
      };
      Object.assign(window, { effects });
      navigator.getGamepads = () => [pad as unknown as Gamepad];
    });
    await open();
    await page.evaluate(() => window.dispatchEvent(new Event("gamepadconnected")));
    const effects = () => page.evaluate(() => (window as unknown as { effects: number[] }).effects.splice(0));
    const say = (message: object) => server.simulator.say(JSON.stringify(message));
    const feel = (force_n: number, is_held = true) =>
      say({ type: "feel", greatest_force_n: 10, hands: [{ tool: 0, force_n: [0, 0, force_n], is_held }] });
    expect(await cell("hand_force")).toBe("–");
    feel(1.5);
    await page.locator('[data-value="hand_force"]', { hasText: "1.50 N" }).waitFor();
    await page.waitForTimeout(200);
    // Who only watches feels nothing.
    expect(await effects()).toEqual([]);
    say({ type: "role", role: "controller", control_is_taken: true });
    await page.waitForFunction(() => (window as unknown as { effects: number[] }).effects.length > 2);
    expect(new Set(await effects())).toEqual(new Set([0.5]));
    feel(1.5, false);
    await page.locator('[data-value="hand_force"]', { hasText: "let go" }).waitFor();
    await effects();
    await page.waitForTimeout(200);
    expect(await effects()).toEqual([]);
    expect(problems).toEqual([]);
  });

  it("nothing is drawn while nothing changes", async () => {
    await open();
    await page.waitForTimeout(500);
    const counters = () => page.evaluate(() => window.glisson!.counters);
    const before = await counters();
    await page.waitForTimeout(800);
    const after = await counters();
    expect(after.snapshotFrames).toBeGreaterThan(before.snapshotFrames);
    expect(after.drawnFrames).toBe(before.drawnFrames);
    expect(after.topologyFrames).toBe(1);
  });

  it("says in the page what is wrong", async () => {
    await open();
    server.simulator.say(JSON.stringify({ type: "error", message: "the tool left the room" }));
    await page.locator(".message", { hasText: "the tool left the room" }).waitFor();
    server.simulator.sayBytes(new Uint8Array(new Uint32Array([MAGIC, 2, 1, 0, 0]).buffer));
    await page.locator(".message", { hasText: "snapshot of 20 bytes; its header has 64" }).waitFor();
    server.simulator.say("}{");
    await page.locator(".message", { hasText: "not JSON" }).waitFor();
    expect(problems.some((text) => text.includes("the tool left the room"))).toBe(true);
    expect(await page.locator('.message[data-kind="error"][role="alert"]').count()).toBe(3);
    // It goes on all the same.
    const frames = await page.evaluate(() => window.glisson!.counters.snapshotFrames);
    await page.waitForFunction((n) => window.glisson!.counters.snapshotFrames > n, frames);
    await page.locator(".message button").first().click();
    expect(await page.locator(".message").count()).toBe(2);
  });

  it("says calmly what is as it should be", async () => {
    await open();
    server.simulator.say(JSON.stringify({ type: "news", message: "the script is over" }));
    const news = page.locator(".message", { hasText: "the script is over" });
    await news.waitFor();
    expect(await news.getAttribute("role")).toBe("status");
    expect(await news.getAttribute("data-kind")).toBe("news");
    expect(problems).toEqual([]);
  });

  it("says when the connection is lost and comes back", async () => {
    await open();
    const port = Number(new URL(server.url).port);
    await server.close();
    await page.locator("#banner", { hasText: "Connection to the simulator lost" }).waitFor();
    expect(await page.evaluate(() => window.glisson!.connection)).toBe("lost");
    await page.screenshot({ path: resultFile("fake-lost.png") });
    server = await startFakeServer(DIST, port);
    await page.locator("#banner").waitFor({ state: "hidden" });
    await page.waitForFunction(() => window.glisson!.counters.connections === 2 && window.glisson!.header !== null);
    expect(await page.evaluate(() => window.glisson!.counters.topologyFrames)).toBe(2);
  });

  it("the test hook gives copies and cannot be changed", async () => {
    await open();
    const kept = await page.evaluate(() => {
      const viewer = window.glisson!;
      viewer.positions!.fill(9);
      const changed = Reflect.set(viewer, "header", null) || Reflect.set(window, "glisson", null);
      return { first: viewer.positions![0], changed };
    });
    expect(kept.first).not.toBe(9);
    expect(kept.changed).toBe(false);
  });
});
