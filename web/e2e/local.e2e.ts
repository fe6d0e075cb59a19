/**
 * The page that has its simulation in itself, opened from disk: it is pushed and cut, and what it records has the same bits in Node and,
 * where no factor is made, in the program in GLISSON_PROGRAM.
 */
import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { setFlagsFromString } from "node:v8";
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { Program } from "../src/local/program";
import { unfused } from "../src/local/unfused";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { cutAtTheMiddle } from "./cut_check";
import { BLOCK, program } from "./serve";

const WASM = fileURLToPath(new URL("../wasm/glisson.wasm", import.meta.url));
const isThere = program !== undefined && existsSync(WASM);
if (!isThere) console.warn("SKIPPED e2e/local.e2e.ts: GLISSON_PROGRAM is not set, or `cargo xtask web` did not run");

/** A page may have so many bytes without its scene's files. */
const MOST_BYTES = 6e6;

const liver = (model: string, tetrahedra: number, step: string, tool: string): string => `glisson_scene = 1
name = "a liver, ${model}"
[simulation]
time_step = "${step}"
[organ]
phantom = { organ = "liver", seed = 1, tetrahedra = ${tetrahedra} }
tissue = "liver"
model = "${model}"
damping = "20 1/s"
${model === "precomputed" ? "" : 'law = "stable_neo_hooke"'}
[[organ.fixed]]
furthest = { direction = [0, 1, 0.4], fraction = 0.1 }
${tool}`;

const PROBE = `[tool]
tip_radius = "5 mm"
home_tip = ["-30 mm", "-120 mm", "20 mm"]
home_shaft = [0, -1, 0]
`;

/** The models of the page, on the phantom's liver. */
const LIVERS = {
  precomputed: liver("precomputed", 6300, "4 ms", PROBE),
  explicit: liver("explicit", 2000, "0.25 ms", PROBE),
  implicit: liver("implicit", 6300, "10 ms", PROBE),
};

/** A blade that touches the liver and cuts it along a line. */
const BLADE = `[[tool]]
name = "scalpel"
kind = "scalpel"
tip_radius = "1 mm"
shaft_radius = "1 mm"
blade_length = "20 mm"
home_tip = ["-64 mm", "-80 mm", "20 mm"]
home_shaft = [-0.3, -1, 0]
path = [
  { time = "0.1 s", tip = ["-64 mm", "-53 mm", "20 mm"] },
  { time = "0.2 s", tip = ["-64 mm", "-50 mm", "20 mm"] },
  { time = "0.25 s", tip = ["-64 mm", "-50 mm", "20 mm"], trigger = 1 },
  { time = "0.3 s", tip = ["-62 mm", "-46 mm", "20 mm"], trigger = 1 },
  { time = "1.0 s", tip = ["-10 mm", "-46 mm", "20 mm"], trigger = 1 },
]
`;

describe.skipIf(!isThere)("a page with its simulation in itself", () => {
  const out = mkdtempSync(join(tmpdir(), "glisson-local-"));
  let browser: Browser;

  beforeAll(async () => {
    // Node 20 has it, but does not turn it on.
    setFlagsFromString("--experimental-wasm-relaxed-simd");
    browser = await startBrowser();
  });
  afterEach(async () => {
    await Promise.all(browser.contexts().map((context) => context.close()));
  });
  afterAll(async () => {
    await browser?.close();
    rmSync(out, { recursive: true });
  });

  const run = (...verb: string[]): string => execFileSync(program!, verb, { encoding: "utf8", cwd: out });

  /** Exports a scene; answers the page's address. */
  function exported(name: string, scene: string): string {
    writeFileSync(join(out, `${name}.toml`), scene);
    run("export", `${name}.toml`, "--html", `${name}.html`);
    return pathToFileURL(join(out, `${name}.html`)).href;
  }

  /** Opens it; nothing but the file and what is in it may be asked for. */
  async function opened(url: string): Promise<{ page: Page; problems: string[] }> {
    const { page, problems } = await openPage(browser, async (fresh) => {
      fresh.on("request", (request) => {
        if (request.url().split("#")[0] !== url.split("#")[0] && !/^(data|blob):/.test(request.url())) problems.push(request.url());
      });
    });
    await page.goto(url);
    await waitForOrgan(page);
    return { page, problems };
  }

  /** What the page recorded up to now. */
  async function savedSession(page: Page, name: string): Promise<string> {
    const save = page.locator(".kept li").first().getByRole("button", { name: "Save" });
    await save.waitFor();
    const [download] = await Promise.all([page.waitForEvent("download"), save.click()]);
    const path = join(out, name);
    await download.saveAs(path);
    return path;
  }

  /** The simulation in Node, with a session or a scene. */
  async function inNode(file: string, bytes = new Uint8Array(readFileSync(WASM))): Promise<Program> {
    const module = await WebAssembly.compile(bytes);
    return Program.start(module, new Map([["file", new Uint8Array(readFileSync(file))]]));
  }

  it.each(Object.entries(LIVERS))("%s: a liver is pushed, cut and made whole again, with the same bits in Node", async (name, scene) => {
    const { page, problems } = await opened(exported(name, scene));
    const { answered, nodes } = await cutAtTheMiddle(page, resultFile(`local_${name}.png`));
    expect(answered).toEqual([]);
    expect(nodes).toBeGreaterThan(0);
    const { realTimeFactor, step } = await page.evaluate(() => window.glisson!.header!);
    const session = await savedSession(page, `${name}.jsonl`);
    expect(problems).toEqual([]);
    await page.close();
    const [steps, , , difference, checkpoints] = (await inNode(session)).replay("file");
    console.log(JSON.stringify({ name, realTimeFactor, step, steps, checkpoints }));
    expect(difference).toBe("-");
    expect(Number(checkpoints)).toBeGreaterThan(1);
    const said = run("replay", session);
    // No factor is made for explicit steps.
    if (name === "explicit") expect(said).not.toContain("other bits");
    expect(said).toMatch(/check-points +[1-9]\d* compared/);
  });

  it("has few bytes, keeps its sessions, and says what is wrong with a scene", async () => {
    const url = exported("block", BLOCK);
    expect(statSync(join(out, "block.html")).size).toBeLessThan(MOST_BYTES);
    const { page, problems } = await opened(url);
    await page.waitForFunction(() => document.querySelectorAll(".kept li").length === 1);
    await page.reload();
    await waitForOrgan(page);
    await page.waitForFunction(() => document.querySelectorAll(".kept li").length === 2);
    // Once no other page can be recording it.
    await page.locator(".kept li").nth(1).getByRole("button", { name: "Forget" }).click();
    await page.waitForFunction(() => document.querySelectorAll(".kept li").length === 1);
    expect(problems).toEqual([]);
    const broken = readFileSync(join(out, "block.html"), "utf8").replace(/"files":\{"[^"]+":"[^"]+"/, '"files":{');
    writeFileSync(join(out, "broken.html"), broken);
    await page.goto(pathToFileURL(join(out, "broken.html")).href);
    await page.waitForFunction(() => document.querySelector("#banner")?.textContent?.includes("cannot read the scene"));
  });

  it("10,000 explicit steps with contact and a cut have the program's bits in Node", async () => {
    writeFileSync(join(out, "blade.toml"), liver("explicit", 2000, "0.25 ms", BLADE));
    const said = run("run", "blade.toml", "--steps", "10000", "--record", "blade.jsonl");
    expect(said).toMatch(/cut by blades +[1-9]/);
    const simulation = await inNode(join(out, "blade.jsonl"));
    expect(simulation.arithmetic()).toBe("web_fused");
    const [steps, hash, recorded, difference, checkpoints] = simulation.replay("file");
    console.log(JSON.stringify({ steps, hash, checkpoints }));
    expect([steps, hash, difference]).toEqual(["10000", recorded, "-"]);
    expect(Number(checkpoints)).toBeGreaterThanOrEqual(20);
  });

  it("a browser without fused multiplication and addition is in a class of its own", async () => {
    writeFileSync(join(out, "blade.toml"), liver("explicit", 2000, "0.25 ms", BLADE));
    const bytes = unfused(new Uint8Array(readFileSync(WASM)));
    const both = [];
    for (let i = 0; i < 2; i++) {
      const simulation = await inNode(join(out, "blade.toml"), bytes);
      expect(simulation.arithmetic()).toBe("web_separate");
      simulation.openRun("file");
      both.push(simulation.run(2000));
    }
    expect(both[0]).toBe(both[1]);
    const fused = await inNode(join(out, "blade.toml"));
    fused.openRun("file");
    expect(fused.run(2000)).not.toBe(both[0]);
  });

  it("says what a browser lacks, and lets time stand still while nobody sees it", async () => {
    const url = exported("block", BLOCK);
    const lacking = {
      SIMD: () => {
        WebAssembly.validate = () => false;
      },
      "WebGL 2": () => {
        HTMLCanvasElement.prototype.getContext = () => null;
      },
    };
    for (const [words, without] of Object.entries(lacking)) {
      const page = await (await browser.newContext()).newPage();
      await page.addInitScript(without);
      await page.goto(url);
      await page.waitForSelector("#banner:not([hidden])");
      expect(await page.textContent("#banner")).toContain(words);
    }

    const { page, problems } = await opened(url);
    const see = (hidden: boolean) =>
      page.evaluate((is) => {
        Object.defineProperty(document, "hidden", { get: () => is, configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
      }, hidden);
    const step = () => page.evaluate(() => window.glisson!.header!.step);
    await see(true);
    await page.waitForTimeout(500);
    const before = await step();
    await page.waitForTimeout(1500);
    expect(await step()).toBe(before);
    await see(false);
    await page.waitForFunction((n) => window.glisson!.header!.step > n + 20, before);
    expect(await page.evaluate(() => window.glisson!.messages.join(" "))).toContain("stood still");
    expect(problems).toEqual([]);
  });

  it("a task that is over has its report, in a tab of its own", async () => {
    const touch = `${PROBE.replace("[tool]", '[[tool]]\nname = "probe"')}path = [{ time = "0.5 s", tip = ["-30 mm", "-50 mm", "20 mm"] }]
[task]
title = "Touch the liver"
time_limit = "1 min"
gate = { peak_force = "0.01 N" }
[[task.stage]]
title = "Touch it"
touch = { tool = "probe" }
`;
    const { page, problems } = await opened(`${exported("touch", liver("precomputed", 2000, "4 ms", touch))}#demonstrate`);
    const way = page.getByRole("button", { name: "Look at the report" });
    await way.waitFor({ timeout: 60_000 });
    const [report] = await Promise.all([page.waitForEvent("popup"), way.click()]);
    await report.getByRole("heading", { name: "Safety gate" }).waitFor();
    expect(await report.title()).toBe("Touch the liver: report");
    expect(await report.getByText("all stages done").count()).toBe(1);
    expect(await report.locator("svg").count()).toBeGreaterThan(0);
    await report.screenshot({ path: resultFile("local_report.png"), fullPage: true });
    expect(problems).toEqual([]);
  });

  it("a recorded session is played, and taken over at the moment that is shown", async () => {
    writeFileSync(join(out, "recorded.toml"), `${LIVERS.precomputed.replace(PROBE, "")}${PROBE}path = [{ time = "0.5 s", tip = ["-30 mm", "-50 mm", "20 mm"] }, { time = "0.8 s", tip = ["-30 mm", "-48 mm", "20 mm"] }]\n`);
    run("run", "recorded.toml", "--record", "recorded.jsonl");
    run("export", "recorded.jsonl", "--take-over", "--html", "recorded.html");
    const { page, problems } = await openPage(browser);
    await page.goto(pathToFileURL(join(out, "recorded.html")).href);
    await page.waitForFunction(() => window.glissonReplay?.header != null);
    await page.keyboard.press("End");
    for (let i = 0; i < 3; i++) await page.keyboard.press("ArrowLeft");
    await page.waitForFunction(() => window.glissonReplay!.frame === window.glissonReplay!.nFrames - 4);
    const recorded = await page.evaluate(() => window.glissonReplay!.header!);
    await page.keyboard.press("a");
    await page.waitForFunction(() => window.glisson?.header != null, undefined, { timeout: 60_000 });
    const taken = await page.evaluate(() => window.glisson!.header!);
    expect([taken.step, taken.paused]).toEqual([recorded.step, true]);
    expect(Math.hypot(...taken.forceOnTool_n)).toBeGreaterThan(0.02);
    for (const [axis, force_n] of taken.forceOnTool_n.entries()) expect(force_n).toBeCloseTo(recorded.forceOnTool_n[axis]!, 3);
    await page.screenshot({ path: resultFile("local_taken_over.png") });
    await page.keyboard.press(" ");
    await page.waitForFunction((step) => window.glisson!.header!.step > step + 20, taken.step);
    const session = await savedSession(page, "taken.jsonl");
    expect(problems).toEqual([]);
    const [steps, , , difference] = (await inNode(session)).replay("file");
    expect([Number(steps) > taken.step, difference]).toEqual([true, "-"]);
  });
});
