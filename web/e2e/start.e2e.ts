/**
 * The page that one begins with: a click makes a task, the viewer shows its organ at the same address, and a key leads back.
 * The program is in GLISSON_PROGRAM.
 */
import { spawnSync } from "node:child_process";
import { existsSync, mkdtempSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { BLOCK, program, serveProgram, type ServedProgram } from "./serve";
import { faultsOfLayout, SIZES } from "./layout_check";

if (program === undefined) console.warn("SKIPPED e2e/start.e2e.ts: GLISSON_PROGRAM is not set (the program glisson)");

/** Organs are made in seconds; a busy machine takes longer. */
const MAKING_MS = 90_000;
const BAD_SCENE = "glisson_scene = 1\n[organ]\ntisue = \"liver\"\n";

describe.skipIf(program === undefined)("the start page", () => {
  let browser: Browser;
  let folder: string;
  let server: ServedProgram;
  let url: string;
  let page: Page;
  let problems: string[];

  beforeAll(async () => {
    browser = await startBrowser();
  });
  afterAll(async () => {
    await browser?.close();
  });
  beforeEach(async () => {
    folder = mkdtempSync(join(tmpdir(), "glisson-start-"));
    writeFileSync(join(folder, "bad.toml"), BAD_SCENE);
    // In a folder of its own.
    server = await serveProgram(["start"], folder);
    ({ url } = server);
    ({ page, problems } = await openPage(browser));
    await page.goto(url);
    await page.locator("#tasks li").first().waitFor();
  });
  afterEach(async () => {
    await Promise.all(browser.contexts().map((context) => context.close()));
    await server.stop();
    rmSync(folder, { recursive: true, force: true });
  });

  /** What went wrong, but for a connection that a page loses while another one takes its place: it asks again. */
  const faults = () => problems.filter((problem) => !/net::ERR_(CONNECTION_RESET|CONNECTION_REFUSED|EMPTY_RESPONSE)/.test(problem));
  const task = (title: string | RegExp) => page.locator("#tasks li").filter({ has: page.getByRole("heading", { name: title }) });
  function sessions(): string[] {
    const out = join(folder, "out/sessions");
    return existsSync(out) ? readdirSync(out) : [];
  }
  /** Back to the start page: once is not enough. On a busy machine the second press may come too late, and is a first one again. */
  async function goBack(): Promise<void> {
    const start = page.getByRole("heading", { level: 1, name: "What do you want to do?" });
    await expect.poll(async () => {
      if (await start.isVisible()) return true;
      const isAsked = page.getByRole("button", { name: "End it?" });
      if (!(await isAsked.isVisible())) await page.keyboard.press("Shift+Q");
      await isAsked.click({ timeout: 2000 }).catch(() => undefined);
      return start.waitFor({ timeout: 5000 }).then(() => true, () => false);
    }, { timeout: 45_000 }).toBe(true);
  }

  it("a click makes the palpation task, the viewer shows its organ, and a key leads back", { timeout: 3 * MAKING_MS }, async () => {
    await page.screenshot({ path: resultFile("start.png"), fullPage: true });
    expect(await page.locator("#tasks li").count()).toBeGreaterThanOrEqual(6);
    expect(await page.locator("#scenes li", { hasText: "bad.toml" }).textContent()).toContain("cannot be read");
    const palpation = page.locator('#tasks li[data-task="palpation"]');
    const title = (await palpation.locator("h3").textContent())!;
    await palpation.getByRole("button", { name: /^Start/ }).click();
    await waitForOrgan(page);
    await page.locator("#task h2").filter({ hasText: title }).waitFor();
    expect(await page.evaluate(() => window.glisson!.hello!.can_leave)).toBe(true);
    for (const { width, height } of SIZES) {
      await page.setViewportSize({ width, height });
      await page.waitForTimeout(600);
      expect(await faultsOfLayout(page), `${width}`).toEqual([]);
      await page.screenshot({ path: resultFile(`start-task-${width}.png`) });
    }
    await goBack();
    expect(sessions()).toEqual(["palpation.jsonl"]);
    expect(await page.locator("#error").isVisible()).toBe(false);

    // In the theatre view, with a look that is kept; a second page goes where the first one leads.
    const other = await openPage(browser);
    await other.page.goto(url);
    await other.page.locator("#tasks li").first().waitFor();
    await page.locator('#tasks li[data-task="camera_navigation"]').getByRole("button", { name: /^Watch/ }).click();
    await waitForOrgan(page);
    await waitForOrgan(other.page);
    // Who started it has the instruments.
    await page.waitForFunction(() => window.glisson!.panel.control === "this page");
    await other.page.waitForFunction(() => window.glisson!.panel.control === "another");
    await page.waitForFunction(() => window.glisson!.theatre.on, undefined, { timeout: 30_000 });
    for (const { width, height } of SIZES) {
      await page.setViewportSize({ width, height });
      await page.waitForTimeout(600);
      expect(await faultsOfLayout(page), `theatre ${width}`).toEqual([]);
      await page.screenshot({ path: resultFile(`start-theatre-${width}.png`) });
    }
    await goBack();
    await other.page.locator("#tasks li").first().waitFor({ timeout: 30_000 });
    expect([...problems, ...other.problems]).toEqual([]);
  });

  it("is worked by keys alone, tells what is being made, and cancels it", { timeout: 2 * MAKING_MS }, async () => {
    const focused = () => page.evaluate(() => document.activeElement?.getAttribute("aria-label") ?? document.activeElement?.id);
    await page.keyboard.press("ArrowDown");
    const first = await focused();
    expect(first).toMatch(/^Start: /);
    await page.keyboard.press("ArrowDown");
    const second = await focused();
    expect(second).toMatch(/^Start: /);
    expect(second).not.toBe(first);
    await page.keyboard.press("ArrowUp");
    expect(await focused()).toBe(first);
    // What can be focused has a name, and headings and lists are such.
    const session = await page.context().newCDPSession(page);
    const { nodes } = await session.send("Accessibility.getFullAXTree");
    const silent = nodes.filter(({ ignored, role, name, properties }) => {
      const canFocus = properties?.some((property) => property.name === "focusable" && property.value.value === true) ?? false;
      return !ignored && role?.value !== "RootWebArea" && canFocus && (name?.value ?? "") === "";
    });
    expect(silent.map(({ role }) => role?.value)).toEqual([]);
    expect(nodes.filter(({ role }) => role?.value === "heading").length).toBeGreaterThan(8);
    // Cancelled, it leads nowhere and leaves nothing behind.
    await page.keyboard.press("Enter");
    await page.locator("#status").filter({ hasText: "the organs are made" }).waitFor();
    await page.keyboard.press("Escape");
    await page.locator("#making").waitFor({ state: "hidden", timeout: MAKING_MS });
    await page.waitForTimeout(500);
    await page.getByRole("heading", { level: 1, name: "What do you want to do?" }).waitFor();
    expect(sessions()).toEqual([]);
    await page.keyboard.press("ArrowDown");
    expect(await focused()).toBe(first);
    await page.keyboard.press("Enter");
    await waitForOrgan(page);
    // A task is measured in real time.
    await page.keyboard.press("<");
    await page.waitForFunction(() => window.glisson!.messages.some((words) => words.includes("real time")));
    await goBack();
    expect(problems.splice(0).filter((problem) => !problem.includes("real time"))).toEqual([]);
    expect(faults()).toEqual([]);
  });

  it("starts a scene of the folder, in which time passes slowly when it is asked to", { timeout: 2 * MAKING_MS }, async () => {
    writeFileSync(join(folder, "block.toml"), BLOCK);
    await page.getByRole("button", { name: "Look again" }).click();
    await page.getByRole("button", { name: "Start: a block, block.toml" }).click();
    await waitForOrgan(page);
    const until = (what: () => boolean) => page.waitForFunction(what, undefined, { timeout: 30_000 });
    await page.keyboard.press("<");
    await page.getByRole("button", { name: "Slow 0.5 ×" }).click();
    await until(() => window.glisson!.panel.real_time_factor.includes("slow motion") && window.glisson!.header!.realTimeFactor < 0.3 && window.glisson!.header!.realTimeFactor > 0.1);
    // The hand follows as slowly, and never jumps.
    await page.keyboard.press("g");
    await until(() => window.glisson!.header!.contact && window.glisson!.tool.settled);
    await page.keyboard.press("<");
    await page.keyboard.press("<");
    await until(() => window.glisson!.header!.realTimeFactor > 0.5);
    await page.locator('#toolbar button[data-action="slow_motion"][aria-pressed="false"]').waitFor();
    await goBack();
    expect(sessions()).toEqual(["block.jsonl"]);
    expect(faults()).toEqual([]);
  });

  it("stores the results of a person, whose instrument a device holds", async () => {
    const task = '[task]\ntitle = "wave"\n[[task.stage]]\ntitle = "touch"\ntouch = {}\n';
    writeFileSync(join(folder, "wave.toml"), BLOCK.replace("[organ]\n", `${task}[organ]\n`));
    const own = await serveProgram(["start", "--person", "Ada", "--database", "results.sqlite", "--device", "simulated"], folder);
    await page.goto(own.url);
    await page.locator("#scenes li", { hasText: "wave" }).getByRole("button", { name: /^Start/ }).click();
    await waitForOrgan(page);
    await page.keyboard.press("Shift+E");
    await page.locator(".devices-table", { hasText: /device: .*simulated/ }).waitFor();
    await page.keyboard.press("Escape");
    // The simulated hand goes to and fro.
    await page.waitForFunction(() => window.glisson!.header!.time_s > 1.5, undefined, { timeout: 60_000 });
    await goBack();
    await own.stop();
    const { stdout } = spawnSync(program!, ["results", "list", "--database", "results.sqlite"], { cwd: folder, encoding: "utf8" });
    expect(stdout).toMatch(/Ada\s.*wave|wave\s.*Ada/);
    expect(faults()).toEqual([]);
  });

  it("leads to a new patient, and back", async () => {
    await page.getByRole("button", { name: "Bring in a patient" }).click();
    await page.getByRole("heading", { name: "A new patient" }).waitFor();
    await page.getByRole("button", { name: "Back to the start page" }).click();
    await page.getByRole("heading", { name: "What do you want to do?" }).waitFor({ timeout: 30_000 });
    expect(faults()).toEqual([]);
  });

  it("fits small pages, and speaks French", async () => {
    for (const { width, height } of SIZES) {
      await page.setViewportSize({ width, height });
      const tooWide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      expect(tooWide, `${width}`).toBeLessThanOrEqual(0);
      await page.screenshot({ path: resultFile(`start-${width}.png`) });
    }
    await page.getByLabel("Language").selectOption("fr");
    await page.getByRole("heading", { level: 1, name: "Que voulez-vous faire ?" }).waitFor();
    await page.locator("#tasks li").first().waitFor();
    expect(await page.locator("html").getAttribute("lang")).toBe("fr");
    await page.screenshot({ path: resultFile("start-french.png") });
    await page.reload();
    await page.getByRole("heading", { level: 1, name: "Que voulez-vous faire ?" }).waitFor();
    await page.getByRole("button", { name: "Préparer un patient" }).click();
    await page.getByRole("heading", { level: 1, name: "Un nouveau patient" }).waitFor();
    await page.locator("#status", { hasText: "en attente d'une image" }).waitFor();
    await page.screenshot({ path: resultFile("patient-french.png") });
    await page.getByRole("button", { name: "Retour à la page d'accueil" }).click();
    await page.getByRole("heading", { level: 1, name: "Que voulez-vous faire ?" }).waitFor({ timeout: 30_000 });
    expect(faults()).toEqual([]);
  });

  it("tells in words what cannot be made", async () => {
    writeFileSync(
      join(folder, "gone.toml"),
      'glisson_scene = 1\nname = "without its mesh"\n[organ]\nmesh = "gone.tet"\ntissue = "liver"\nmodel = "precomputed"\n[[organ.fixed]]\n' +
        'furthest = { direction = [0, 0, -1], fraction = 0.5 }\n[tool]\ntip_radius = "5 mm"\nhome_tip = [0, 0, "9 cm"]\nhome_shaft = [0, 0, 1]\n',
    );
    await page.getByRole("button", { name: "Look again" }).click();
    await page.locator("#scenes li", { hasText: "without its mesh" }).getByRole("button", { name: "Start" }).click();
    const error = page.locator("#error").filter({ hasText: "gone.tet" });
    await error.waitFor();
    // Where the button was, down the page.
    const box = (await error.boundingBox())!;
    expect(await page.evaluate(() => window.scrollY)).toBeGreaterThan(100);
    expect(box.y >= 0 && box.y + box.height <= 800).toBe(true);
    await page.screenshot({ path: resultFile("start-error.png") });
    expect(await page.getByRole("button", { name: "Bring in a patient" }).isEnabled()).toBe(true);
    // It is understood again at once.
    expect(await task(/./).first().getByRole("button", { name: /^Start/ }).isEnabled()).toBe(true);
    expect(faults()).toEqual([]);
  });
});
