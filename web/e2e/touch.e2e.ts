/** A tablet: fingers push, zoom and move, and buttons do what keys do. Two hands at once are in test/controls.test.ts. */
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from "vitest";
import type { Browser, CDPSession, Page } from "playwright-core";
import { DIST, resultFile, startBrowser, waitForOrgan } from "./browser";
import { startFakeServer, type RunningServer } from "./fake_server";
import { faultsOfLayout } from "./layout_check";

type Point = readonly [x: number, y: number];

describe("the viewer under fingers", () => {
  let browser: Browser;
  let server: RunningServer;
  let page: Page;
  let touch: CDPSession;
  let problems: string[];

  beforeAll(async () => {
    browser = await startBrowser();
  });
  afterAll(async () => {
    await browser?.close();
  });
  beforeEach(async () => {
    server = await startFakeServer(DIST);
    const context = await browser.newContext({ viewport: { width: 1024, height: 768 }, hasTouch: true });
    page = await context.newPage();
    problems = [];
    page.on("console", (message) => message.type() === "error" && problems.push(message.text()));
    page.on("pageerror", (error) => problems.push(String(error)));
    touch = await context.newCDPSession(page);
    await page.goto(server.url);
    await waitForOrgan(page);
  });
  afterEach(async () => {
    await page.context().close();
    await server.close();
  });

  const until = (what: () => boolean) => page.waitForFunction(what, undefined, { timeout: 15_000 });
  /** All fingers that are down now. */
  const fingers = async (type: "touchStart" | "touchMove" | "touchEnd", points: readonly Point[]): Promise<void> => {
    await touch.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  };
  const view = () => page.evaluate(() => window.glisson!.view);
  /** The middle of the organ, and a place beside it. */
  const ON: Point = [630, 400];
  const BESIDE: Point = [340, 560];

  it("one finger pushes, a second one beside leads it deeper, both leave it", async () => {
    await fingers("touchStart", [ON]);
    await until(() => window.glisson!.header!.contact && window.glisson!.tool.settled);
    const before_m = (await page.evaluate(() => window.glisson!.tool.sentTip))!;
    const { distance_m } = await view();
    await fingers("touchStart", [ON, BESIDE]);
    await fingers("touchMove", [ON, [BESIDE[0], BESIDE[1] - 60]]);
    await page.waitForFunction(
      (from_m) => window.glisson!.tool.settled && Math.hypot(...window.glisson!.tool.sentTip!.map((x, k) => x - from_m[k])) > 4.9e-3,
      before_m,
      { timeout: 15_000 },
    );
    const way_m = await page.evaluate((from_m) => Math.hypot(...window.glisson!.tool.sentTip!.map((x, k) => x - from_m[k])), before_m);
    expect(way_m * 1e3).toBeCloseTo(5, 6);
    expect((await view()).distance_m).toBe(distance_m);
    await fingers("touchEnd", []);
    await until(() => !window.glisson!.header!.contact && window.glisson!.tool.settled);
    expect(problems).toEqual([]);
  });

  it("one finger beside the organ turns the view, two zoom and move it", async () => {
    const [a, b]: [Point, Point] = [[320, 500], [320, 600]];
    const { azimuth_rad } = await view();
    await fingers("touchStart", [a]);
    await fingers("touchMove", [[330, 500]]);
    await expect.poll(async () => (await view()).azimuth_rad).not.toBe(azimuth_rad);
    await fingers("touchEnd", []);
    const before = await view();
    await fingers("touchStart", [a]);
    await fingers("touchStart", [a, b]);
    await fingers("touchMove", [[320, 450], [320, 650]]);
    // Moves come with the frames.
    await expect.poll(async () => (await view()).distance_m / before.distance_m).toBeCloseTo(0.5, 6);
    const zoomed = await view();
    const way_m = async (from: typeof before) => Math.hypot(...(await view()).target_m.map((x, k) => x - from.target_m[k]));
    expect(await way_m(before)).toBeLessThan(4e-3);
    await fingers("touchMove", [[350, 450], [350, 650]]);
    await expect.poll(() => way_m(zoomed)).toBeGreaterThan(5e-3);
    const moved = await view();
    expect(moved.distance_m).toBeCloseTo(zoomed.distance_m, 9);
    expect(moved.azimuth_rad).toBe(before.azimuth_rad);
    await fingers("touchEnd", []);
    expect(problems).toEqual([]);
  });

  it("buttons of the hand come with the first touch, do what keys do, and repeat while they are held", async () => {
    const deeper = page.locator('#toolbar button[data-action="tool_deeper"]');
    await page.setViewportSize({ width: 820, height: 1180 });
    await page.touchscreen.tap(BESIDE[0], BESIDE[1]);
    await deeper.waitFor();
    const trigger = page.locator('#toolbar button[data-action="trigger"]');
    await trigger.tap();
    await expect.poll(() => trigger.getAttribute("aria-pressed")).toBe("true");
    const before_m = await page.evaluate(() => window.glisson!.header!.tip_m);
    const box = (await deeper.boundingBox())!;
    await fingers("touchStart", [[box.x + box.width / 2, box.y + box.height / 2]]);
    await page.waitForTimeout(1200);
    await fingers("touchEnd", []);
    await until(() => window.glisson!.tool.settled);
    // 1 mm for the press, and one each 80 ms after 0.4 s.
    const way_m = () => page.evaluate((from_m) => Math.hypot(...window.glisson!.header!.tip_m.map((x, k) => x - from_m[k])), before_m);
    await expect.poll(way_m).toBeGreaterThan(4e-3);
    await page.screenshot({ path: resultFile("tablet.png") });
    expect(await faultsOfLayout(page)).toEqual([]);
    expect(problems).toEqual([]);
  });
});
