/**
 * The tasks that come with the program, each done by its demonstration in front of a page: the panel follows the stages to their end,
 * and leads to the report. The program is in GLISSON_PROGRAM.
 */
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { program, serveProgram } from "./serve";

if (program === undefined) console.warn("SKIPPED e2e/tasks.e2e.ts: GLISSON_PROGRAM is not set (the program glisson)");

interface Task {
  readonly name: string;
  readonly title: string;
  readonly stages: readonly string[];
}

/** Shown unless GLISSON_TASKS is "all" (`cargo xtask soak page-tasks`): touch, cut, clips, a loop, two hands at a patient's liver. */
const USUAL = ["palpation", "line_cut", "clip_and_cut", "ligating_loop", "metastasectomy"];
const tasks = program === undefined ? [] : (JSON.parse(execFileSync(program, ["task", "list", "--json"], { encoding: "utf8" })) as Task[]);
const shown = process.env.GLISSON_TASKS === "all" ? tasks : tasks.filter((task) => USUAL.includes(task.name));
/** A demonstration takes some 12 s; a busy machine draws slowly beside it. */
const LONGEST_MS = 120_000;
/** In the middle of most of them. */
const PICTURE_AFTER_MS = 6000;

/** A task that serves itself, and is done by its demonstration. */
const serve = (name: string, out: string) => serveProgram(["task", "run", name, "--demonstrate", "--out", out]);

/** An endoscope that looks at a ball, an instrument that moves for a minute, and a lamp that fails when who teaches says so. */
const DARK = `glisson_scene = 1
[organ]
ball = { center = ["0 mm", "0 mm", "0 mm"], radius = "30 mm" }
edge = "10 mm"
tissue = "liver"
model = "precomputed"
[[organ.fixed]]
furthest = { direction = [0, 1, 0], fraction = 0.2 }
[[tool]]
name = "probe"
tip_radius = "4 mm"
home_tip = ["20 mm", "-60 mm", "0 mm"]
home_shaft = [0, -1, 0]
path = [{ time = "60 s", tip = ["-20 mm", "-60 mm", "0 mm"] }]
[[tool]]
name = "laparoscope"
kind = "endoscope"
tip_radius = "5 mm"
shaft_radius = "5 mm"
view_angle = "0 deg"
home_tip = ["0 mm", "-90 mm", "0 mm"]
home_shaft = [0, -1, 0]
[task]
title = "In the dark"
view = "theatre"
[[task.stage]]
title = "Touch the ball"
touch = { tool = "probe" }
[[task.event]]
title = "The light fails"
light_out = { for = "4 s" }
`;

/** The same ball, and a hook that touches it switched on, too lightly to cut. */
const HOT = DARK.replace('name = "probe"\n', 'name = "probe"\nkind = "hook"\ncut_force = "9 N"\n').replace(
  'path = [{ time = "60 s", tip = ["-20 mm", "-60 mm", "0 mm"] }]',
  'path = [{ time = "1 s", tip = ["0 mm", "-33 mm", "0 mm"], trigger = 1 }, { time = "60 s", tip = ["5 mm", "-32 mm", "0 mm"], trigger = 1 }]',
);

/** The duct of `clip_and_cut` without the clip that would have saved the blood, and a suction tube that comes to its end, sucks and rinses. */
const BLEEDING = `${readFileSync(new URL("../../tasks/clip_and_cut.toml", import.meta.url), "utf8").replace("clip = true", "")}
[[tool]]
name = "suction tube"
kind = "suction"
tip_radius = "2.5 mm"
home_tip = ["40 mm", "-50 mm", "-10 mm"]
home_shaft = [0.7, -1, -0.3]
path = [
  { time = "9 s", tip = ["40 mm", "-50 mm", "-10 mm"] },
  { time = "10 s", tip = ["2 mm", "-5 mm", "0 mm"] },
  { time = "10.1 s", tip = ["2 mm", "-5 mm", "0 mm"], trigger = 1 },
  { time = "14 s", tip = ["2 mm", "-5 mm", "0 mm"] },
  { time = "14.1 s", tip = ["2 mm", "-5 mm", "0 mm"], jaw = 0 },
  { time = "60 s", tip = ["2 mm", "-5 mm", "0 mm"] },
]
`;

declare global {
  interface Window {
    stagesSeen: string[];
  }
}

/** In the page, from before it is there: what its panel said of the task's stages, however late a test looks. */
function gatherStages(): void {
  window.stagesSeen = [];
  new MutationObserver(() => {
    const stage = document.querySelector("#task .stage")?.textContent ?? "";
    if (window.stagesSeen.at(-1) !== stage) window.stagesSeen.push(stage);
  }).observe(document, { childList: true, characterData: true, subtree: true });
}

/** Mean brightness, 0 to 255, around the middle of the endoscope's picture. */
async function brightness(page: Page): Promise<number> {
  const [x, y] = await page.evaluate(() => {
    const box = document.querySelector("#scene")!.getBoundingClientRect();
    return [box.left + box.width / 2, box.top + box.height / 2];
  });
  const picture = await page.screenshot({ clip: { x: x - 20, y: y - 20, width: 40, height: 40 } });
  return page.evaluate(async (base64) => {
    const image = new Image();
    image.src = `data:image/png;base64,${base64}`;
    await image.decode();
    const canvas = new OffscreenCanvas(40, 40).getContext("2d")!;
    canvas.drawImage(image, 0, 0);
    const { data } = canvas.getImageData(0, 0, 40, 40);
    return data.reduce((sum, value, i) => sum + (i % 4 === 3 ? 0 : value), 0) / (3 * 1600);
  }, picture.toString("base64"));
}

describe.skipIf(program === undefined)("the tasks in the page", () => {
  let browser: Browser;
  let out: string;

  beforeAll(async () => {
    browser = await startBrowser();
    out = mkdtempSync(join(tmpdir(), "glisson-tasks-"));
  });
  afterAll(async () => {
    await browser?.close();
    rmSync(out, { recursive: true, force: true });
  });

  it("an event that who teaches lets come takes the light away for its time", { timeout: 120_000 }, async () => {
    const scene = join(out, "dark.toml");
    writeFileSync(scene, DARK);
    const { url, stop } = await serve(scene, out);
    try {
      const { page, problems } = await openPage(browser);
      await page.goto(url);
      await waitForOrgan(page);
      const event = page.locator("#task details.task-events");
      await event.locator("summary").click();
      const button = event.getByRole("button");
      await expect.poll(() => button.isEnabled(), { timeout: 30_000 }).toBe(true);
      await expect.poll(() => brightness(page), { timeout: 30_000 }).toBeGreaterThan(20);
      await button.click();
      await expect.poll(() => brightness(page), { timeout: 4000, interval: 100 }).toBeLessThan(2);
      await page.screenshot({ path: resultFile("task-dark.png") });
      expect(await button.textContent()).toMatch(/^The light fails: came after \d+\.\d s$/);
      expect(await button.isEnabled()).toBe(false);
      await expect.poll(() => brightness(page), { timeout: 60_000 }).toBeGreaterThan(20);
      expect(problems).toEqual([]);
      await page.close();
    } finally {
      await stop();
    }
  });

  it("a hook that is switched on chars what it touches, and smokes", { timeout: 120_000 }, async () => {
    const scene = join(out, "hot.toml");
    writeFileSync(scene, HOT);
    const { url, stop } = await serve(scene, out);
    try {
      const { page, problems } = await openPage(browser);
      await page.goto(url);
      await waitForOrgan(page);
      const field = () => page.evaluate(() => window.glisson!.theatre.field);
      await expect.poll(async () => (await field()).burns, { timeout: 60_000 }).toBeGreaterThan(0);
      await expect.poll(async () => (await field()).puffs, { timeout: 60_000 }).toBeGreaterThan(5);
      // All of it, as a GPU draws it: its shaders compile here, too.
      for (let i = 0; i < 2; i++) await page.keyboard.press("Shift+T");
      await page.waitForTimeout(3000);
      await page.screenshot({ path: resultFile("task-hot.png") });
      await page.keyboard.press("Shift+R");
      await expect.poll(async () => (await field()).burns, { timeout: 60_000 }).toBe(0);
      expect(problems).toEqual([]);
      await page.close();
    } finally {
      await stop();
    }
  });

  it("a clip is seen where it was set, and suction takes the blood of an open end away", { timeout: 180_000 }, async () => {
    const scene = join(out, "bleeding.toml");
    writeFileSync(scene, BLEEDING);
    const { url, stop } = await serve(scene, out);
    try {
      const { page, problems } = await openPage(browser);
      await page.goto(url);
      await waitForOrgan(page);
      await page.keyboard.press("Shift+S");
      const drops = () => page.evaluate(() => window.glisson!.theatre.field.drops);
      const suction = () => page.evaluate(() => window.glisson!.header!.tools[3]);
      await expect.poll(() => page.evaluate(() => window.glisson!.header!.clips), { timeout: 60_000 }).toHaveLength(1);
      const [clip] = await page.evaluate(() => window.glisson!.header!.clips);
      // 10 mm to the left of the middle, along the duct, its legs along the applier.
      clip.position_m.forEach((x, k) => expect(Math.abs(x - [0.009, 0, 0][k])).toBeLessThan(2e-3));
      expect(Math.abs(clip.along[0])).toBeGreaterThan(0.95);
      expect(clip.radius_m).toBeCloseTo(1.5e-3, 6);
      await expect.poll(drops, { timeout: 60_000 }).toBeGreaterThan(8);
      await page.screenshot({ path: resultFile("task-bleeding.png") });
      await expect.poll(async () => (await suction()).trigger, { timeout: 60_000 }).toBe(1);
      await expect.poll(drops, { timeout: 30_000 }).toBeLessThan(8);
      expect(await page.evaluate(() => window.glisson!.header!.bleeding!.rate_m3_per_s)).toBeGreaterThan(0);
      await expect.poll(async () => (await suction()).jaw, { timeout: 60_000 }).toBe(0);
      await page.waitForTimeout(1500);
      await page.screenshot({ path: resultFile("task-suction.png") });
      // From outside, too.
      await page.keyboard.press("n");
      await page.waitForTimeout(2000);
      await page.screenshot({ path: resultFile("task-suction-outside.png") });
      expect(problems).toEqual([]);
      await page.close();
    } finally {
      await stop();
    }
  });

  it.each(shown)("$name is done by its demonstration", { timeout: 2 * LONGEST_MS }, async (task) => {
    const { url, stop } = await serve(task.name, out);
    try {
      const { page, problems } = await openPage(browser, async (page) => void (await page.addInitScript(gatherStages)));
      await page.goto(url);
      await waitForOrgan(page);
      const panel = page.locator("#task");
      await panel.locator("h2").filter({ hasText: task.title }).waitFor();
      const stage = panel.locator(".stage");
      const begin = Date.now();
      const time_s = () => page.evaluate(() => window.glisson!.header!.time_s);
      const from_s = await time_s();
      while ((await stage.getAttribute("data-outcome")) === "") {
        expect(Date.now() - begin).toBeLessThan(LONGEST_MS);
        if (Date.now() - begin > PICTURE_AFTER_MS) await page.screenshot({ path: resultFile(`task-${task.name}.png`) });
        await page.waitForTimeout(100);
      }
      const [simulated_s, took_s] = [(await time_s()) - from_s, (Date.now() - begin) / 1000];
      expect(await stage.textContent()).toBe("All stages are done.");
      // The demonstration waits for the page: its last stage, at least, was there to be read.
      const last = task.stages[task.stages.length - 1];
      expect((await page.evaluate(() => window.stagesSeen)).some((text) => text.endsWith(last))).toBe(true);
      console.log(`${task.name}: ${simulated_s.toFixed(1)} s in ${took_s.toFixed(1)} s, ${(simulated_s / took_s).toFixed(2)} x real time`);

      const reported = page.context().waitForEvent("page");
      await panel.getByRole("link", { name: "Look at the report" }).click();
      const report = await reported;
      await report.waitForLoadState();
      expect(await report.locator("h1").textContent()).toBe(task.title);
      expect(await report.locator("main > p").first().textContent()).toContain("Passed");
      expect(await report.locator("tr", { hasText: "Path length" }).count()).toBeGreaterThan(0);
      expect(await report.locator("svg").count()).toBeGreaterThan(1);
      await report.screenshot({ path: resultFile(`report-${task.name}.png`), fullPage: true });
      expect(problems).toEqual([]);
      await report.close();
      await page.close();
    } finally {
      await stop();
    }
  });
});
