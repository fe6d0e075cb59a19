/** What axe-core finds on every page: nothing worse than minor. The program is in GLISSON_PROGRAM. */
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import type { AxeResults } from "axe-core";
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { openPage, startBrowser, waitForOrgan } from "./browser";
import { program, serveProgram, type ServedProgram } from "./serve";

if (program === undefined) console.warn("SKIPPED e2e/accessibility.e2e.ts: GLISSON_PROGRAM is not set (the program glisson)");

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
/** A short task, in which tools are held and something is cut. */
const TASK = "clip_and_cut";
const MAKING_MS = 90_000;

/** What is worse than minor, each with its places. */
async function findings(page: Page): Promise<string[]> {
  await page.evaluate(AXE);
  const found = await page.evaluate(async () => {
    const { axe } = window as unknown as { axe: { run(options: object): Promise<AxeResults> } };
    return (await axe.run({ resultTypes: ["violations"] })).violations;
  });
  return found.filter(({ impact }) => impact !== "minor").map(({ id, impact, help, nodes }) => `${impact} ${id}: ${help}: ${nodes.map(({ target }) => target.join(" ")).join(", ")}`);
}

describe.skipIf(program === undefined)("accessibility", () => {
  let browser: Browser;
  let out: string;
  let served: ServedProgram | null = null;

  beforeAll(async () => {
    browser = await startBrowser();
    out = mkdtempSync(join(tmpdir(), "glisson-axe-"));
  });
  afterAll(async () => {
    await browser?.close();
    rmSync(out, { recursive: true, force: true });
  });
  afterEach(async () => {
    await Promise.all(browser.contexts().map((context) => context.close()));
    await served?.stop();
    served = null;
  });

  async function open(verb: readonly string[]): Promise<Page> {
    served = await serveProgram(verb, out);
    const { page } = await openPage(browser);
    await page.goto(served.url);
    return page;
  }

  it("the check finds what is wrong", async () => {
    const { page } = await openPage(browser);
    await page.setContent('<html lang="en"><title>t</title><main><h1>t</h1><img src="data:,"><button></button></main></html>');
    expect((await findings(page)).map((finding) => finding.split(":")[0])).toEqual(["critical button-name", "critical image-alt"]);
  });

  it("the start page, and that for a new patient", async () => {
    const page = await open(["start"]);
    await page.locator("#tasks li").first().waitFor();
    expect(await findings(page)).toEqual([]);
    await served?.stop();
    const patient = await open(["patient"]);
    await patient.locator("main").waitFor();
    expect(await findings(patient)).toEqual([]);
  });

  it("the viewer: theatre and laboratory view, task, messages, help, times", { timeout: 2 * MAKING_MS }, async () => {
    const page = await open(["task", "run", TASK, "--out", out]);
    await waitForOrgan(page);
    await page.locator("#task h2").waitFor();
    await page.waitForFunction(() => window.glisson!.theatre.on);
    expect(await findings(page)).toEqual([]);
    await page.keyboard.press("n");
    await page.waitForFunction(() => !window.glisson!.theatre.on);
    for (const key of ["c", "p", "Shift+V"]) await page.keyboard.press(key);
    await page.locator("#messages .message").first().waitFor();
    expect(await findings(page)).toEqual([]);
    await page.keyboard.press("h");
    await page.locator(".help").waitFor();
    expect(await findings(page)).toEqual([]);
    await page.setViewportSize({ width: 420, height: 800 });
    await page.keyboard.press("Escape");
    expect(await findings(page)).toEqual([]);
  });

  it("the report of a task, and the page that plays it", { timeout: 2 * MAKING_MS }, async () => {
    execFileSync(program!, ["task", "run", TASK, "--headless", "--replay", "--out", out], { stdio: "ignore" });
    const { page } = await openPage(browser);
    await page.goto(pathToFileURL(join(out, `${TASK}.html`)).href);
    await page.locator("h1").waitFor();
    expect(await findings(page)).toEqual([]);
    await page.goto(pathToFileURL(join(out, `${TASK}_replay.html`)).href);
    await page.waitForFunction(() => window.glissonReplay?.header != null, undefined, { timeout: MAKING_MS });
    expect(await findings(page)).toEqual([]);
    await page.keyboard.press("h");
    expect(await findings(page)).toEqual([]);
    // With a bookmark, and beside itself.
    await page.keyboard.press("Escape");
    await page.keyboard.press("*");
    expect(await findings(page)).toEqual([]);
    const session = join(out, `${TASK}.jsonl`);
    execFileSync(program!, ["export", session, "--beside", session, "--html", join(out, "both.html")], { stdio: "ignore" });
    await page.goto(pathToFileURL(join(out, "both.html")).href);
    await page.waitForFunction(() => window.glissonReplay?.beside?.header != null, undefined, { timeout: MAKING_MS });
    await page.getByText("Stages and moments of both").click();
    expect(await findings(page)).toEqual([]);
  });
});
