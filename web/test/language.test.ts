import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { describe, expect, it } from "vitest";
import { BINDINGS } from "../src/keys";
import { keysIn, languageOf, textIn } from "../src/language";
import { EN, type TextKey } from "../src/texts_en";
import { FR } from "../src/texts_fr";

const KEYS = Object.keys(EN) as TextKey[];
const values = (words: string): string[] => [...words.matchAll(/\{(\w+)\}/g)].map(([, name]) => name).sort();

describe("the language of a page", () => {
  it("is the one that was chosen, else the browser's, else English", () => {
    expect(languageOf("fr", ["en-GB"])).toBe("fr");
    expect(languageOf("en", ["fr"])).toBe("en");
    expect(languageOf(null, ["fr-CA", "en"])).toBe("fr");
    expect(languageOf(null, ["de-DE", "FR", "en"])).toBe("fr");
    expect(languageOf(null, ["de", "toString"])).toBe("en");
    expect(languageOf(null, [])).toBe("en");
  });

  it("puts values in, whatever they are, and leaves what has none", () => {
    expect(textIn("en", "task_time", { time: "1:00", limit: "{time}" })).toBe("1:00 of {time}");
    expect(textIn("fr", "value_of", { n: 1, m: 2, name: "$& pince" })).toBe("1 sur 2 : $& pince");
    expect(textIn("en", "task_time", { time: "1:00" })).toBe("1:00 of {limit}");
  });

  it("keys are called as on its keyboards", () => {
    expect(keysIn("en", "Shift R")).toBe("Shift R");
    expect(keysIn("fr", "Shift R")).toBe("Maj R");
    expect(keysIn("fr", "R or Backspace")).toBe("R ou Retour arrière");
    expect(keysIn("fr", "Space")).toBe("Espace");
  });
});

describe("the tables", () => {
  it.each(KEYS)("%s says the same in both", (key) => {
    expect(FR[key].trim(), key).not.toBe("");
    expect(values(FR[key])).toEqual(values(EN[key]));
  });

  it("French has its spaces before what has two parts", () => {
    for (const key of KEYS) expect(FR[key], key).not.toMatch(/[^\s:][;?!](\s|$)|[^\s\d:][:](\s|$)/);
  });

  it("every key of the keyboard has words", () => {
    for (const { action, does, group } of BINDINGS) expect(does.length > 0 && group.length > 0, action).toBe(true);
  });

  it("the fixed parts of the pages ask for texts that there are", () => {
    for (const page of ["index.html", "start.html", "patient.html", "replay.html"]) {
      const html = readFileSync(fileURLToPath(new URL(`../${page}`, import.meta.url)), "utf8");
      const asked = [...html.matchAll(/data-(?:text|label)="(\w+)"/g)].map(([, key]) => key);
      expect(asked.length).toBeGreaterThan(5);
      for (const key of asked) expect(KEYS, `${page}: ${key}`).toContain(key);
    }
  });
});
