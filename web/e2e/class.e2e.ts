/** Two pages of one simulation: who teaches draws, the learner sees it; control is taken over and given back. */
import { spawnSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { BLOCK, program, serveProgram, type ServedProgram } from "./serve";

if (program === undefined) console.warn("SKIPPED e2e/class.e2e.ts: GLISSON_PROGRAM is not set (the program glisson)");

const TIME = { timeout: 30_000 };

describe.skipIf(program === undefined)("a class", () => {
  let browser: Browser;
  let folder: string;
  let server: ServedProgram;
  let learner: Page;
  let teacher: Page;
  const problems: string[] = [];

  /** Cookies are of one browser: who teaches has another one than the learner. */
  async function open(url: string): Promise<Page> {
    const opened = await openPage(browser);
    await opened.page.goto(url);
    await waitForOrgan(opened.page);
    opened.page.on("close", () => problems.push(...opened.problems));
    return opened.page;
  }

  beforeAll(async () => {
    browser = await startBrowser();
    folder = mkdtempSync(join(tmpdir(), "glisson-class-"));
    writeFileSync(join(folder, "scene.toml"), BLOCK);
    server = await serveProgram(["serve", "scene.toml", "--record", "session.jsonl"], folder);
    learner = await open(server.url);
    teacher = await open(await server.teacherUrl);
  });
  afterAll(async () => {
    await browser?.close();
    await server?.stop();
    rmSync(folder, { recursive: true, force: true });
  });

  const people = (page: Page) => page.locator("#classroom li").allTextContents();
  const until = (page: Page, what: () => boolean) => page.waitForFunction(what, undefined, TIME);

  it("who teaches draws and takes over, and the learner sees it", async () => {
    expect(new URL(teacher.url()).search).toBe("");
    await until(learner, () => document.querySelectorAll("#classroom li").length === 2);
    expect((await people(learner)).some((line) => line.includes("you") && line.includes("in control"))).toBe(true);
    expect((await people(teacher)).some((line) => line.includes("(teaches)") && line.includes("you"))).toBe(true);
    expect(await learner.locator("#classroom button:visible").count()).toBe(0);
    await learner.locator("#classroom input").fill("Ada");
    await learner.locator("#classroom input").press("Enter");
    await until(teacher, () => document.querySelector("#classroom")?.textContent?.includes("Ada") === true);

    // A stroke over the middle of the organ, and where the pointer is.
    await teacher.keyboard.press("Shift+W");
    const at = await teacher.evaluate(() => {
      const { project, positions } = window.glisson!;
      const all = Array.from({ length: positions!.length / 3 }, (_, vertex) => project(vertex)!);
      const mean = (k: 0 | 1): number => all.reduce((sum, place) => sum + place[k], 0) / all.length;
      return [mean(0), mean(1)];
    });
    await teacher.mouse.move(at[0] - 40, at[1]);
    await teacher.mouse.down();
    await teacher.mouse.move(at[0] + 40, at[1] + 10, { steps: 12 });
    await teacher.mouse.up();
    await until(learner, () => window.glisson!.drawn.dots > 3 && window.glisson!.drawn.pointers === 1);
    // Nothing was pushed by it.
    expect(await teacher.evaluate(() => window.glisson!.counters.sentToolMessages)).toBe(0);
    await learner.screenshot({ path: resultFile("class-learner.png") });
    await teacher.screenshot({ path: resultFile("class-teacher.png") });
    const dots = await learner.evaluate(() => window.glisson!.drawn.dots);
    await teacher.keyboard.press("Shift+Y");
    await learner.waitForFunction((n) => window.glisson!.drawn.dots === n + 1, dots, TIME);
    await teacher.keyboard.press("Shift+W");
    await until(learner, () => window.glisson!.drawn.pointers === 0);
    await teacher.keyboard.press("Shift+Z");
    await until(learner, () => window.glisson!.drawn.dots === 0);

    // A moment is marked, and then gets its text.
    await learner.keyboard.press("*");
    const field = learner.locator(".bookmark-field input");
    await field.fill("it bleeds");
    await learner.screenshot({ path: resultFile("class-bookmark.png") });
    await field.press("Enter");
    await learner.getByText(/a bookmark at [\d.]+ s: it bleeds/).waitFor(TIME);
    expect(await field.count()).toBe(0);

    // Paused for all, without control; then taken over and given back.
    await teacher.keyboard.press(" ");
    for (const page of [learner, teacher]) await until(page, () => window.glisson!.header!.paused);
    await teacher.keyboard.press(" ");
    await until(learner, () => !window.glisson!.header!.paused);
    await teacher.keyboard.press("Shift+B");
    await teacher.getByRole("button", { name: "Give back" }).waitFor(TIME);
    await until(learner, () => [...document.querySelectorAll("#classroom li")].some((line) => /teaches.*in control/.test(line.textContent ?? "")));
    await teacher.keyboard.press("Shift+B");
    await teacher.getByRole("button", { name: "Take over" }).waitFor(TIME);
    await until(learner, () => [...document.querySelectorAll("#classroom li")].some((line) => /Ada.*you.*in control/.test(line.textContent ?? "")));

    // A learner's keys of the class do nothing.
    await learner.keyboard.press("Shift+B");
    await learner.keyboard.press("Shift+Y");
    await learner.waitForTimeout(500);
    expect(await teacher.evaluate(() => window.glisson!.drawn.dots)).toBe(0);
    await learner.close();
    await teacher.close();
    expect(problems).toEqual([]);
  });

  it("what was drawn and marked is in the session, and in the page that is made of it", async () => {
    await server.stop();
    const exported = spawnSync(program!, ["export", "session.jsonl", "--html", "session.html", "--check"], { cwd: folder, encoding: "utf8" });
    expect(exported.stdout + exported.stderr).toContain("same bits as the recording");
    const { page, problems: wrong } = await openPage(browser);
    await page.goto(pathToFileURL(join(folder, "session.html")).href);
    await page.waitForFunction(() => window.glissonReplay?.header != null, undefined, TIME);
    const bookmarks = await page.evaluate(() => window.glissonReplay!.bookmarks);
    expect(bookmarks.map(({ text, isOwn }) => [text, isOwn])).toEqual([["it bleeds", false]]);
    // It was erased just before.
    const places = await page.evaluate(() => window.glissonReplay!.nFrames);
    const slider = page.getByRole("slider", { name: "Place in the recording" });
    const dots = async (frame: number): Promise<number> => {
      await slider.fill(String(frame));
      await page.waitForFunction((wanted) => window.glissonReplay!.frame === wanted, frame, TIME);
      return page.evaluate(() => window.glissonReplay!.drawnDots);
    };
    expect(await dots(0)).toBe(0);
    expect(await dots(places - 1)).toBe(0);
    let most = 0;
    for (let frame = 0; frame < places; frame += 5) most = Math.max(most, await dots(frame));
    expect(most).toBeGreaterThan(3);
    expect(wrong).toEqual([]);
  });
});
