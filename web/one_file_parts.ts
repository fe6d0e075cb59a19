import { readFileSync } from "node:fs";
import { gzipSync } from "node:zlib";
import type { Plugin } from "vite";

/** The program, as `cargo xtask web` builds it. */
const PROGRAM = new URL("wasm/glisson.wasm", import.meta.url);

/** Of a package that the viewer's own build does not bundle. */
export const WASI_LICENSE = new URL("node_modules/@bjorn3/browser_wasi_shim/LICENSE-MIT", import.meta.url);

export const packed = (bytes: Uint8Array | string): string => gzipSync(bytes, { level: 9 }).toString("base64");

export const packedProgram = (): string => packed(readFileSync(PROGRAM));

const element = (id: string, letters: string): string => `<script id="${id}" type="application/octet-stream">${letters}</script>\n    `;

/** Runs `entry` in the place of a page's own script, with parts in front of it by the names of their elements. */
export function withParts(own: string, entry: string, parts: () => Readonly<Record<string, string>>): Plugin {
  return {
    name: "with-parts",
    transformIndexHtml: {
      order: "pre",
      handler(html) {
        const [before, after] = html.split(`<script type="module" src="${own}">`);
        if (after === undefined) throw new Error(`the page does not use ${own}`);
        const elements = Object.entries(parts()).map(([id, letters]) => element(id, letters));
        return `${before}${elements.join("")}<script type="module" src="${entry}">${after}`;
      },
    },
  };
}

/** A page without what is in one of its parts. */
export function without(page: string, id: string): string {
  const [begin, end] = element(id, "\n").split("\n") as [string, string];
  const from = page.indexOf(begin) + begin.length;
  const to = page.indexOf(end, from);
  if (from < begin.length || to < 0) throw new Error(`the page has no part ${id}`);
  return page.slice(0, from) + page.slice(to);
}
