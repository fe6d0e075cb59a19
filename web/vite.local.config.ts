import { readFileSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { defineConfig, type Plugin } from "vite";
import { buildOf, inOneFile } from "./one_file.ts";

/** The simulation's program, as `cargo xtask web` builds it. */
const PROGRAM = new URL("wasm/glisson.wasm", import.meta.url);

const WASI_LICENSE = new URL("node_modules/@bjorn3/browser_wasi_shim/LICENSE-MIT", import.meta.url);

/** The viewer's page with a simulation in itself instead of a connection to one. */
function withSimulation(): Plugin {
  return {
    name: "with-simulation",
    transformIndexHtml: {
      order: "pre",
      handler(html) {
        const program = gzipSync(readFileSync(PROGRAM), { level: 9 }).toString("base64");
        const parts = `<script id="scene-files" type="application/octet-stream"></script>
    <script id="program" type="application/octet-stream">${program}</script>
    `;
        const [before, after] = html.split('<script type="module" src="/src/main.ts">');
        if (after === undefined) throw new Error("index.html does not use src/main.ts");
        return `${before}${parts}<script type="module" src="/src/local/main.ts">${after}`;
      },
    },
  };
}

/** The simulator in one file, which `glisson export` puts a scene into. Built after the other pages, beside them. */
export default defineConfig({
  base: "./",
  plugins: [withSimulation(), inOneFile("local.html", [WASI_LICENSE])],
  // Browsers start no Worker that is a module from a file on disk.
  worker: { format: "iife" },
  build: buildOf("index.html"),
});
