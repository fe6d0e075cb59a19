import { readdirSync, readFileSync, statSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { expect, it } from "vitest";

const root = fileURLToPath(new URL("..", import.meta.url));

/** Names of the files in a folder and in those below it. */
function filesIn(folder: string): string[] {
  const entries = readdirSync(`${root}/${folder}`, { recursive: true }) as string[];
  return entries.filter((name) => statSync(`${root}/${folder}/${name}`).isFile());
}

it.each(["src", "e2e"])("files in %s stay under 400 lines", (folder) => {
  for (const name of filesIn(folder)) {
    const lines = readFileSync(`${root}/${folder}/${name}`, "utf8").split("\n").length;
    expect(lines, name).toBeLessThan(400);
  }
});

it("the lock file names no place to download from", () => {
  expect(readFileSync(`${root}/package-lock.json`, "utf8")).not.toContain('"resolved"');
});

it("the page loads nothing from elsewhere", () => {
  const paths = [...filesIn("src").map((name) => `src/${name}`), "index.html", "patient.html", "replay.html", "start.html"];
  // The name of a kind of element, which is not loaded.
  const texts = paths.map((path) => readFileSync(`${root}/${path}`, "utf8").replace("http://www.w3.org/2000/svg", ""));
  for (const text of texts) expect(text).not.toMatch(/https?:\/\/(?!127\.0\.0\.1)/);
});
