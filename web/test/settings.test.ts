import { describe, expect, it } from "vitest";
import { USUAL_PAD } from "../src/input_devices/mapping";
import { keepSettings, readSettings, SETTINGS_KEY, settingsOf, USUAL, type Settings, type Store } from "../src/settings";

class Kept implements Store {
  text: string | null = null;
  getItem(key: string): string | null {
    return key === SETTINGS_KEY ? this.text : null;
  }
  setItem(key: string, value: string): void {
    if (key === SETTINGS_KEY) this.text = value;
  }
}

const OTHER: Settings = {
  language: "fr",
  theatre: true,
  outside: false,
  style: 2,
  contacts: true,
  forces: false,
  fixedNodes: true,
  profiler: true,
  panel: false,
  plot: false,
  chart: "energy",
  field: "stress",
  pads: { "A pad": { ...USUAL_PAD, instrument: 1, deadZone: 0.3 } },
  pedals: { KeyB: { action: "trigger", instrument: 0, whileHeld: true } },
  detail: "low",
  sound: true,
  stereo: "anaglyph",
};

describe("what the user chose", () => {
  it("comes back, every part of it", () => {
    const store = new Kept();
    expect(readSettings(store)).toEqual(USUAL);
    expect(keepSettings(OTHER, store)).toEqual(OTHER);
    expect(readSettings(store)).toEqual(OTHER);
    for (const name of Object.keys(USUAL) as Array<keyof Settings>) expect(OTHER[name], name).not.toBe(USUAL[name]);
  });

  it("is kept beside what another page kept", () => {
    const store = new Kept();
    keepSettings({ language: "fr" }, store);
    keepSettings({ plot: false }, store);
    expect(readSettings(store)).toEqual({ ...USUAL, language: "fr", plot: false });
  });

  it.each(["", "{", "null", "7", '"text"', "[]", "[1]", "\u0000"])("%j is nothing that was kept", (text) => {
    expect(settingsOf(text)).toEqual(USUAL);
  });

  it("what of it is broken is as usual, and the rest stays", () => {
    const broken = { ...OTHER, language: "de", style: 3, contacts: "yes", panel: 1, unknown: true };
    const { language, style, contacts, panel } = USUAL;
    expect(settingsOf(JSON.stringify(broken))).toEqual({ ...OTHER, language, style, contacts, panel });
    for (const wrong of [-1, 0.5, null, "1"]) expect(settingsOf(JSON.stringify({ style: wrong })).style).toBe(0);
  });

  it("storage that throws does no harm, and what changed holds for the page", () => {
    const broken: Store = {
      getItem: () => {
        throw new Error("forbidden");
      },
      setItem: () => {
        throw new Error("full");
      },
    };
    expect(readSettings(broken)).toEqual(USUAL);
    expect(keepSettings({ plot: false }, broken)).toEqual({ ...USUAL, plot: false });
    expect(readSettings(null)).toEqual(USUAL);
    expect(keepSettings({ style: 1 }, null).style).toBe(1);
  });
});
