/** What the user chose, kept by the browser under one key. Storage that is broken, full or forbidden does no harm: then nothing is kept. */

import { DETAIL_CHOICES, type DetailChoice } from "./detail";
import { STEREO, type Stereo } from "./theatre/stereo";
import { CHARTS, type ChartKind } from "./chart_kinds";
import { FIELDS, type FieldKind } from "./inside/snapshot";
import { padsOf, pedalsOf, type PadMappings, type Pedals } from "./input_devices/mapping";

/** The number grows when what is kept is no longer understood. */
export const SETTINGS_KEY = "glisson.settings.1";
/** Surface, surface with edges, edges. */
const N_STYLES = 3;

export interface Settings {
  /** Which chart the plot shows. */
  readonly chart: ChartKind;
  /** What gamepads do, by what they call themselves, and keys that are foot pedals. */
  readonly pads: PadMappings;
  readonly pedals: Pedals;
  /** What bodies are coloured by. */
  readonly field: FieldKind;
  /** Null until one was chosen: the browser's. */
  readonly language: "en" | "fr" | null;
  /** Through the endoscope, in scenes that have one. */
  readonly theatre: boolean;
  /** Beside the endoscope's picture, that from outside. */
  readonly outside: boolean;
  /** Surface, surface with edges, edges. */
  readonly style: number;
  readonly contacts: boolean;
  readonly forces: boolean;
  readonly fixedNodes: boolean;
  readonly profiler: boolean;
  /** All measurements instead of the force alone; null until it was chosen: where there is room. */
  readonly panel: boolean | null;
  readonly plot: boolean;
  readonly detail: DetailChoice;
  readonly sound: boolean;
  /** Two pictures for two eyes, through the endoscope. */
  readonly stereo: Stereo;
}

export const USUAL: Settings = {
  language: null,
  theatre: false,
  outside: true,
  style: 0,
  contacts: false,
  forces: true,
  fixedNodes: false,
  profiler: false,
  panel: null,
  plot: true,
  chart: "force_time",
  field: "none",
  pads: {},
  pedals: {},
  detail: "auto",
  sound: false,
  stereo: "off",
};

export type Store = Pick<Storage, "getItem" | "setItem">;

/** The browser's storage; null where there is none, or it may not be used. */
export function browsersStore(): Store | null {
  try {
    return typeof window === "undefined" ? null : window.localStorage;
  } catch {
    return null;
  }
}

/** What of a kept text is understood; the rest is as usual. */
export function settingsOf(text: string | null): Settings {
  let kept: Record<string, unknown>;
  try {
    const value: unknown = JSON.parse(text ?? "");
    if (typeof value !== "object" || value === null) return USUAL;
    kept = value as Record<string, unknown>;
  } catch {
    return USUAL;
  }
  const flag = <T extends boolean | null>(name: keyof Settings, usual: T): boolean | T => {
    const found = kept[name];
    return typeof found === "boolean" ? found : usual;
  };
  const { language, style, detail, stereo } = kept;
  return {
    language: language === "en" || language === "fr" ? language : null,
    style: typeof style === "number" && Number.isInteger(style) && style >= 0 && style < N_STYLES ? style : USUAL.style,
    theatre: flag("theatre", USUAL.theatre),
    outside: flag("outside", USUAL.outside),
    contacts: flag("contacts", USUAL.contacts),
    forces: flag("forces", USUAL.forces),
    fixedNodes: flag("fixedNodes", USUAL.fixedNodes),
    profiler: flag("profiler", USUAL.profiler),
    panel: flag("panel", USUAL.panel),
    plot: flag("plot", USUAL.plot),
    chart: CHARTS.find((kind) => kind === kept.chart) ?? USUAL.chart,
    field: FIELDS.find((field) => field === kept.field) ?? USUAL.field,
    pads: padsOf(kept.pads),
    pedals: pedalsOf(kept.pedals),
    detail: DETAIL_CHOICES.find((choice) => choice === detail) ?? USUAL.detail,
    sound: flag("sound", USUAL.sound),
    stereo: STEREO.find((choice) => choice === stereo) ?? USUAL.stereo,
  };
}

/** What is kept now. */
export function readSettings(store: Store | null = browsersStore()): Settings {
  try {
    return settingsOf(store?.getItem(SETTINGS_KEY) ?? null);
  } catch {
    return USUAL;
  }
}

/** Keeps what changed beside what is kept, as far as there is a store; answers what holds now. */
export function keepSettings(changed: Partial<Settings>, store: Store | null = browsersStore()): Settings {
  const settings = { ...readSettings(store), ...changed };
  try {
    store?.setItem(SETTINGS_KEY, JSON.stringify(settings));
  } catch {
    // Full or forbidden: it holds for this page.
  }
  return settings;
}
