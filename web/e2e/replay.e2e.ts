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

function pageOfFixture(): string {
  const begin = '<script id="recording" type="application/octet-stream">';
  const [before, after] = readFileSync(`${DIST}/replay.html`, "utf8").split(begin);
  const path = resultFile("replay.html");
  writeFileSync(path, before + begin + readFileSync(new URL("../test/recording.glsr.txt", import.meta.url), "utf8").trim() + after);
  return path;
}

describe(`the player of ${given ?? "the fixture"}`, () => {
  let browser: Browser;
  let page: Page;
  let problems: string[];
  let requests: string[];
  let url: string;

  beforeAll(async () => {
    url = pathToFileURL(given ?? pageOfFixture()).href;
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
      expect(await page.getByRole("button", { name: "+ Moment" }).count()).toBe(0);
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
