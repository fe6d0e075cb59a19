/**
 * What a laboratory has beside the picture, against a server of `e2e/laboratory.toml`: a number that is turned, the inside, plots, and the page of
 * input devices. `GLISSON_PROGRAM` is the program.
 */
import { spawn, spawnSync, type ChildProcess } from "node:child_process";
import { mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import type { Browser, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";

const PROGRAM = process.env.GLISSON_PROGRAM;
const SCENE = join(import.meta.dirname, "laboratory.toml");

/** Starts the program on a free port; its address. */
async function serve(session: string): Promise<{ readonly program: ChildProcess; readonly url: string }> {
  const program = spawn(PROGRAM!, ["serve", SCENE, "--port", "0", "--no-open", "--record", session]);
  const url = await new Promise<string>((resolve, reject) => {
    let said = "";
    const hear = (chunk: Buffer): void => {
      said += chunk.toString();
      const address = /Glisson is at (http\S+)/.exec(said);
      if (address !== null) resolve(address[1]!);
    };
    program.stdout.on("data", hear);
    program.stderr.on("data", hear);
    program.on("exit", () => reject(new Error(said)));
  });
  return { program, url };
}

/** Two gamepads whose sticks a test moves: `window.pads[0].axes[0] = 1`. */
const PADS = `
  window.pads = ["Left pad", "Right pad"].map((id, index) => ({
    id, index, connected: true, mapping: "standard", timestamp: 0, axes: [0, 0, 0, 0],
    buttons: Array.from({ length: 4 }, () => ({ pressed: false, touched: false, value: 0 })),
  }));
  navigator.getGamepads = () => window.pads;
`;

interface WithPads {
  pads: Array<{ axes: number[]; buttons: Array<{ pressed: boolean }> }>;
}

describe.skipIf(PROGRAM === undefined)("the laboratory", () => {
  const session = join(mkdtempSync(join(tmpdir(), "laboratory-")), "session.jsonl");
  let browser: Browser;
  let page: Page;
  let problems: string[];
  let program: ChildProcess;
  let url: string;

  beforeAll(async () => {
    browser = await startBrowser();
    ({ program, url } = await serve(session));
    ({ page, problems } = await openPage(browser));
    await page.addInitScript(PADS);
    await page.goto(url);
    await waitForOrgan(page);
    await page.evaluate(() => window.dispatchEvent(new Event("gamepadconnected")));
  });
  afterAll(async () => {
    await browser?.close();
    if (program?.exitCode === null) program.kill("SIGINT");
  });

  const tips = () => page.evaluate(() => window.glisson!.header!.tools.map(({ tip_m }) => tip_m));
  const moved = async (before: readonly (readonly number[])[], tool: number): Promise<number> =>
    Math.hypot(...(await tips())[tool]!.map((x, i) => x - before[tool]![i]!));
  const until = async (what: () => Promise<boolean>): Promise<void> => {
    await expect.poll(what, { timeout: 20_000 }).toBe(true);
  };

  it("a number that is turned by the keyboard holds, is shown, and stands in the session", async () => {
    await page.keyboard.press("Shift+M");
    const row = page.locator('[data-parameter="young_modulus:0"]');
    const field = row.locator("input");
    await expect.poll(() => field.evaluate((node) => node === document.activeElement)).toBe(true);
    expect(await field.inputValue()).toBe("4");
    await page.keyboard.press("ArrowUp");
    await until(async () => (await row.locator("small").textContent()) === "scene: 4 kPa");
    expect(await field.inputValue()).toBe("4.4");
    expect(await page.locator('[data-value="material"]').textContent()).toContain("E 4.4 kPa");
    await field.fill("soft");
    await field.press("Enter");
    expect(await row.locator("small").textContent()).toBe("allowed: 0.05 to 10000 kPa");
    await page.screenshot({ path: resultFile("turning.png") });
    await page.keyboard.press("Escape");
    expect(await page.locator("#turning").isHidden()).toBe(true);
  });

  it("colours have a legend, and a plane cuts the organ open", async () => {
    await page.keyboard.press("Shift+C");
    await page.keyboard.press("Shift+C");
    await page.keyboard.press("Shift+X");
    await page.keyboard.press("Shift+X");
    await until(() => page.evaluate(() => (window.glisson!.header!.inside?.section_m.length ?? 0) > 0));
    const inside = await page.evaluate(() => {
      const { field, values } = window.glisson!.header!.inside!;
      return { field, n: values.length };
    });
    expect(inside).toEqual({ field: "stress", n: await page.evaluate(() => window.glisson!.positions!.length / 3) });
    expect(await page.locator("#inside .inside-scale span").count()).toBe(3);
    await page.keyboard.press("PageDown");
    await page.screenshot({ path: resultFile("inside.png") });
    const slider = page.getByLabel("Place of the cut plane");
    await slider.focus();
    const place = await slider.inputValue();
    await page.keyboard.press("ArrowRight");
    expect(Number(await slider.inputValue())).toBeGreaterThan(Number(place));
    for (let i = 0; i < 2; i++) await page.keyboard.press("Shift+X");
    for (let i = 0; i < 2; i++) await page.keyboard.press("Shift+C");
    await until(() => page.evaluate(() => window.glisson!.header!.inside === null));
    expect(await page.locator("#inside").isHidden()).toBe(true);
  });

  it("plots have their numbers saved", async () => {
    for (const kind of ["force_displacement", "energy", "step_time", "force_time"]) {
      await page.keyboard.press("Shift+G");
      expect(await page.locator(".plot-choice").inputValue()).toBe(kind);
    }
    const [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("Shift+A")]);
    const csv = readFileSync((await download.path())!, "utf8");
    expect(csv.split("\n")[0]).toContain("time_s,force_n");
    expect(csv.split("\n").length).toBeGreaterThan(20);
  });

  it("two gamepads are mapped, tried without moving anything, and then move two instruments at once", async () => {
    await page.keyboard.press("Shift+E");
    const dialog = page.getByRole("dialog", { name: "Input devices" });
    const card = (name: string) => dialog.locator(".devices-card", { hasText: name });
    await card("Right pad").getByLabel("Moves", { exact: true }).selectOption("1");
    expect(await dialog.locator(".devices-table tr", { hasText: "2: hook" }).textContent()).toContain("Right pad");
    const before = await tips();
    const push = (on: number) =>
      page.evaluate((x) => {
        for (const pad of (window as unknown as WithPads).pads) pad.axes[0] = x;
      }, on);
    await push(1);
    await until(async () => (await card("Left pad").locator(".devices-bar.acts").count()) === 1);
    await page.screenshot({ path: resultFile("devices.png") });
    expect(Math.max(await moved(before, 0), await moved(before, 1))).toBeLessThan(1e-4);
    await page.keyboard.press("Escape");
    expect(await dialog.isHidden()).toBe(true);
    await until(async () => (await moved(before, 0)) > 2e-3 && (await moved(before, 1)) > 2e-3);
    await push(0);
  });

  it("what was mapped is kept, and a key that is a pedal switches as long as it is pressed", async () => {
    await page.keyboard.press("Shift+E");
    await page.getByRole("button", { name: "Add a pedal" }).click();
    await page.keyboard.press("F9");
    await page.getByLabel("Instrument of F9").selectOption("1");
    await page.keyboard.press("Escape");
    const trigger = () => page.evaluate(() => window.glisson!.header!.tools[1]!.trigger);
    await page.keyboard.down("F9");
    await until(async () => (await trigger()) === 1);
    await page.keyboard.up("F9");
    await until(async () => (await trigger()) === 0);
    const kept = await page.evaluate(() => JSON.parse(localStorage.getItem("glisson.settings.1")!));
    expect(kept.pads["Right pad"].instrument).toBe(1);
    expect(kept.pedals.F9).toEqual({ action: "trigger", instrument: 1, whileHeld: true });
  });

  it("another machine's page takes the instrument that is offered, and moves it alone", async () => {
    const other = await openPage(browser);
    await other.page.goto(url);
    await waitForOrgan(other.page);
    await page.keyboard.press("Shift+E");
    await page.getByRole("button", { name: "Offer to another machine: 2" }).click();
    await other.page.keyboard.press("Shift+E");
    await other.page.getByRole("button", { name: "Take: 2" }).click();
    await other.page.keyboard.press("Escape");
    await page.getByRole("button", { name: "Call back: 2" }).waitFor();
    await page.keyboard.press("Escape");
    const before = await tips();
    await other.page.keyboard.press("Shift+L");
    await until(async () => (await moved(before, 1)) > 2e-3);
    await page.keyboard.press("Shift+L");
    await until(async () => (await moved(before, 0)) > 2e-3);
    expect(other.problems).toEqual([]);
    await other.page.close();
  });

  it("nothing went wrong in the page", () => expect(problems).toEqual([]));

  it("the session holds what was turned, and replays to the same bits", async () => {
    const ended = new Promise((resolve) => program.on("exit", resolve));
    program.kill("SIGINT");
    await ended;
    expect(readFileSync(session, "utf8")).toMatch(/"event":"turn".*"parameter":"young_modulus","value":4400\.0\}/);
    const { stdout, status } = spawnSync(PROGRAM!, ["replay", session, "--folder", import.meta.dirname], { encoding: "utf8" });
    expect(status, stdout).toBe(0);
  });
});
