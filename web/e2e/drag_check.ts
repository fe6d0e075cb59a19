/**
 * The check that what is on the screen is what the server computed: press on the organ, drag, hold, pause, and compare
 * the displayed vertex and the panel with `/api/snapshot`. It throws when they differ.
 */
import type { Page, WebSocketRoute } from "playwright-core";
import type {} from "../src/hook";
import { encodeSnapshot } from "../src/encode";
import type { Key } from "../src/coded_positions";
import { decodeBinary } from "../src/protocol";
import { waitForOrgan } from "./browser";

/** Largest allowed difference of displacements, as a share of the server's. */
const DISPLACEMENT_TOLERANCE = 0.02;
/** Largest allowed difference of the panel's force, as a share of the server's. */
const FORCE_TOLERANCE = 0.01;
/** The vertex must have moved at least so far for the comparison to say anything [m]. */
const SMALLEST_DISPLACEMENT_M = 0.002;
/** Millimetres that the wheel pushes deeper before the drag. */
const NOTCHES = 10;
/** Tool, solver and display come to rest within this time after the last motion of the hand. */
const REST_MS = 30_000;

export interface ServerSnapshot {
  readonly step: number;
  readonly paused: boolean;
  readonly tools: ReadonlyArray<{
    readonly tip_m: number[];
    readonly force_on_tool_n: number[];
    readonly contact: { readonly point_m: number[]; readonly node_ids: number[]; readonly weights: number[] } | null;
  }>;
  readonly node_ids: number[];
  readonly rest_positions_m: number[][];
  readonly positions_m: number[][];
}

export interface DragReport {
  readonly vertex: number;
  readonly node: number;
  readonly displacement_m: number;
  readonly displacementError: number;
  readonly force_n: number;
  readonly forceError: number;
  /** Distance of the displayed vertex from the pointer [CSS pixels]. */
  readonly pointerDistance_px: number;
}

const length = (v: readonly number[]): number => Math.hypot(...v);
const difference = (a: readonly number[], b: readonly number[]): number[] => a.map((x, i) => x - b[i]);

export async function fetchSnapshot(url: string): Promise<ServerSnapshot> {
  const response = await fetch(new URL("api/snapshot", url));
  if (!response.ok) throw new Error(`${response.url} answered ${response.status}`);
  return (await response.json()) as ServerSnapshot;
}

/** A free vertex of the front side near the middle of the view beside the panel, and where it is on the page. */
async function vertexNearTheMiddle(page: Page): Promise<{ vertex: number; x: number; y: number }> {
  const found = await page.evaluate(() => {
    const viewer = window.glisson!;
    const count = viewer.nodeIds!.length;
    const covered = document.getElementById("panel")?.getBoundingClientRect().right ?? 0;
    const [cx, cy] = [(covered + window.innerWidth) / 2, window.innerHeight / 2];
    const fixed = new Set(viewer.hello!.fixed_nodes);
    const nodes = viewer.nodeIds!;
    const places = Array.from({ length: count }, (_, vertex) => ({ vertex, at: viewer.project(vertex)! }))
      .filter(({ vertex }) => !fixed.has(nodes[vertex]))
      .map(({ vertex, at: [x, y] }) => ({ vertex, x, y, distance: Math.hypot(x - cx, y - cy) }))
      .sort((a, b) => a.distance - b.distance)
      .slice(0, 200);
    // In front: a ray through it meets it first, and the canvas is on top there.
    return places.find(({ vertex, x, y }) => {
      return viewer.vertexAt(x, y) === vertex && document.elementFromPoint(x, y)?.id === "scene";
    });
  });
  if (found === undefined) throw new Error("no vertex of the organ's front side is near the middle of the view");
  return found;
}

/**
 * Presses on the organ with real mouse events, drags, holds, and pauses; compares page and server; lets go again.
 * While it holds, a screenshot goes to the file `picture`.
 * @throws Error with the found and the allowed value when the page does not show what the server computed.
 */
export async function checkDragShowsServerState(page: Page, url: string, picture?: string): Promise<DragReport> {
  await page.goto(url);
  await waitForOrgan(page);
  const { vertex, x, y } = await vertexNearTheMiddle(page);
  await page.mouse.move(x, y);
  await page.mouse.down();
  try {
    await page.waitForFunction(() => window.glisson!.tool.settled, undefined, { timeout: REST_MS });
    // Deeper, so that friction takes the vertex along.
    for (let i = 0; i < NOTCHES; i++) await page.mouse.wheel(0, -100);
    await page.waitForFunction(() => window.glisson!.tool.settled, undefined, { timeout: REST_MS });
    let at: [number, number] = [x, y];
    for (const [dx, dy] of [[2, 3], [5, 6], [8, 10], [11, 13], [14, 16]]) {
      at = [x + dx, y + dy];
      await page.mouse.move(...at);
      await page.waitForTimeout(60);
    }
    await page.waitForFunction(() => window.glisson!.tool.settled, undefined, { timeout: REST_MS });
    // Hold: the simulated tool and tissue come to rest.
    await page.waitForTimeout(1200);
    await page.keyboard.press("Space");
    await page.waitForFunction(() => window.glisson!.header!.paused, undefined, { timeout: REST_MS });
    // When the processor draws, the finer picture comes a moment after the last change.
    await page.waitForTimeout(900);
    if (picture !== undefined) await page.screenshot({ path: picture });
    return await compare(page, url, vertex, at);
  } finally {
    await letGo(page);
  }
}

/** Leaves the server as it was found; what goes wrong here would only hide why the check failed. */
async function letGo(page: Page): Promise<void> {
  try {
    await page.mouse.up();
    if (await page.evaluate(() => window.glisson!.header?.paused ?? false)) await page.keyboard.press("Space");
    await page.waitForTimeout(100);
    await page.keyboard.press("Shift+R");
    await page.waitForTimeout(200);
  } catch (error) {
    console.warn(`the page could not be left as it was found: ${String(error)}`);
  }
}

async function compare(page: Page, url: string, vertex: number, pointer: [number, number]): Promise<DragReport> {
  const server = await fetchSnapshot(url);
  if (!server.paused) throw new Error("the server's snapshot is not paused although the page asked for it");
  await page.waitForFunction((step) => window.glisson!.header!.step >= step, server.step, { timeout: REST_MS });
  const shown = await page.evaluate((v) => {
    const viewer = window.glisson!;
    return {
      step: viewer.header!.step,
      node: viewer.nodeIds![v],
      picked: viewer.pickedVertex,
      position: Array.from(viewer.positions!.subarray(3 * v, 3 * v + 3)),
      forceText: document.querySelector('[data-value="force"]')?.textContent ?? "",
      at: viewer.project(v)!,
    };
  }, vertex);
  if (shown.step !== server.step) throw new Error(`the page shows step ${shown.step}, the server is at ${server.step}`);
  if (shown.picked !== vertex) throw new Error(`the press picked vertex ${shown.picked}, aimed at ${vertex}`);

  const row = server.node_ids.indexOf(shown.node);
  if (row < 0) throw new Error(`the server's snapshot has no node ${shown.node}`);
  const rest = server.rest_positions_m[row];
  const serverDisplacement = difference(server.positions_m[row], rest);
  const shownDisplacement = difference(shown.position, rest);
  const displacement_m = length(serverDisplacement);
  if (!(displacement_m >= SMALLEST_DISPLACEMENT_M)) {
    throw new Error(
      `the server moved node ${shown.node} by ${(1000 * displacement_m).toFixed(3)} mm; ` +
        `at least ${1000 * SMALLEST_DISPLACEMENT_M} mm are needed`,
    );
  }
  const displacementError = length(difference(shownDisplacement, serverDisplacement)) / displacement_m;
  if (!(displacementError <= DISPLACEMENT_TOLERANCE)) {
    throw new Error(
      `displayed displacement of vertex ${vertex} differs by ${(100 * displacementError).toFixed(2)} % from the ` +
        `server's ${(1000 * displacement_m).toFixed(3)} mm; allowed ${100 * DISPLACEMENT_TOLERANCE} %`,
    );
  }
  const force_n = length(server.tools[0].force_on_tool_n);
  if (!(force_n > 0)) throw new Error("the server's force on the tool is 0");
  const match = /^([0-9.]+) N$/.exec(shown.forceText);
  if (match === null) throw new Error(`the panel's force reads "${shown.forceText}"`);
  const forceError = Math.abs(Number(match[1]) - force_n) / force_n;
  if (!(forceError <= FORCE_TOLERANCE)) {
    throw new Error(
      `the panel's force "${shown.forceText}" differs by ${(100 * forceError).toFixed(2)} % from the server's ` +
        `${force_n} N; allowed ${100 * FORCE_TOLERANCE} %`,
    );
  }
  const pointerDistance_px = length(difference(shown.at, pointer));
  return { vertex, node: shown.node, displacement_m, displacementError, force_n, forceError, pointerDistance_px };
}

/** Between page and server: every SNAPSHOT frame gets the rest positions of the last TOPOLOGY frame. */
export async function keepSendingRestShape(page: Page): Promise<{ rewritten(): number }> {
  let rewritten = 0;
  await page.routeWebSocket(/\/ws$/, (route: WebSocketRoute) => {
    let rest: Float32Array | null = null;
    let key: Key | null = null;
    const server = route.connectToServer();
    route.onMessage((message) => server.send(message));
    server.onMessage((message) => {
      if (typeof message === "string") {
        route.send(message);
        return;
      }
      const decoded = decodeBinary(new Uint8Array(message).buffer, key);
      if (decoded.kind === "key") {
        key = decoded;
        return;
      }
      if (decoded.kind === "topology") {
        rest = decoded.rest_m.slice();
        route.send(message);
        return;
      }
      rewritten += 1;
      const frame = encodeSnapshot({ header: decoded.header, positions_m: rest ?? decoded.positions_m });
      route.send(Buffer.from(frame));
    });
  });
  return { rewritten: () => rewritten };
}
