import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { DIST, openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { checkDragShowsServerState } from "./drag_check";
import { startFakeServer, type RunningServer } from "./fake_server";

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
  const cell = async (key: string): Promise<string> =>
    (await page.locator(`[data-value="${key}"]`).textContent()) ?? "";

  it("drag: shows what the server computed", async () => {
    const report = await checkDragShowsServerState(page, server.url, resultFile("fake-drag.png"));
    console.log(JSON.stringify(report));
    expect(report.pointerDistance_px).toBeLessThan(3);
    expect(problems).toEqual([]);
  });
});
