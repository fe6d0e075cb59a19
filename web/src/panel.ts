/** The panel of numbers: what each shows is a pure function of the hello message and the newest snapshot. */
import type { Bleeding } from "./blood";
import { drawJitter } from "./jitter";
import { text } from "./language";
import type { Hello, HandHeader, Vec3 } from "./protocol";
import { handOf, type Feel } from "./feel";
import { hapticsText, jitterText, tickText, whereHapticsAre, type HapticTiming, type LoopNews, type Timing } from "./timing";

export type PanelKey =
  | "scene"
  | "force"
  | "force_components"
  | "force_peak"
  | "hand_force"
  | "instrument"
  | "contact"
  | "contact_point"
  | "tip"
  | "state"
  | "rate"
  | "real_time_factor"
  | "step"
  | "time"
  | "control"
  | "haptics"
  | "haptic_tick"
  | "haptic_jitter"
  | "model"
  | "material"
  | "mesh"
  | "arrow_scale"
  | "bleeding"
  | "blood_lost";

export type PanelValues = Record<PanelKey, string>;

const NONE = "–";
/** A real minus is as wide as a digit. */
const minus = (text: string): string => text.replace("-", "−");

/** To three figures, without an exponent, as long as it is less than a thousand: 123, 12.3, 1.23, 0.123, 0.0123. */
function threeFigures(size: number): string {
  const before = Math.floor(Math.log10(Number(size.toPrecision(3))));
  return size.toFixed(Math.max(0, 2 - before));
}

/** A force with its unit, to three figures: 123 N, 12.3 N, 1.23 N, 0.0512 N, 1.23 mN, 4.56 µN; what is less than a millionth is none. */
export function forceText(force_n: number): string {
  const size_n = Math.abs(force_n);
  if (size_n < 1e-6) return "0 N";
  if (size_n >= 0.01) return `${threeFigures(size_n)} N`;
  return size_n >= 1e-3 ? `${threeFigures(1e3 * size_n)} mN` : `${threeFigures(1e6 * size_n)} µN`;
}

/** Millilitres, or those of a minute: hundredths of little, whole ones of much. */
function volumeText(ml: number): string {
  return ml.toFixed(ml < 10 ? 2 : ml < 100 ? 1 : 0);
}

export function lengthOf(v: Vec3): number {
  return Math.hypot(v[0], v[1], v[2]);
}

/** A point in millimetres, one decimal: `12.3  -4.0  105.2`. */
export function pointText_mm(point_m: Vec3): string {
  return minus3(point_m.map((x) => (1000 * x).toFixed(1)));
}

function minus3(parts: string[]): string {
  return parts.map((p) => minus(p === "-0.0" || p === "-0.00" ? p.slice(1) : p)).join("   ");
}

const grouped = new Intl.NumberFormat("en-GB", { maximumFractionDigits: 0 });

/** Which instrument the hand holds and what it does: `2 of 2: grasper, holds 6 nodes`. */
function instrumentText(hello: Hello, header: HandHeader, tool: number): string {
  const { length } = hello.tools;
  const name = hello.tools[tool]?.name ?? NONE;
  const parts = [length > 1 ? text("value_of", { n: tool + 1, m: length, name }) : name];
  if (header.grasps) parts.push(text("value_holds", { n: header.heldNodes }));
  if (header.trigger > 0.5) parts.push(text("value_on"));
  return parts.join(", ");
}

/** Blood that comes out now: `12.3 ml/min from 2`. */
function bleedingText(bleeding: Bleeding): string {
  const rate = volumeText(60e6 * bleeding.rate_m3_per_s);
  const parts = [bleeding.ends.length === 0 ? text("value_none") : text("value_from", { rate, n: bleeding.ends.length })];
  if (bleeding.clips > 0) parts.push(text("value_clips", { n: bleeding.clips }));
  return parts.join(", ");
}

/** What the hand would feel: `1.20 N`; a dash where the page is no device. */
function handText(feel: Feel | null, tool: number): string {
  const hand = handOf(feel, tool);
  if (hand === null) return NONE;
  return hand.is_held ? forceText(lengthOf(hand.force_n)) : text("value_let_go");
}

/** `0.98 ×`, and in slow motion that it is. */
function factorText(factor: number, timing: Pick<Timing, "speed"> | null): string {
  const shown = factor.toFixed(2);
  return timing !== null && timing.speed < 1 ? text("value_slow", { factor: shown }) : `${shown} ×`;
}

export function panelValues(
  hello: Hello | null,
  header: HandHeader | null,
  peak_n: number,
  arrowScale_m_per_n: number,
  tool: number,
  news: Pick<LoopNews, "role" | "timing" | "feel" | "parameters"> = { role: null, timing: null, feel: null, parameters: null },
): PanelValues {
  const { role, timing, feel, parameters } = news;
  const scene = hello?.scene;
  const force = header === null ? null : lengthOf(header.forceOnTool_n);
  return {
    scene: scene?.name ?? NONE,
    force: force === null ? NONE : forceText(force),
    force_components: header === null ? NONE : minus3(header.forceOnTool_n.map((x) => x.toFixed(2))),
    force_peak: header === null ? NONE : forceText(peak_n),
    hand_force: handText(feel, tool),
    instrument: header === null || hello === null ? NONE : instrumentText(hello, header, tool),
    contact: header === null ? NONE : text(header.contact ? "value_yes" : "value_no"),
    contact_point: header?.contact ? pointText_mm(header.contactPoint_m) : NONE,
    tip: header === null ? NONE : pointText_mm(header.tip_m),
    state: text(header === null ? "value_waiting" : header.paused ? "value_paused" : "value_running"),
    rate: header === null ? NONE : text("value_rate", { n: grouped.format(header.rate_steps_per_s) }),
    real_time_factor: header === null ? NONE : factorText(header.realTimeFactor, timing),
    step: header === null ? NONE : grouped.format(header.step),
    time: header === null ? NONE : `${header.time_s.toFixed(2)} s`,
    control: role === null ? NONE : text(role.role === "controller" ? "value_this_page" : role.control_is_taken ? "value_another" : "value_free"),
    haptics: timing?.haptics ? hapticsText(timing.haptics) : (whereHapticsAre(timing) ?? NONE),
    haptic_jitter: timing?.haptics ? jitterText(timing.haptics) : NONE,
    haptic_tick: timing?.haptics ? tickText(timing.haptics) : NONE,
    model: scene?.model ?? NONE,
    material: parameters?.material ?? scene?.material ?? NONE,
    mesh: scene === undefined ? NONE : `${grouped.format(scene.n_nodes)} / ${grouped.format(scene.n_tetrahedra)}`,
    bleeding: header?.bleeding ? bleedingText(header.bleeding) : NONE,
    blood_lost: header?.bleeding ? `${volumeText(1e6 * header.bleeding.lost_m3)} ml` : NONE,
    arrow_scale: `${Number((1000 * arrowScale_m_per_n).toPrecision(3))} mm / N`,
  };
}

type RowKey = Exclude<PanelKey, "scene" | "force" | "force_components" | "force_peak" | "hand_force" | "arrow_scale">;

const INSTRUMENT_ROWS: readonly RowKey[] = ["instrument", "contact", "contact_point", "tip", "bleeding", "blood_lost"];
const SIMULATION_ROWS: readonly RowKey[] = ["state", "rate", "real_time_factor", "step", "time", "control"];
const HAPTICS_ROWS: readonly RowKey[] = ["haptics", "haptic_jitter", "haptic_tick"];
const MODEL_ROWS: readonly RowKey[] = ["model", "material", "mesh"];

/** Not every scene and server has them. */
const OPTIONAL: ReadonlySet<PanelKey> = new Set(["hand_force", "bleeding", "blood_lost", "haptic_jitter", "haptic_tick"]);

/** What a recording does not have. */
const LIVE: ReadonlySet<PanelKey> = new Set(["rate", "real_time_factor", "control"]);

function element<K extends keyof HTMLElementTagNameMap>(name: K, className: string, words = ""): HTMLElementTagNameMap[K] {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = words;
  return node;
}

export class Panel {
  readonly plot: HTMLCanvasElement;
  readonly plotLegend: HTMLElement;
  /** Histogram of the haptic loop's jitter; hidden where no loop tells its times. */
  private readonly jitter: HTMLCanvasElement;
  private shownTiming: HapticTiming | null = null;
  private readonly cells = new Map<PanelKey, HTMLElement>();
  /** Lines that are there only while they say something. */
  private readonly optional = new Map<PanelKey, HTMLElement>();
  private shown: PanelValues | null = null;

  /** Without `isLive`, what only a running simulation has is left out. */
  constructor(private readonly root: HTMLElement, isLive = true) {
    const force = element("section", "force");
    force.append(element("h2", "", text("force_title")));
    force.append(this.cell("force", "force-number"));
    const parts = element("div", "force-parts");
    parts.title = text("force_components_about");
    parts.append(element("span", "label", "L  P  S"), this.cell("force_components", "value"));
    const peak = element("div", "force-parts");
    peak.append(element("span", "label", text("force_peak")), this.cell("force_peak", "value"));
    const arrow = element("div", "force-parts");
    arrow.title = text("arrow_scale_about");
    arrow.append(element("span", "label", text("arrow_scale")), this.cell("arrow_scale", "value"));
    this.plot = element("canvas", "plot");
    this.plot.setAttribute("role", "img");
    this.plot.setAttribute("aria-label", text("chart_force_time_about"));
    this.plotLegend = element("div", "plot-legend", text("chart_force"));
    const hand = element("div", "force-parts");
    hand.title = text("hand_force_about");
    hand.append(element("span", "label", text("hand_force")), this.cell("hand_force", "value"));
    this.optional.set("hand_force", hand);
    force.append(parts, peak, hand, arrow, this.plot, this.plotLegend);
    const haptics = isLive ? this.section("haptics", HAPTICS_ROWS) : element("section", "");
    this.jitter = element("canvas", "jitter");
    this.jitter.setAttribute("aria-label", text("jitter_label"));
    this.jitter.title = text("jitter_about");
    haptics.append(this.jitter);
    root.append(
      this.cell("scene", "scene-name"),
      force,
      this.section("instrument", INSTRUMENT_ROWS),
      this.section("simulation", SIMULATION_ROWS.filter((key) => isLive || !LIVE.has(key))),
      ...(isLive ? [haptics] : []),
      this.section("model", MODEL_ROWS),
    );
  }

  private cell(key: PanelKey, className: string): HTMLElement {
    const cell = element("div", className, NONE);
    cell.dataset.value = key;
    this.cells.set(key, cell);
    return cell;
  }

  private section(title: "haptics" | "instrument" | "simulation" | "model", rows: readonly RowKey[]): HTMLElement {
    const section = element("section", "");
    section.append(element("h2", "", text(`section_${title}`)));
    for (const key of rows) {
      const line = element("div", "row");
      line.title = text(`about_${key}`);
      line.append(element("span", "label", text(`row_${key}`)), this.cell(key, "value"));
      if (OPTIONAL.has(key)) this.optional.set(key, line);
      section.append(line);
    }
    return section;
  }

  /** `speed`: simulated seconds in a second that were asked for. */
  show(values: PanelValues, header: HandHeader | null, speed = 1): void {
    for (const [key, cell] of this.cells) {
      if (this.shown?.[key] !== values[key]) cell.textContent = values[key];
    }
    for (const [key, line] of this.optional) line.hidden = values[key] === NONE;
    this.shown = values;
    this.root.classList.toggle("in-contact", header?.contact ?? false);
    this.root.classList.toggle("is-paused", header?.paused ?? false);
    this.root.classList.toggle("is-slow", header !== null && !header.paused && header.realTimeFactor < 0.95 * speed);
  }

  /** Draws the haptic loop's histogram when there is news. */
  showJitter(haptics: HapticTiming | null): void {
    this.jitter.hidden = haptics === null;
    if (haptics !== this.shownTiming) drawJitter(this.jitter, haptics);
    this.shownTiming = haptics;
  }

  /** What the page shows now, read back from the page. */
  values(): PanelValues {
    const entries = Array.from(this.cells, ([key, cell]) => [key, cell.textContent ?? ""] as const);
    return Object.fromEntries(entries) as PanelValues;
  }
}
