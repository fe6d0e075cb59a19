/** Starts the system's Chromium, without GPU and display, and says what a page's console said. */
import { existsSync, mkdirSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { chromium, type Browser, type Page } from "playwright-core";

export const DIST = fileURLToPath(new URL("../dist", import.meta.url));
const RESULTS = fileURLToPath(new URL("../test-results/", import.meta.url));

const CANDIDATES = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];

/** Path of a file for pictures of the tests. */
export function resultFile(name: string): string {
  mkdirSync(RESULTS, { recursive: true });
  return RESULTS + name;
}

export async function startBrowser(): Promise<Browser> {
  const executablePath = process.env.CHROMIUM ?? CANDIDATES.find((path) => existsSync(path));
  if (executablePath === undefined) {
    throw new Error(`no Chromium at ${CANDIDATES.join(", ")}: install it (apt-get install chromium) or set CHROMIUM`);
  }
  return chromium.launch({
    executablePath,
    headless: true,
    args: [
      "--headless",
      "--no-sandbox",
      "--disable-gpu",
      "--disable-quic",
      "--no-first-run",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-sync",
      "--use-gl=angle",
      "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader",
    ],
  });
}

export interface OpenPage {
  readonly page: Page;
  /** Errors of the console and uncaught exceptions, but for words about the server's pace. */
  readonly problems: string[];
}

/** What the server tells of its own pace: on a busy machine a browser without a GPU leaves it little. No problem of the page, no answer. */
export function isOfPace(message: string): boolean {
  return /^(Server: )?the simulation (is late|keeps pace)/.test(message);
}

export async function openPage(browser: Browser, prepare?: (page: Page) => Promise<void>): Promise<OpenPage> {
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
  const problems: string[] = [];
  page.on("console", (message) => {
    if (message.type() === "error" && !isOfPace(message.text())) problems.push(message.text());
  });
  page.on("pageerror", (error) => problems.push(String(error)));
  await prepare?.(page);
  return { page, problems };
}

/** Waits for the first topology and the first drawn snapshot. */
export async function waitForOrgan(page: Page): Promise<void> {
  await page.waitForFunction(
    () => window.glisson?.header != null && window.glisson.positions !== null && window.glisson.counters.drawnFrames > 0,
    undefined,
    { timeout: 30_000 },
  );
}
