/**
 * A new patient by the page, from a DICOM folder to a pushed organ, against a running `glisson patient` whose address is in
 * GLISSON_PATIENT_URL; the CT is in GLISSON_CT (NIfTI), the folder that it writes to in GLISSON_PATIENT_OUT.
 */
import { readdirSync, readFileSync } from "node:fs";
import { dirname, join } from "node:path";
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

/** What a screen reader could not say: what can be focused, and pictures, without a name in the browser's accessibility tree. */
async function withoutName(page: Page): Promise<string[]> {
  const session = await page.context().newCDPSession(page);
  const { nodes } = await session.send("Accessibility.getFullAXTree");
  const isSilent = ({ ignored, role, name, properties }: (typeof nodes)[number]): boolean => {
    const canFocus = properties?.some((property) => property.name === "focusable" && property.value.value === true) ?? false;
    const isPage = role?.value === "RootWebArea";
    return !ignored && !isPage && (canFocus || role?.value === "image") && (name?.value ?? "") === "";
  };
  return nodes.filter(isSilent).map(({ role, nodeId }) => `${role?.value} ${nodeId}`);
}

/** The picture of the tetrahedra, once it is another one than before. */
async function pictureIsThere(page: Page, before = ""): Promise<string> {
  await page.waitForFunction((old) => {
    const picture = document.querySelector<HTMLImageElement>("#picture img");
    return picture !== null && picture.complete && picture.naturalWidth > 0 && picture.src !== old;
  }, before);
  return page.evaluate(() => document.querySelector<HTMLImageElement>("#picture img")!.src);
}

/** Labels become organs of one mesh, which is cut open and coloured by quality. */
async function showsSeveralOrgans(page: Page): Promise<void> {
  await page.setInputFiles("#files", join(dirname(ct!), "labels.nii.gz"));
  await page.waitForFunction(() => document.getElementById("found")!.textContent!.includes("labels"), undefined, { timeout: 60_000 });
  await settled(page);
  for (const [at, label] of ["liver", "liver_tumour", "gall_bladder"].entries()) {
    await page.selectOption("#label", { label });
    await page.click("#find");
    await page.waitForFunction((n) => document.querySelectorAll("#organs li").length === n, at + 1, { timeout: 60_000 });
    await settled(page);
  }
  await page.fill("#tetrahedra", "10000");
  await page.click("#fill");
  await page.waitForSelector("#start:not([hidden])", { timeout: 90_000 });
  await settled(page);
  const facts = (await page.textContent("#mesh-found"))!;
  for (const words of ["liver_tumour", "gall_bladder", "bodies1"]) expect(facts).toContain(words);
  expect(await page.locator("#tissues select").evaluateAll((selects) => selects.map((s) => (s as HTMLSelectElement).value))).toEqual(["liver", "liver", "gall_bladder"]);
  let picture = await pictureIsThere(page);
  await page.locator("#share").fill("0.45");
  picture = await pictureIsThere(page, picture);
  await page.selectOption("#colours", "quality");
  picture = await pictureIsThere(page, picture);
  await page.locator("#picture").focus();
  await page.keyboard.press("ArrowRight");
  picture = await pictureIsThere(page, picture);
  expect(picture).toContain("/35.0/16.0/coronal/0.450/quality");
  expect(await page.locator("#quality li").count()).toBe(6);
  await page.screenshot({ path: resultFile("patient_6_organs.png") });
  await page.selectOption("#colours", "organ");
  await page.locator("#share").fill("0");
}

/** A line drawn round the liver by the mouse; a step that is cancelled leaves what was, and contours are found from the line. */
async function correctsByHand(page: Page, before_ml: number): Promise<void> {
  await page.selectOption("#method", "contours");
  await page.keyboard.press("c");
  const axial = (await page.locator("#axial").boundingBox())!;
  const [x, y] = [axial.x + 0.25 * axial.width, axial.y + 0.4 * axial.height];
  await page.mouse.move(x + 24, y);
  await page.mouse.down();
  for (let i = 1; i < 40; i++) await page.mouse.move(x + 24 * Math.cos(i / 6.4), y + 18 * Math.sin(i / 6.4));
  await page.mouse.up();
  expect(await page.locator("#outlines li").count()).toBe(1);
  expect(await page.locator("#axial path.by-hand").count()).toBe(1);
  // Two corners are no outline.
  for (let i = 0; i < 2; i++) await page.mouse.click(x + 5 * i, y + 5);
  await page.keyboard.press("f");
  expect(await page.textContent("#error")).toContain("3 corners");
  for (let i = 0; i < 2; i++) await page.keyboard.press("Backspace");

  await page.click("#find");
  await page.waitForSelector("#cancel:not([hidden])");
  await page.keyboard.press("Escape");
  await settled(page);
  expect(parseFloat((await page.textContent("#organ-found"))!)).toBe(before_ml);
  await page.click("#find");
  await page.waitForFunction((ml) => parseFloat(document.getElementById("organ-found")!.textContent!) !== ml, before_ml, { timeout: 90_000 });
  await settled(page);
  expect(parseFloat((await page.textContent("#organ-found"))!)).toBeGreaterThan(0.8 * before_ml);
  await page.keyboard.press("i");
  await page.locator("#axial").focus();
  for (let i = 0; i < 3; i++) await page.keyboard.press("PageUp");
  await page.waitForSelector("#axial path.found");
  await page.waitForTimeout(800);
  await page.screenshot({ path: resultFile("patient_3b_contours.png") });

  await page.selectOption("#method", "points");
  await page.click("#find");
  await page.waitForFunction((ml) => parseFloat(document.getElementById("organ-found")!.textContent!) === ml, before_ml, { timeout: 90_000 });
  await settled(page);
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

    await showsSeveralOrgans(page);

    await page.setInputFiles("#files", dicomSeries(ct!));
    await page.waitForSelector("#organ:not([hidden])", { timeout: 90_000 });
    await page.waitForFunction(() => /DICOM, CT.*× 144 of/.test(document.getElementById("found")!.textContent!), undefined, { timeout: 90_000 });
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
    await correctsByHand(page, volume_ml);

    await page.fill("#tetrahedra", "3000");
    await page.click("#fill");
    await page.waitForSelector("#start:not([hidden])", { timeout: 90_000 });
    await settled(page);
    expect(await page.textContent("#mesh-found")).toContain("dihedral angles");
    await pictureIsThere(page);
    await page.screenshot({ path: resultFile("patient_4_tetrahedra.png") });
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
