import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { DIST, openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { startFakeServer, type RunningServer } from "./fake_server";

describe("contacts and lists over the picture", () => {
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
    await page.goto(server.url);
    await waitForOrgan(page);
  });
  afterEach(async () => {
    await page.close();
    await server.close();
  });

  const until = (what: () => boolean) => page.waitForFunction(what, undefined, { timeout: 15_000 });

  it("keys: C asks for the contacts, shows and counts them, and asks no more", async () => {
    const legend = page.locator("#contacts");
    const asked = () => server.simulator.received.filter((text) => text.includes("contacts"));
    await page.keyboard.press("g");
    await until(() => window.glisson!.header!.contact && window.glisson!.tool.settled);
    expect(await page.evaluate(() => window.glisson!.header!.contactPoints)).toBeNull();
    expect(await legend.isVisible()).toBe(false);
    expect(asked()).toEqual([]);
    await page.keyboard.press("c");
    await until(() => (window.glisson!.header!.contactPoints?.points.length ?? 0) > 0);
    await until(() => document.querySelector('#contacts [data-kind="tool_organ"]') !== null);
    expect(await legend.locator('[data-kind="tool_organ"] td').allTextContents()).toContain("1");
    expect(await legend.locator('[data-kind="itself"]').textContent()).toContain("0.750 N");
    expect(await legend.textContent()).toMatch(/arrow of 10 mm: .*N.*the 2 greatest are shown, 4 are not/);
    await page.waitForTimeout(900);
    await page.screenshot({ path: resultFile("fake-contacts.png") });
    // A new connection is told what the page shows.
    server.simulator.drop();
    await until(() => window.glisson!.counters.connections === 2);
    await until(() => window.glisson!.header?.contactPoints != null);
    await page.keyboard.press("c");
    await until(() => window.glisson!.header!.contactPoints === null);
    expect(await legend.isVisible()).toBe(false);
    expect(asked().map((text) => (JSON.parse(text) as { shown: boolean }).shown)).toEqual([true, true, false]);
    expect(problems).toEqual([]);
  });

  it("messages leave the list of bodies free", async () => {
    const hello = server.simulator.hello();
    const bodies = ["liver", "stomach", "kidney"].map((name) => ({ name, color: null, is_rigid: false, n_tetrahedra: 1 }));
    server.simulator.say(JSON.stringify({ ...hello, bodies }));
    for (const n of [1, 2, 3]) server.simulator.say(JSON.stringify({ type: "news", message: `${n}: what is good to know, in so many words that it takes two lines` }));
    await until(() => document.querySelectorAll(".message").length === 3 && document.querySelectorAll("#bodies button").length === 3);
    const [messages, list] = await Promise.all(["#messages", "#bodies"].map((part) => page.locator(part).boundingBox()));
    expect(messages!.x + messages!.width).toBeLessThanOrEqual(list!.x);
    expect(list!.x + list!.width).toBeLessThanOrEqual(1280);
    await page.locator("#bodies button").first().click();
    expect(await page.locator("#bodies button").first().getAttribute("aria-pressed")).toBe("false");
  });
});
