// Builds the page that has the simulation in itself, where `cargo xtask web` has compiled that.
import { existsSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { build } from "vite";

if (existsSync(new URL("wasm/glisson.wasm", import.meta.url))) {
  await build({ configFile: fileURLToPath(new URL("vite.local.config.ts", import.meta.url)) });
} else {
  console.log("without the page that has the simulation in itself: `cargo xtask web` compiles that");
}
