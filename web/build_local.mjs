// Builds the pages that have the simulation in themselves, where `cargo xtask web` has compiled that.
import { existsSync, readdirSync, statSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "vite";

const at = (path) => fileURLToPath(new URL(path, import.meta.url));
const program = at("wasm/glisson.wasm");
/** The crates that it is made of. */
const CRATES = ["mesh", "tissue", "runtime", "protocol", "picture", "patient", "web"].map((name) => `glisson-${name}`).concat("glisson");

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
  // The second has the first one in itself.
  for (const page of ["local", "local_patient"]) await build({ configFile: at(`vite.${page}.config.ts`) });
} else {
  console.log("without the pages that have the simulation in themselves: `cargo xtask web` compiles it");
}
