/**
 * A new patient in one file, opened from disk with the network cut off: from a DICOM folder to a pushed liver, and to a file of its own. The
 * program in GLISSON_PROGRAM writes the page and the CT.
 */
import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, statSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { gunzipSync } from "node:zlib";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import type { Browser, BrowserContext, Page } from "playwright-core";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { cutAtTheMiddle } from "./cut_check";
import { dicomSeries } from "./dicom";
import { program } from "./serve";

const isThere = program !== undefined && existsSync(fileURLToPath(new URL("../wasm/glisson.wasm", import.meta.url)));
if (!isThere) console.warn("SKIPPED e2e/local_patient.e2e.ts: GLISSON_PROGRAM is not set, or `cargo xtask web` did not run");

/** The page may have so many bytes. */
const MOST_BYTES = 6e6;

describe.skipIf(!isThere)("a new patient in a page of its own", () => {
  const out = mkdtempSync(join(tmpdir(), "glisson-local-patient-"));
  let browser: Browser;
  beforeAll(async () => {
    browser = await startBrowser();
    execFileSync(program!, ["patient", "--html", "new_patient.html"], { cwd: out });
    execFileSync(program!, ["phantom", "--out", "phantom", "--voxel-mm", "3"], { cwd: out });
  });
  afterAll(async () => {
    await browser?.close();
    rmSync(out, { recursive: true });
  });

  /** Opens a file without a network; nothing but the file and what is in it may be asked for. */
  async function opened(file: string): Promise<{ page: Page; problems: string[] }> {
    const url = pathToFileURL(file).href;
    const { page, problems } = await openPage(browser, async (fresh) => {
      await (fresh.context() as BrowserContext).setOffline(true);
      fresh.on("request", (request) => {
        if (request.url() !== url && !/^(data|blob):/.test(request.url())) problems.push(request.url());
      });
    });
    await page.goto(url);
    return { page, problems };
  }

  /** The step is over. */
  const settled = (page: Page) =>
    page.waitForFunction(() => !document.getElementById("status")!.classList.contains("busy"), undefined, { timeout: 120_000 });

  it("goes from a DICOM folder to a pushed liver, and is saved", async () => {
    expect(statSync(join(out, "new_patient.html")).size).toBeLessThan(MOST_BYTES);
    const ct = join(out, "phantom", "ct.nii.gz");
    const { page, problems } = await opened(join(out, "new_patient.html"));
    await page.waitForFunction(() => document.getElementById("status")!.textContent === "waiting for an image");

    await page.setInputFiles("#files", [{ name: "letter.txt", mimeType: "text/plain", buffer: Buffer.from("Dear colleague") }]);
    await page.waitForSelector("#error:not([hidden])");
    expect(await page.textContent("#error")).toContain("the image");

    await page.setInputFiles("#files", dicomSeries(ct));
    await page.waitForSelector("#organ:not([hidden])", { timeout: 120_000 });
    expect(await page.textContent("#found")).toContain("DICOM, CT");
    await settled(page);
    const axial = (await page.locator("#axial").boundingBox())!;
    await page.mouse.click(axial.x + 0.25 * axial.width, axial.y + 0.4 * axial.height);

    // A step that is cancelled leaves what was.
    await page.click("#find");
    await page.waitForSelector("#cancel:not([hidden])");
    await page.keyboard.press("Escape");
    await settled(page);
    expect(await page.locator("#points li").count()).toBe(1);
    expect(await page.isHidden("#mesh")).toBe(true);
    await page.click("#find");
    await page.waitForSelector("#mesh:not([hidden])", { timeout: 120_000 });
    const volume_ml = parseFloat((await page.textContent("#organ-found"))!);
    expect(volume_ml).toBeGreaterThan(1200);
    expect(volume_ml).toBeLessThan(1700);

    await page.fill("#tetrahedra", "3000");
    await page.click("#fill");
    await page.waitForSelector("#start:not([hidden])", { timeout: 120_000 });
    await settled(page);
    await page.waitForFunction(() => (document.querySelector<HTMLImageElement>("#picture img")?.naturalWidth ?? 0) > 0);
    await page.screenshot({ path: resultFile("local_patient_tetrahedra.png") });
    const [download] = await Promise.all([page.waitForEvent("download"), page.click("#save")]);
    await download.saveAs(join(out, "saved.html"));
    await page.click("#run");
    await page.waitForSelector("#scene", { timeout: 60_000 });
    await waitForOrgan(page);
    const { answered, nodes } = await cutAtTheMiddle(page, resultFile("local_patient_pushed.png"));
    expect(answered).toEqual([]);
    expect(nodes).toBeGreaterThan(0);
    expect(problems).toEqual([]);
    await page.close();

    const html = readFileSync(join(out, "saved.html"), "utf8");
    const { files } = JSON.parse(/id="scene-files"[^>]*>([^<]*)</.exec(html)![1]!) as { files: Record<string, string> };
    expect(Object.keys(files).sort()).toEqual(["organ.vtu", "scene.toml"]);
    for (const letters of Object.values(files)) expect(gunzipSync(Buffer.from(letters, "base64")).toString("latin1")).not.toMatch(/secret/i);
    const saved = await opened(join(out, "saved.html"));
    await waitForOrgan(saved.page);
    expect(saved.problems).toEqual([]);
  });
});
