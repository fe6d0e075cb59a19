/** Cuts the organ with the keyboard and says what the page then shows. */
import type { Page } from "playwright-core";
import type {} from "../src/hook";
import { isOfPace, waitForOrgan } from "./browser";

export interface CutReport {
  /** What the server objected to. */
  readonly answered: readonly string[];
  /** Displayed vertices that lie in the cut alone. */
  readonly nodes: number;
}

const TIME_MS = 30_000;


/** Sets the tip on the organ at the middle of the view, presses it in and cuts; a screenshot goes to `picture`. */
export async function cutAtTheMiddle(page: Page, picture: string): Promise<CutReport> {
  await waitForOrgan(page);
  await page.keyboard.press("g");
  await page.waitForFunction(() => window.glisson!.header?.contact === true, undefined, { timeout: TIME_MS });
  await page.keyboard.press("Shift+u");
  await page.waitForFunction(() => window.glisson!.tool.settled, undefined, { timeout: TIME_MS });
  await page.waitForTimeout(300);
  const frames = await page.evaluate(() => window.glisson!.counters.topologyFrames);
  await page.keyboard.press("x");
  await page.waitForFunction((n) => window.glisson!.counters.topologyFrames > n, frames, { timeout: TIME_MS });
  await page.waitForTimeout(600);
  await page.screenshot({ path: picture });
  const report = await page.evaluate(() => {
    return { messages: [...window.glisson!.messages], nodes: window.glisson!.verticesInCuts };
  });
  await page.keyboard.press("Escape");
  await page.waitForTimeout(300);
  // The organ is left whole, as it was found.
  const cut = await page.evaluate(() => window.glisson!.counters.topologyFrames);
  await page.keyboard.press("z");
  await page.waitForFunction((n) => window.glisson!.counters.topologyFrames > n, cut, { timeout: TIME_MS });
  return { answered: report.messages.filter((message) => !isOfPace(message)), nodes: report.nodes };
}
