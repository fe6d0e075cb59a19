/**
 * Drag to push, against a running `glisson serve` whose address is in GLISSON_URL. The same check must reject a
 * server that keeps sending the rest shape.
 */
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import type { Browser } from "playwright-core";
import { openPage, resultFile, startBrowser } from "./browser";
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
