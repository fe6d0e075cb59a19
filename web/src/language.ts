/**
 * The language of a page: the one that was chosen, else the first of the browser's that there is. It is decided when the page is loaded;
 * a choice loads the page anew.
 */
import { keepSettings, readSettings } from "./settings";
import { EN, type TextKey } from "./texts_en";
import { FR } from "./texts_fr";

const TABLES = { en: EN, fr: FR } as const;
export type Language = keyof typeof TABLES;
/** Each in its own words. */
export const LANGUAGES: ReadonlyArray<readonly [Language, string]> = [["en", "English"], ["fr", "Français"]];

const isLanguage = (name: string): name is Language => name in TABLES;

/** What was chosen, else the first of `wanted` (such as `fr-CA`) that there is, else English. */
export function languageOf(chosen: Language | null, wanted: readonly string[]): Language {
  return chosen ?? wanted.map((name) => name.toLowerCase().split("-")[0]).find(isLanguage) ?? "en";
}

/** A text with its values: `{name}` is replaced. */
export function textIn(language: Language, key: TextKey, values: Readonly<Record<string, string | number>> = {}): string {
  return TABLES[language][key].replace(/\{(\w+)\}/g, (whole, name: string) => String(values[name] ?? whole));
}

const NAMES_OF_KEYS: ReadonlyArray<readonly [RegExp, string]> = [
  [/\bShift\b/g, "Maj"],
  [/\bSpace\b/g, "Espace"],
  [/\bBackspace\b/g, "Retour arrière"],
  [/\bPage Up\b/g, "Page préc."],
  [/\bPage Down\b/g, "Page suiv."],
  [/\bHome\b/g, "Origine"],
  [/\bEnd\b/g, "Fin"],
  [/\bEsc\b/g, "Échap"],
  [/ or /g, " ou "],
];

/** The keys of a binding as keyboards of the language name them. */
export function keysIn(language: Language, keys: string): string {
  if (language === "en") return keys;
  return NAMES_OF_KEYS.reduce((text, [english, own]) => text.replace(english, own), keys);
}

function languageOfPage(): Language {
  if (typeof document === "undefined") return "en";
  return languageOf(readSettings().language, navigator.languages);
}

/** The language of this page. */
export const LANGUAGE: Language = languageOfPage();

/** A text in the language of this page. */
export function text(key: TextKey, values?: Readonly<Record<string, string | number>>): string {
  return textIn(LANGUAGE, key, values);
}

/** Puts the texts into the fixed parts of the page: `data-text` is what they say, `data-label` what a screen reader calls them. */
export function translatePage(root: Document = document): void {
  root.documentElement.lang = LANGUAGE;
  for (const node of root.querySelectorAll<HTMLElement>("[data-text]")) node.textContent = text(node.dataset.text as TextKey);
  for (const node of root.querySelectorAll<HTMLElement>("[data-label]")) node.setAttribute("aria-label", text(node.dataset.label as TextKey));
}

/** A choice of the language, which loads the page anew. */
export function languageChoice(reload: () => void = () => window.location.reload()): HTMLElement {
  const label = document.createElement("label");
  label.className = "language";
  const select = document.createElement("select");
  for (const [name, own] of LANGUAGES) select.append(new Option(own, name, false, name === LANGUAGE));
  select.addEventListener("change", () => {
    keepSettings({ language: select.value as Language });
    reload();
  });
  label.append(text("language"), select);
  return label;
}
