// Puts a finished build from dist.new in the place of dist, unless both are the same: what embeds dist is then not built anew.
import { existsSync, readFileSync, readdirSync, renameSync, rmSync, statSync } from "node:fs";
import { join } from "node:path";

const [fresh, placed] = ["dist.new", "dist"].map((name) => join(import.meta.dirname, name));

function files(folder) {
  return readdirSync(folder, { recursive: true }).filter((name) => statSync(join(folder, name)).isFile()).sort();
}

function areSame() {
  if (!existsSync(placed)) return false;
  const [a, b] = [files(fresh), files(placed)];
  return a.join("\n") === b.join("\n") &&
    a.every((name) => readFileSync(join(fresh, name)).equals(readFileSync(join(placed, name))));
}

if (areSame()) {
  rmSync(fresh, { recursive: true });
} else {
  rmSync(placed, { recursive: true, force: true });
  renameSync(fresh, placed);
}
