/**
 * A new patient by the page, from a DICOM folder to a pushed organ, against a running `glisson patient` whose address is in
 * GLISSON_PATIENT_URL; the CT is in GLISSON_CT (NIfTI), the folder that it writes to in GLISSON_PATIENT_OUT.
 */
import { readdirSync, readFileSync } from "node:fs";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import type { Browser, Page } from "playwright-core";
import { openPage, resultFile, startBrowser, waitForOrgan } from "./browser";
import { checkDragShowsServerState } from "./drag_check";
import { dicomSeries } from "./dicom";

const { GLISSON_PATIENT_URL: url, GLISSON_CT: ct, GLISSON_PATIENT_OUT: out } = process.env;
if (url === undefined || ct === undefined || out === undefined) {
  console.warn("SKIPPED e2e/patient.e2e.ts: GLISSON_PATIENT_URL, GLISSON_CT and GLISSON_PATIENT_OUT are not set");
}

/** The step is over, and went well unless an error is awaited. */
async function settled(page: Page): Promise<void> {
  await page.waitForFunction(() => !document.getElementById("status")!.classList.contains("busy"), undefined, { timeout: 90_000 });
}

/** Every control has a name that a screen reader can say, and pictures have a text. */
function withoutName(page: Page): Promise<string[]> {
  return page.evaluate(() => {
    const isNamed = (node: Element): boolean =>
      (node.getAttribute("aria-label") ?? node.getAttribute("title") ?? "") !== "" ||
      ((node as HTMLInputElement).labels?.length ?? 0) > 0 ||
      (node.tagName === "BUTTON" && (node.textContent ?? "").trim() !== "");
    const controls = [...document.querySelectorAll("button, input, select, [tabindex]")];
    const pictures = [...document.querySelectorAll("img:not([alt])")];
    return [...controls.filter((node) => !isNamed(node)), ...pictures].map((node) => node.outerHTML.slice(0, 90));
  });
}

describe.skipIf(url === undefined || ct === undefined || out === undefined)(`a new patient on ${url}`, () => {
  let browser: Browser;
  beforeAll(async () => {
    browser = await startBrowser();
  });
  afterAll(async () => {
    await browser?.close();
  });

  it("goes from a DICOM folder to a pushed liver", async () => {
    const { page, problems } = await openPage(browser);
    await page.goto(url!);
    await page.waitForFunction(() => document.getElementById("status")!.textContent === "waiting for an image");
    await page.screenshot({ path: resultFile("patient_1_empty.png") });

    // What is no image is refused in words, and the page goes on.
    await page.setInputFiles("#files", [{ name: "letter.txt", mimeType: "text/plain", buffer: Buffer.from("Dear colleague") }]);
    await page.waitForSelector("#error:not([hidden])");
    expect(await page.textContent("#error")).toContain("the image");

    // Of several series one is chosen, and another one after it.
    await page.setInputFiles("#files", [...dicomSeries(ct!, 3, 12), ...dicomSeries(ct!, 4, 20)]);
    await page.waitForSelector("#series li:nth-child(2) button");
    for (const [place, slices] of [
      [2, 20],
      [1, 12],
    ] as const) {
      await page.locator(`#series li:nth-child(${place}) button`).click();
      await page.waitForFunction((n) => document.getElementById("found")!.textContent!.includes(`× ${n} of`), slices, { timeout: 60_000 });
    }

    await page.setInputFiles("#files", dicomSeries(ct!));
    await page.waitForSelector("#organ:not([hidden])", { timeout: 90_000 });
    await page.waitForFunction(() => document.getElementById("found")!.textContent!.includes("× 144 of"), undefined, { timeout: 90_000 });
    expect(await page.textContent("#found")).toContain("DICOM, CT");
    await settled(page);
    expect(await page.isHidden("#series")).toBe(true);
    await page.waitForTimeout(800);
    await page.screenshot({ path: resultFile("patient_2_image.png") });

    const slice = await page.textContent("figure:has(#axial) figcaption");
    await page.mouse.move(800, 200);
    await page.mouse.wheel(0, 100);
    await page.waitForFunction((before) => document.querySelector("figure:has(#axial) figcaption")!.textContent !== before, slice);
    await page.mouse.wheel(0, -100);
    await page.waitForFunction((before) => document.querySelector("figure:has(#axial) figcaption")!.textContent === before, slice);

    // A point by the mouse in the right lobe, one outside by keys.
    const axial = (await page.locator("#axial").boundingBox())!;
    await page.mouse.click(axial.x + 0.25 * axial.width, axial.y + 0.4 * axial.height);
    await page.locator("#axial").focus();
    await page.keyboard.press("PageUp");
    await page.keyboard.press("o");
    for (let i = 0; i < 17; i++) await page.keyboard.press("Shift+ArrowRight");
    await page.keyboard.press("Enter");
    expect(await page.locator("#points li").evaluateAll((items) => items.map((item) => item.className))).toEqual(["inside", "outside"]);
    await page.locator("#points li.outside button").click();
    await page.click("#find");
    await page.waitForSelector("#mesh:not([hidden])", { timeout: 90_000 });
    const volume_ml = parseFloat((await page.textContent("#organ-found"))!);
    expect(volume_ml).toBeGreaterThan(1200);
    expect(volume_ml).toBeLessThan(1600);
    await page.waitForTimeout(800);
    await page.screenshot({ path: resultFile("patient_3_organ.png") });

    await page.fill("#tetrahedra", "3000");
    await page.click("#fill");
    await page.waitForSelector("#start:not([hidden])", { timeout: 90_000 });
    await settled(page);
    expect(await page.textContent("#mesh-found")).toContain("dihedral angles");
    await page.waitForFunction(() => document.querySelector<HTMLImageElement>("#picture")!.naturalWidth > 0);
    await page.screenshot({ path: resultFile("patient_4_tetrahedra.png"), fullPage: true });
    expect(await withoutName(page)).toEqual([]);

    await page.click("#run");
    await page.waitForSelector("#scene", { timeout: 120_000 });
    await waitForOrgan(page);
    // The organ on the page follows the probe as the server says, and pushes back.
    const report = await checkDragShowsServerState(page, url!, resultFile("patient_5_pushed.png"));
    console.log(JSON.stringify(report));

    // Nothing of who the patient is, and none of the files, stays.
    expect(readdirSync(out!).sort()).toEqual(["organ.vtu", "scene.toml"]);
    for (const name of readdirSync(out!)) expect(readFileSync(`${out!}/${name}`, "latin1")).not.toMatch(/secret/i);
    expect(problems).toEqual([]);
  });
});
