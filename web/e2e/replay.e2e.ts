/**
 * The player in its one file, opened from disk: the one in GLISSON_REPLAY, which `glisson export` made, or one made here of the
 * built page and the recording of the unit tests.
 */
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { afterAll, beforeAll, beforeEach, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { DIST, openPage, resultFile, startBrowser } from "./browser";

const given = process.env.GLISSON_REPLAY;

const FIXTURE = readFileSync(new URL("../test/recording.glsr.txt", import.meta.url), "utf8").trim();

/** A page with the recording of the unit tests, once or beside itself. */
function pageOfFixture(name: string, ids: readonly string[]): string {
  const page = ids.reduce((html, id) => {
    const begin = `<script id="${id}" type="application/octet-stream">`;
    return html.replace(begin, begin + FIXTURE);
  }, readFileSync(`${DIST}/replay.html`, "utf8"));
  const path = resultFile(name);
  writeFileSync(path, page);
  return path;
}

describe(`the player of ${given ?? "the fixture"}`, () => {
  let browser: Browser;
  let page: Page;
  let problems: string[];
  let requests: string[];
  let url: string;

  beforeAll(async () => {
    url = pathToFileURL(given ?? pageOfFixture("replay.html", ["recording"])).href;
    browser = await startBrowser();
  });
  afterAll(async () => {
    await browser?.close();
  });
  beforeEach(async () => {
    await Promise.all(browser.contexts().map((context) => context.close()));
    requests = [];
    ({ page, problems } = await openPage(browser, async (fresh) => {
      fresh.on("request", (request) => requests.push(request.url()));
    }));
    await page.goto(url);
    await until(() => window.glissonReplay?.header != null);
  });

  const until = (what: () => boolean) => page.waitForFunction(what, undefined, { timeout: 60_000 });
  const report = () => page.evaluate(() => window.glissonReplay!);
  const force = () => page.locator('[data-value="force"]').textContent();

  /** Nothing is wrong, and nothing but the file and what is in it was asked for. */
  function allIsWell(): void {
    expect(problems).toEqual([]);
    expect(requests.filter((asked) => asked !== url && !/^(data|blob):/.test(asked))).toEqual([]);
  }

  /** Goes to the frame with the greatest force on the first instrument. */
  async function toGreatestForce(): Promise<number> {
    const slider = page.getByRole("slider", { name: "Place in the recording" });
    const { nFrames } = await report();
    let best = { frame: 0, force_n: -1 };
    const stride = Math.max(1, Math.floor(nFrames / 12));
    for (let frame = 0; frame < nFrames; frame += stride) {
      await slider.fill(String(frame));
      await page.waitForFunction((wanted) => window.glissonReplay!.frame === wanted, frame);
      const force_n = Math.hypot(...(await report()).header!.forceOnTool_n);
      if (force_n > best.force_n) best = { frame, force_n };
    }
    await slider.fill(String(best.frame));
    await page.waitForFunction((wanted) => window.glissonReplay!.frame === wanted, best.frame);
    return best.force_n;
  }

  it("plays, faster and slower, and stands", async () => {
    expect(await report()).toMatchObject({ frame: 0, playing: false, speed: 1 });
    await page.keyboard.press("Space");
    await until(() => window.glissonReplay!.frame > 5);
    expect((await report()).playing).toBe(true);
    await page.getByRole("button", { name: "Pause" }).click();
    await until(() => !window.glissonReplay!.playing);
    const { frame } = await report();
    await page.waitForTimeout(300);
    expect((await report()).frame).toBe(frame);
    await page.keyboard.press("<");
    await page.keyboard.press("<");
    expect((await report()).speed).toBe(0.25);
    await page.getByRole("button", { name: "Faster" }).click();
    expect((await report()).speed).toBe(0.5);
    for (let i = 0; i < 5; i++) await page.keyboard.press(">");
    await page.keyboard.press("Home");
    await page.keyboard.press("Space");
    await until(() => window.glissonReplay!.frame > 30);
    allIsWell();
  });

  it("goes to a place by slider and keys, and shows its force", async () => {
    const before = await force();
    const greatest_n = await toGreatestForce();
    expect(greatest_n).toBeGreaterThan(0.01);
    expect(await force()).not.toBe(before);
    await page.waitForTimeout(1200);
    await page.screenshot({ path: resultFile("replay.png") });
    const { frame, nFrames } = await report();
    await page.keyboard.press("ArrowLeft");
    await page.waitForFunction((wanted) => window.glissonReplay!.frame === wanted, frame - 1);
    await page.keyboard.press("Home");
    await until(() => window.glissonReplay!.frame === 0);
    await page.getByRole("slider").focus();
    await page.keyboard.press("ArrowRight");
    await until(() => window.glissonReplay!.frame === 1);
    await page.keyboard.press("End");
    await page.waitForFunction((last) => window.glissonReplay!.frame === last, nFrames - 1);
    expect((await report()).messages).toEqual([]);
    allIsWell();
  });

  it("jumps to what went wrong and to stages, if there was a task", async () => {
    const story = page.locator("#story");
    if (await story.isVisible()) {
      const jumps = story.getByRole("button");
      const n = await jumps.count();
      expect(n).toBeGreaterThan(0);
      await jumps.nth(n - 1).click();
      await until(() => window.glissonReplay!.time_s > 0.2);
      await until(() => document.querySelector("#story [aria-current]") !== null);
      await page.waitForTimeout(1200);
      await page.screenshot({ path: resultFile("replay-moment.png") });
    } else {
      expect(await page.getByRole("button", { name: "+ Moment" }).count()).toBe((await report()).bookmarks.length > 0 ? 1 : 0);
    }
    allIsWell();
  });

  it("goes to the time in its address, at the start and when that changes", async () => {
    await page.evaluate(() => { window.location.hash = "#t=1.5"; });
    await until(() => Math.abs(window.glissonReplay!.time_s - 1.5) < 1e-9 && window.glissonReplay!.frame > 0);
    const { frame, playing } = await report();
    expect(playing).toBe(false);
    await page.reload();
    await page.waitForFunction((wanted) => window.glissonReplay?.frame === wanted, frame, { timeout: 60_000 });
    expect((await report()).time_s).toBe(1.5);
    await page.evaluate(() => { window.location.hash = "#t=never"; });
    await page.waitForTimeout(200);
    expect(problems).toEqual([]);
    expect((await report()).time_s).toBe(1.5);
  });

  it("marks moments, names them, keeps them and takes them along in an address", async () => {
    await page.keyboard.press("End");
    await page.keyboard.press("*");
    const { time_s, bookmarks } = await report();
    const own = bookmarks.filter(({ isOwn }) => isOwn);
    expect(own.map((bookmark) => bookmark.time_s)).toEqual([Math.round(100 * time_s) / 100]);
    // Its text is asked for: keys are letters.
    await page.keyboard.type("home l");
    await page.keyboard.press("Enter");
    await until(() => window.glissonReplay!.bookmarks.some(({ text }) => text === "home l"));
    await page.keyboard.press("Home");
    await until(() => window.glissonReplay!.frame === 0);
    await page.waitForTimeout(1200);
    await page.screenshot({ path: resultFile("replay-bookmarks.png") });
    for (let i = 0; i < bookmarks.length + 20 && (await report()).time_s < own[0].time_s; i++) await page.keyboard.press("]");
    expect((await report()).time_s).toBeCloseTo(own[0].time_s, 2);
    await page.reload();
    await until(() => window.glissonReplay?.bookmarks.some(({ text }) => text === "home l") === true);
    await page.getByRole("button", { name: "Address with these bookmarks" }).click();
    const address = page.url();
    expect(address).toMatch(/#t=[\d.]+&b=[\d.]+%7Ehome\+l$/);
    await page.getByRole("button", { name: /^Remove the bookmark at/ }).click();
    await until(() => window.glissonReplay!.bookmarks.every(({ isOwn }) => !isOwn));
    await page.goto("about:blank");
    await page.goto(address);
    await until(() => window.glissonReplay?.bookmarks.some(({ isOwn }) => isOwn) === true);
    await page.getByRole("textbox", { name: /^Text of the bookmark at/ }).waitFor();
    await page.evaluate(() => localStorage.clear());
    expect(problems).toEqual([]);
  });

  it("shows what was kept of the session: bookmarks, and drawings until they were erased", async () => {
    if (given !== undefined) return;
    expect((await report()).bookmarks).toEqual([{ time_s: 0.5, text: "here", isOwn: false }]);
    const dots = async (hash: string) => {
      await page.evaluate((to) => { window.location.hash = to; }, hash);
      await page.waitForTimeout(400);
      return (await report()).drawnDots;
    };
    expect(await dots("#t=0.4")).toBe(0);
    expect(await dots("#t=1.5")).toBeGreaterThan(3);
    await page.waitForTimeout(1000);
    await page.screenshot({ path: resultFile("replay-drawn.png") });
    expect(await dots("#t=2.4")).toBe(0);
    await page.getByRole("button", { name: "0:00.50 here" }).click();
    expect((await report()).time_s).toBe(0.5);
    allIsWell();
  });

  it("turns, shows edges, the other instrument and the keys", async () => {
    await page.keyboard.press("End");
    const picture = () => page.screenshot({ clip: { x: 300, y: 40, width: 640, height: 480 } });
    await page.waitForTimeout(1200);
    const before = await picture();
    await page.mouse.move(600, 300);
    await page.mouse.down();
    await page.mouse.move(700, 320, { steps: 4 });
    await page.mouse.up();
    await page.waitForTimeout(1200);
    const after = await picture();
    expect(before.equals(after)).toBe(false);
    await page.keyboard.press("w");
    await page.waitForTimeout(1200);
    expect((await picture()).equals(after)).toBe(false);
    await page.keyboard.press("c");
    await page.locator("#contacts table, #contacts .contact-note").first().waitFor();
    if (given === undefined) expect(await page.locator('#contacts [data-kind="tool_organ"]').textContent()).toContain("1.5");
    await page.waitForTimeout(1200);
    await page.screenshot({ path: resultFile("replay-contacts.png") });
    await page.keyboard.press("c");
    await page.locator("#contacts").waitFor({ state: "hidden" });
    if ((await report()).hello.tools.length > 1) {
      await page.keyboard.press("2");
      await page.waitForFunction(() => document.querySelector('[data-action="tool_2"]')?.getAttribute("aria-pressed") === "true");
    }
    if ((await report()).theatre.endoscope !== null) {
      await page.keyboard.press("n");
      await until(() => window.glissonReplay!.theatre.on);
      await page.waitForTimeout(1500);
      await page.screenshot({ path: resultFile("replay-theatre.png") });
    }
    await page.keyboard.press("h");
    expect(await page.getByRole("dialog", { name: "Help" }).isVisible()).toBe(true);
    await page.screenshot({ path: resultFile("replay-help.png") });
    await page.keyboard.press("Escape");
    expect(await page.getByRole("dialog", { name: "Help" }).isVisible()).toBe(false);
    allIsWell();
  });

  it("names every control, and fits a small page", async () => {
    const unnamed = await page.evaluate(() =>
      Array.from(document.querySelectorAll("button, input, canvas"), (node) => node.getAttribute("aria-label") ?? node.textContent ?? "").filter((name) => name.trim() === ""),
    );
    expect(unnamed).toEqual([]);
    await page.setViewportSize({ width: 800, height: 600 });
    await page.waitForTimeout(1200);
    const box = (await page.locator("#transport").boundingBox())!;
    expect(box.x).toBeGreaterThanOrEqual(0);
    expect(box.x + box.width).toBeLessThanOrEqual(800);
    expect(box.y + box.height).toBeLessThanOrEqual(600);
    await page.screenshot({ path: resultFile("replay-small.png") });
    allIsWell();
  });

  it("speaks French where the browser keeps that it should", async () => {
    await page.keyboard.press("h");
    await page.getByLabel("Language").selectOption("fr");
    await page.getByRole("button", { name: "Plus lent" }).waitFor();
    expect(await page.locator("html").getAttribute("lang")).toBe("fr");
    await page.screenshot({ path: resultFile("replay-french.png") });
    allIsWell();
    await page.evaluate(() => localStorage.clear());
  });

  it("says what is wrong with a page that has no recording", async () => {
    const empty = resultFile("replay-empty.html");
    writeFileSync(empty, readFileSync(`${DIST}/replay.html`));
    await page.goto(pathToFileURL(empty).href);
    const banner = page.getByRole("alert");
    await banner.waitFor();
    expect(await banner.textContent()).toMatch(/no recording is in this page; `glisson export SESSION --html FILE`/);
  });
});

describe("two recordings beside each other", () => {
  let browser: Browser;
  beforeAll(async () => { browser = await startBrowser(); });
  afterAll(async () => { await browser?.close(); });

  it("play on one clock, and their cameras go together until they are let go", async () => {
    const { page, problems } = await openPage(browser, async () => undefined);
    await page.goto(pathToFileURL(process.env.GLISSON_REPLAY_PAIR ?? pageOfFixture("replay-pair.html", ["recording", "recording-beside"])).href);
    const until = (what: () => boolean) => page.waitForFunction(what, undefined, { timeout: 60_000 });
    const report = () => page.evaluate(() => window.glissonReplay!);
    await until(() => window.glissonReplay?.header != null && window.glissonReplay.beside?.header != null);
    await page.getByRole("slider", { name: "Place in the recording" }).fill("20");
    await until(() => window.glissonReplay!.beside!.frame > 5);
    await page.waitForTimeout(1500);
    await page.screenshot({ path: resultFile("replay-pair.png") });
    expect(await page.locator("#name-a").textContent()).toMatch(/^A .*[\d:.]+ · [\d.]+ m?N$/);
    expect(await page.locator("#panel").isVisible()).toBe(false);
    const both = page.getByText("Stages and moments of both");
    if (await both.isVisible()) {
      await both.click();
      await page.locator("#story").getByRole("button").last().click();
      await page.waitForTimeout(1500);
      await page.screenshot({ path: resultFile("replay-pair-tasks.png") });
      await both.click();
    }
    await page.keyboard.press("Space");
    const { frame, beside } = await report();
    await page.waitForFunction(([a, b]) => window.glissonReplay!.frame > a && window.glissonReplay!.beside!.frame > b, [frame, beside!.frame]);
    await page.keyboard.press("Space");
    const drag = async () => {
      await page.mouse.move(900, 300);
      await page.mouse.down();
      await page.mouse.move(980, 320, { steps: 3 });
      await page.mouse.up();
      return report();
    };
    const together = await drag();
    expect(together.beside!.azimuth_rad).toBeCloseTo(together.azimuth_rad, 9);
    await page.getByRole("button", { name: "Cameras together" }).click();
    const apart = await drag();
    expect(Math.abs(apart.beside!.azimuth_rad - apart.azimuth_rad)).toBeGreaterThan(0.05);
    expect(apart.azimuth_rad).toBe(together.azimuth_rad);
    await page.keyboard.press("g");
    const again = await report();
    expect(again.azimuth_rad).toBeCloseTo(again.beside!.azimuth_rad, 9);
    await page.setViewportSize({ width: 800, height: 600 });
    await page.waitForTimeout(1200);
    await page.screenshot({ path: resultFile("replay-pair-small.png") });
    expect(problems).toEqual([]);
  });
});
