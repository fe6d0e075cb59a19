/** At the sizes of a telephone, a tablet and a laptop nothing of the page lies over another thing, with all there is to show. */
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { DIST, openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { startFakeServer, type RunningServer } from "./fake_server";
import { faultsOfLayout, SIZES } from "./layout_check";

const STATUS = {
  title: "Clip a vessel and cut it",
  begins_in_theatre: false,
  stage: "Set two clips on the vessel, one on each side of the mark",
  n_done: 1,
  n_stages: 4,
  share: 0.5,
  hint: "Turn the clip applier until both of its jaws are around the vessel",
  mark: null,
  n_mistakes: 2,
  mistake: "the vessel was cut before it was clipped",
  began_s: 0,
  ended_s: null,
  time_limit_s: 240,
  is_dark: false,
  events: [{ title: "The light fails", came_s: null }],
  outcome: null,
};
const MESSAGE = "the simulation keeps pace again: it computes with full effort, and says so in words that take several lines";

/** Some of what can be turned, one of it not. */
const PARAMETERS = (["young_modulus", "poisson_ratio", "hand_stiffness", "time_step"] as const).map((name, i) => ({
  name,
  unit: "",
  body: 0,
  value: 0.4,
  of_scene: 0.4,
  coming: null,
  least: 0,
  greatest: 1,
  refusal: i === 3 ? "loads or force fields of this scene begin or end at times that are counted in its steps" : null,
}));

describe("the viewer's layout", () => {
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
    await Promise.all(browser.contexts().map((context) => context.close()));
    await server.close();
  });

  const until = (what: () => boolean) => page.waitForFunction(what, undefined, { timeout: 15_000 });

  /** Waits until the sizes that changed have been seen to. */
  const laidOut = () => page.evaluate(() => new Promise<void>((done) => requestAnimationFrame(() => requestAnimationFrame(() => done()))));

  /** A scene of several bodies with an endoscope, a task in it, and something to say. */
  function showAll(): void {
    const hello = server.simulator.hello();
    const optics = { view_angle_rad: 0.5, field_of_view_rad: 1.2 };
    const tools = hello.tools.map((tool) => ({ ...tool, kind: "endoscope", optics }));
    const bodies = ["liver", "gall bladder", "stomach", "right kidney"].map((name) => ({ name, color: null, is_rigid: false, n_tetrahedra: 1000 }));
    const scene = { ...hello.scene, name: "a scene with a long name, of several organs and a task" };
    for (const message of [
      { ...hello, scene, tools, bodies, can_leave: true },
      { type: "task", status: STATUS },
      { type: "parameters", material: "liver", parameters: PARAMETERS },
      { type: "news", message: MESSAGE },
      { type: "error", message: MESSAGE },
    ]) {
      server.simulator.say(JSON.stringify(message));
    }
  }

  it.each(SIZES)("$width x $height: nothing lies over another thing", async ({ width, height }) => {
    const name = (what: string): string => resultFile(`layout-${width}-${what}.png`);
    await page.setViewportSize({ width, height });
    await page.goto(server.url);
    await waitForOrgan(page);
    await laidOut();
    expect(await faultsOfLayout(page)).toEqual([]);
    await page.screenshot({ path: name("plain") });
    showAll();
    await until(() => document.querySelectorAll("#bodies button").length === 4 && document.querySelectorAll(".message").length === 2);
    for (const view of ["laboratory", "theatre"]) {
      if (view === "theatre") await page.keyboard.press("n");
      await laidOut();
      expect(await faultsOfLayout(page), view).toEqual([]);
      await page.screenshot({ path: name(view) });
      // With the buttons of a hand without a keyboard.
      await page.evaluate(() => document.body.classList.add("touched"));
      await laidOut();
      expect(await faultsOfLayout(page), `${view}, touched`).toEqual([]);
      await page.screenshot({ path: name(`${view}-touched`) });
      const more = page.getByRole("button", { name: "More" });
      if (await more.isVisible()) {
        await more.click();
        await laidOut();
        expect(await page.getByRole("button", { name: "Pause" }).isVisible()).toBe(true);
        expect(await faultsOfLayout(page), `${view}, unfolded`).toEqual([]);
        await more.click();
      }
      await page.evaluate(() => document.body.classList.remove("touched"));
      // All that can be shown beside it.
      for (const key of ["Shift+P", "c", "p", "Shift+C", "Shift+X", "Shift+M"]) {
        await page.keyboard.press(key);
        await laidOut();
        expect(await faultsOfLayout(page), `${view} ${key}`).toEqual([]);
      }
      await page.waitForTimeout(400);
      await page.screenshot({ path: name(`${view}-all`) });
      // Three more colours, and three more planes, are none again.
      const off = ["Escape", ...Array.from({ length: 3 }, () => ["Shift+C", "Shift+X"]).flat()];
      for (const key of [...off, "Shift+P", "c", "p"]) await page.keyboard.press(key);
    }
    await page.keyboard.press("h");
    const help = (await page.locator(".help-page").boundingBox())!;
    expect(help.x >= 0 && help.y >= 0 && help.x + help.width <= width && help.y + help.height <= height).toBe(true);
    await page.screenshot({ path: name("help") });
    await page.keyboard.press("Escape");
    await page.keyboard.press("Shift+E");
    const devices = (await page.locator(".devices-page").boundingBox())!;
    expect(devices.x >= 0 && devices.y >= 0 && devices.x + devices.width <= width && devices.y + devices.height <= height).toBe(true);
    await page.screenshot({ path: name("devices") });
    expect(problems.filter((problem) => problem !== MESSAGE && !problem.includes(MESSAGE))).toEqual([]);
  });

  it("what is needed can be reached: the panel scrolls where it is shorter than what it holds", async () => {
    await page.setViewportSize({ width: 420, height: 800 });
    await page.goto(server.url);
    await waitForOrgan(page);
    const isOpen = () => page.evaluate(() => window.glisson!.view.panel);
    expect(await isOpen()).toBe(false);
    expect(await page.locator('[data-value="force"]').isVisible()).toBe(true);
    await page.getByRole("button", { name: "Show all measurements" }).click();
    expect(await isOpen()).toBe(true);
    const last = page.locator('[data-value="mesh"]');
    await last.scrollIntoViewIfNeeded();
    const [cell, panel] = await Promise.all([last, page.locator("#panel")].map((part) => part.boundingBox()));
    expect(cell!.y).toBeGreaterThanOrEqual(panel!.y);
    expect(cell!.y + cell!.height).toBeLessThanOrEqual(panel!.y + panel!.height);
    expect(problems).toEqual([]);
  });

  it("what was chosen comes back, and broken storage does no harm", async () => {
    await page.goto(server.url);
    await waitForOrgan(page);
    for (const key of ["w", "f", "Shift+F", "Shift+P"]) await page.keyboard.press(key);
    const chosen = () => page.evaluate(() => (({ style, forces, plot, panel }) => ({ style, forces, plot, panel }))(window.glisson!.view));
    const expected = { style: "surface_with_edges", forces: false, plot: false, panel: false };
    expect(await chosen()).toEqual(expected);
    await page.reload();
    await waitForOrgan(page);
    expect(await chosen()).toEqual(expected);
    await page.evaluate(() => localStorage.setItem("glisson.settings.1", '{"style":"pink","plot":'));
    await page.reload();
    await waitForOrgan(page);
    expect(await chosen()).toEqual({ style: "surface", forces: true, plot: true, panel: true });
    expect(problems).toEqual([]);
  });

  it("speaks French where the browser does, and the language that was chosen", async () => {
    const context = await browser.newContext({ locale: "fr-FR", viewport: { width: 800, height: 600 } });
    const french = await context.newPage();
    await french.goto(server.url);
    await waitForOrgan(french);
    expect(await french.locator("html").getAttribute("lang")).toBe("fr");
    await french.getByRole("button", { name: "Modèle" }).waitFor();
    expect(await faultsOfLayout(french)).toEqual([]);
    await french.keyboard.press("h");
    await french.screenshot({ path: resultFile("layout-french-help.png") });
    await french.getByLabel("Langue").selectOption("en");
    await french.getByRole("button", { name: "Model" }).waitFor();
    await waitForOrgan(french);
    expect(await french.locator("html").getAttribute("lang")).toBe("en");
    await french.reload();
    await french.getByRole("button", { name: "Model" }).waitFor();
  });
});
