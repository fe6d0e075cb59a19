// Builds the page that has the simulation in itself, where `cargo xtask web` has compiled that.
import { existsSync, readdirSync, statSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "vite";

const at = (path) => fileURLToPath(new URL(path, import.meta.url));
const program = at("wasm/glisson.wasm");
/** The crates that it is made of. */
const CRATES = ["glisson-mesh", "glisson-tissue", "glisson", "glisson-runtime", "glisson-protocol", "glisson-web"];

/** A source that was changed after the program was compiled, if any. */
function newerSource() {
  const compiled_ms = statSync(program).mtimeMs;
  const sources = CRATES.flatMap((crate) => {
    const folder = at(`../crates/${crate}/src`);
    return readdirSync(folder, { recursive: true }).map((name) => join(folder, name));
  });
  return sources.find((source) => source.endsWith(".rs") && statSync(source).mtimeMs > compiled_ms);
}

if (existsSync(program)) {
  const newer = newerSource();
  if (newer !== undefined) console.warn(`wasm/glisson.wasm is older than ${newer}: \`cargo xtask web\` compiles it anew`);
  await build({ configFile: at("vite.local.config.ts") });
} else {
  console.log("without the page that has the simulation in itself: `cargo xtask web` compiles that");
}
