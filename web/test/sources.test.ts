import { readdirSync, readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { expect, it } from "vitest";

const root = fileURLToPath(new URL("..", import.meta.url));

it.each(["src", "e2e"])("files in %s stay under 400 lines", (folder) => {
  for (const name of readdirSync(`${root}/${folder}`)) {
    const lines = readFileSync(`${root}/${folder}/${name}`, "utf8").split("\n").length;
    expect(lines, name).toBeLessThan(400);
  }
});

it("the lock file names no place to download from", () => {
  expect(readFileSync(`${root}/package-lock.json`, "utf8")).not.toContain('"resolved"');
});

it("the page loads nothing from elsewhere", () => {
  const texts = readdirSync(`${root}/src`).map((name) => readFileSync(`${root}/src/${name}`, "utf8"));
  texts.push(readFileSync(`${root}/index.html`, "utf8").replace("http://www.w3.org/2000/svg", ""));
  for (const text of texts) expect(text).not.toMatch(/https?:\/\/(?!127\.0\.0\.1)/);
});
