/**
 * Drag to push, against a running `glisson serve` whose address is in GLISSON_URL. The same check must reject a
 * server that keeps sending the rest shape.
 */
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import type { Browser } from "playwright-core";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { checkDragShowsServerState, keepSendingRestShape } from "./drag_check";
import { cutAtTheMiddle } from "./cut_check";

const url = process.env.GLISSON_URL;
if (url === undefined) console.warn("SKIPPED e2e/drag.e2e.ts: GLISSON_URL is not set (address of a running glisson serve)");

describe.skipIf(url === undefined)(`dragging on ${url}`, () => {
  const address = url ?? "";
  let browser: Browser;

  beforeAll(async () => {
    browser = await startBrowser();
  });
  // A page that stays open keeps the instrument.
  afterEach(async () => {
    await Promise.all(browser.contexts().map((context) => context.close()));
  });
  afterAll(async () => {
    await browser?.close();
  });

  it("shows the server's displacement and force", async () => {
    const { page, problems } = await openPage(browser);
    page.on("requestfailed", (request) => problems.push(`${request.url()} failed`));
    const report = await checkDragShowsServerState(page, address, resultFile("drag.png"));
    console.log(JSON.stringify(report));
    expect(problems).toEqual([]);
  });

  it("key C counts the contacts of a probe that presses, and their forces are the one that is felt", async () => {
    const { page, problems } = await openPage(browser);
    await page.goto(address);
    await waitForOrgan(page);
    await page.keyboard.press("c");
    await page.keyboard.press("g");
    for (let i = 0; i < 4; i++) await page.keyboard.press("u");
    await page.waitForFunction(() => window.glisson!.header!.contact && window.glisson!.tool.settled, undefined, { timeout: 60_000 });
    // Paused, so that all that is read is of one step.
    await page.keyboard.press("Space");
    await page.waitForFunction(() => window.glisson!.header!.paused && (window.glisson!.header!.contactPoints?.points.length ?? 0) > 0);
    const { points, felt_n } = await page.evaluate(() => {
      const header = window.glisson!.header!;
      return { points: header.contactPoints!.points, felt_n: header.forceOnTool_n };
    });
    const sum_n = [0, 1, 2].map((axis) => points.filter((p) => p.kind === "tool_organ").reduce((sum, p) => sum + p.force_n[axis], 0));
    expect(Math.hypot(...felt_n)).toBeGreaterThan(0.01);
    expect(Math.hypot(...sum_n.map((x, i) => x - felt_n[i]))).toBeLessThan(1e-4 * Math.hypot(...felt_n));
    const count = await page.locator('#contacts [data-kind="tool_organ"] td').nth(2).textContent();
    expect(Number(count)).toBe(points.filter((p) => p.kind === "tool_organ").length);
    await page.waitForTimeout(900);
    await page.screenshot({ path: resultFile("contacts.png") });
    await page.keyboard.press("Shift+R");
    await page.keyboard.press("Space");
    expect(problems).toEqual([]);
  });

  it("shows what is cut away at the tip", async () => {
    const { page, problems } = await openPage(browser);
    await page.goto(address);
    const before = await cutAtTheMiddle(page, resultFile("cut.png"));
    expect(before.answered).toEqual([]);
    expect(before.nodes).toBeGreaterThan(0);
    expect(problems).toEqual([]);
  });

  it("is rejected when the server keeps sending the rest shape", async () => {
    let route = { rewritten: () => 0 };
    const { page } = await openPage(browser, async (p) => {
      route = await keepSendingRestShape(p);
    });
    await expect(checkDragShowsServerState(page, address)).rejects.toThrow(/displayed displacement .* differs by/);
    expect(route.rewritten()).toBeGreaterThan(0);
  });
});
