/** The panel of numbers: what each shows is a pure function of the hello message and the newest snapshot. */
import type { Bleeding } from "./blood";
import { drawJitter } from "./jitter";
import type { Hello, HandHeader, Vec3 } from "./protocol";
import { handOf, type Feel } from "./feel";
import { hapticsText, jitterText, tickText, whereHapticsAre, type HapticTiming, type LoopNews } from "./timing";

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

/** A force with its unit, to three figures or more: 12.34 N, 0.0512 N, 1.23 mN, 4.56 µN; what is less than a millionth is none. */
export function forceText(force_n: number): string {
  const size_n = Math.abs(force_n);
  if (size_n >= 100) return `${force_n.toFixed(1)} N`;
  if (size_n >= 10) return `${force_n.toFixed(2)} N`;
  if (size_n >= 0.1 || size_n < 1e-6) return `${force_n.toFixed(3)} N`;
  if (size_n >= 0.01) return `${force_n.toFixed(4)} N`;
  return size_n >= 1e-3 ? `${(1e3 * force_n).toFixed(2)} mN` : `${Number((1e6 * force_n).toPrecision(3))} µN`;
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
  const place = length > 1 ? `${tool + 1} of ${length}: ` : "";
  const hold = header.grasps ? `, holds ${header.heldNodes} nodes` : "";
  return `${place}${name}${hold}${header.trigger > 0.5 ? ", on" : ""}`;
}

/** Blood that comes out now: `12.3 ml/min from 2`. */
function bleedingText(bleeding: Bleeding): string {
  if (bleeding.ends.length === 0) return bleeding.clips > 0 ? `none, ${bleeding.clips} clips` : "none";
  const clips = bleeding.clips > 0 ? `, ${bleeding.clips} clips` : "";
  return `${(60e6 * bleeding.rate_m3_per_s).toFixed(1)} ml/min from ${bleeding.ends.length}${clips}`;
}

/** What the hand would feel: `1.20 N`; a dash where the page is no device. */
function handText(feel: Feel | null, tool: number): string {
  const hand = handOf(feel, tool);
  if (hand === null) return NONE;
  return hand.is_held ? forceText(lengthOf(hand.force_n)) : "let go";
}

export function panelValues(
  hello: Hello | null,
  header: HandHeader | null,
  peak_n: number,
  arrowScale_m_per_n: number,
  tool: number,
  news: Pick<LoopNews, "role" | "timing" | "feel"> = { role: null, timing: null, feel: null },
): PanelValues {
  const { role, timing, feel } = news;
  const scene = hello?.scene;
  const force = header === null ? null : lengthOf(header.forceOnTool_n);
  return {
    scene: scene?.name ?? NONE,
    force: force === null ? NONE : forceText(force),
    force_components: header === null ? NONE : minus3(header.forceOnTool_n.map((x) => x.toFixed(2))),
    force_peak: header === null ? NONE : forceText(peak_n),
    hand_force: handText(feel, tool),
    instrument: header === null || hello === null ? NONE : instrumentText(hello, header, tool),
    contact: header === null ? NONE : header.contact ? "yes" : "no",
    contact_point: header?.contact ? pointText_mm(header.contactPoint_m) : NONE,
    tip: header === null ? NONE : pointText_mm(header.tip_m),
    state: header === null ? "waiting" : header.paused ? "paused" : "running",
    rate: header === null ? NONE : `${grouped.format(header.rate_steps_per_s)} steps/s`,
    real_time_factor: header === null ? NONE : `${header.realTimeFactor.toFixed(2)} ×`,
    step: header === null ? NONE : grouped.format(header.step),
    time: header === null ? NONE : `${header.time_s.toFixed(3)} s`,
    control: role === null ? NONE : role.role === "controller" ? "this page" : role.control_is_taken ? "another" : "free",
    haptics: timing?.haptics ? hapticsText(timing.haptics) : (whereHapticsAre(timing) ?? NONE),
    haptic_jitter: timing?.haptics ? jitterText(timing.haptics) : NONE,
    haptic_tick: timing?.haptics ? tickText(timing.haptics) : NONE,
    model: scene?.model ?? NONE,
    material: scene?.material ?? NONE,
    mesh: scene === undefined ? NONE : `${grouped.format(scene.n_nodes)} / ${grouped.format(scene.n_tetrahedra)}`,
    bleeding: header?.bleeding ? bleedingText(header.bleeding) : NONE,
    blood_lost: header?.bleeding ? `${(1e6 * header.bleeding.lost_m3).toFixed(1)} ml` : NONE,
    arrow_scale: `${Number((1000 * arrowScale_m_per_n).toPrecision(3))} mm / N`,
  };
}

interface Row {
  readonly key: PanelKey;
  readonly label: string;
  readonly title: string;
}

const row = (key: PanelKey, label: string, title: string): Row => ({ key, label, title });

const INSTRUMENT_ROWS: readonly Row[] = [
  row("instrument", "In the hand", "Keys 1 to 4 choose; B closes the jaws, V switches on"),
  row("contact", "Contact", "Whether the tip touches the organ"),
  row("contact_point", "at (mm)", "Contact point in the patient frame: left, posterior, superior"),
  row("tip", "Tip (mm)", "Centre of the tip in the patient frame: left, posterior, superior"),
  row("bleeding", "Bleeding", "Blood from open vessels now (scenes with vessels); A sets a clip"),
  row("blood_lost", "Blood lost", "Blood lost so far"),
];
const SIMULATION_ROWS: readonly Row[] = [
  row("state", "State", "Running or paused"),
  row("rate", "Rate", "Steps that the simulation computes in a second, measured"),
  row("real_time_factor", "Real time", "Simulated seconds in a second: 1 is real time"),
  row("step", "Step", "Steps since the start"),
  row("time", "Time", "Simulated time since the start"),
  row("control", "Control", "Who moves the instruments: one page; the others watch, and take over when it is free"),
];
const HAPTICS_ROWS: readonly Row[] = [
  row("haptics", "Loop", "Rate of the force-feedback loop and deadlines that it missed by more than two periods (more: key P)"),
  row("haptic_jitter", "Jitter", "By how much the intervals between two ticks are off: half of them, and 99.9 %"),
  row("haptic_tick", "A tick", "Time that a tick of the force-feedback loop takes, of the time from one to the next"),
];
const MODEL_ROWS: readonly Row[] = [
  row("model", "Model", "How the deformation is computed"),
  row("material", "Material", "Law and parameters of the tissue"),
  row("mesh", "Nodes / tets", "Size of the whole mesh; the surface alone is displayed"),
];

/** Not every scene and server has them. */
const OPTIONAL: ReadonlySet<PanelKey> = new Set(["hand_force", "bleeding", "blood_lost", "haptic_jitter", "haptic_tick"]);

/** What a recording does not have. */
const LIVE: ReadonlySet<PanelKey> = new Set(["rate", "real_time_factor", "control"]);

function element<K extends keyof HTMLElementTagNameMap>(name: K, className: string, text = ""): HTMLElementTagNameMap[K] {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = text;
  return node;
}

export class Panel {
  readonly plot: HTMLCanvasElement;
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
    force.append(element("h2", "", "Force on the instrument"));
    force.append(this.cell("force", "force-number"));
    const parts = element("div", "force-parts");
    parts.title = "Components along left, posterior and superior";
    parts.append(element("span", "label", "L  P  S"), this.cell("force_components", "value"));
    const peak = element("div", "force-parts");
    peak.append(element("span", "label", "Largest"), this.cell("force_peak", "value"));
    const arrow = element("div", "force-parts");
    arrow.title = "Length of the orange arrow for one newton";
    arrow.append(element("span", "label", "Arrow"), this.cell("arrow_scale", "value"));
    this.plot = element("canvas", "plot");
    this.plot.setAttribute("aria-label", "Force over the last ten simulated seconds");
    const legend = element("div", "plot-legend", "force (N) over simulated time");
    const hand = element("div", "force-parts");
    hand.title = "Force that the haptic loop gives to the hand, where the page is a device (--device viewer)";
    hand.append(element("span", "label", "Hand"), this.cell("hand_force", "value"));
    this.optional.set("hand_force", hand);
    force.append(parts, peak, hand, arrow, this.plot, legend);
    const haptics = isLive ? this.section("Haptics", HAPTICS_ROWS) : element("section", "");
    this.jitter = element("canvas", "jitter");
    this.jitter.setAttribute("aria-label", "How many intervals of the haptic loop are off by how much");
    this.jitter.title = "How many intervals are off by how much, both logarithmic; beyond the red line deadlines are missed";
    haptics.append(this.jitter);
    root.append(
      this.cell("scene", "scene-name"),
      force,
      this.section("Instrument", INSTRUMENT_ROWS),
      this.section("Simulation", SIMULATION_ROWS.filter(({ key }) => isLive || !LIVE.has(key))),
      ...(isLive ? [haptics] : []),
      this.section("Model", MODEL_ROWS),
    );
  }

  private cell(key: PanelKey, className: string): HTMLElement {
    const cell = element("div", className, NONE);
    cell.dataset.value = key;
    this.cells.set(key, cell);
    return cell;
  }

  private section(title: string, rows: readonly Row[]): HTMLElement {
    const section = element("section", "");
    section.append(element("h2", "", title));
    for (const { key, label, title: tip } of rows) {
      const line = element("div", "row");
      line.title = tip;
      line.append(element("span", "label", label), this.cell(key, "value"));
      if (OPTIONAL.has(key)) this.optional.set(key, line);
      section.append(line);
    }
    return section;
  }

  show(values: PanelValues, header: HandHeader | null): void {
    for (const [key, cell] of this.cells) {
      if (this.shown?.[key] !== values[key]) cell.textContent = values[key];
    }
    for (const [key, line] of this.optional) line.hidden = values[key] === NONE;
    this.shown = values;
    this.root.classList.toggle("in-contact", header?.contact ?? false);
    this.root.classList.toggle("is-paused", header?.paused ?? false);
    this.root.classList.toggle("is-slow", header !== null && !header.paused && header.realTimeFactor < 0.95);
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
