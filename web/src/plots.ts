/** The plot in the panel: which chart it shows, the list to choose from, and the button that saves its numbers. */
import { CHARTS, type ChartKind } from "./chart_kinds";
import { ChartHistory, drawChart } from "./charts";
import { text } from "./language";
import { download } from "./download";
import { lengthOf, type Panel } from "./panel";
import { arrowScale_m_per_n, ForceHistory } from "./plot";
import { headerOfHand, type SnapshotHeader } from "./protocol";
import { keepSettings, readSettings } from "./settings";
import type { Timing } from "./timing";

export class Plots {
  readonly force = new ForceHistory();
  private readonly charts = new ChartHistory();
  private readonly choice = document.createElement("select");
  private readonly legend = document.createElement("span");
  private shownTiming: Timing | null = null;
  private kind: ChartKind;

  constructor(private readonly panel: Panel) {
    this.kind = readSettings().chart;
    for (const kind of CHARTS) this.choice.append(new Option(text(`chart_${kind}`), kind));
    this.choice.className = "plot-choice";
    this.choice.setAttribute("aria-label", text("chart_choice"));
    this.choice.addEventListener("change", () => this.choose(this.choice.value as ChartKind));
    const save = document.createElement("button");
    save.type = "button";
    save.className = "panel-switch plot-save";
    save.textContent = "CSV";
    save.title = text("chart_save");
    save.setAttribute("aria-label", save.title);
    save.addEventListener("click", (event) => {
      this.save();
      if (event.detail > 0) save.blur();
    });
    panel.plotLegend.replaceChildren(this.choice, save);
    panel.plot.after(this.legend);
    this.legend.className = "plot-lines";
    this.choose(this.kind);
  }

  get arrowScale_m_per_n(): number {
    return arrowScale_m_per_n(this.force.peak_n);
  }

  /** Whether what is plotted comes from inside the bodies. */
  get looksInside(): boolean {
    return this.kind === "energy" && !this.panel.plot.hidden;
  }

  /** A snapshot of the first organ, as the hand with this instrument sees it. */
  add(snapshot: SnapshotHeader, tool: number): void {
    const { organ, time_s, forceOnTool_n, tip_m, contact } = headerOfHand(snapshot, tool);
    if (organ !== 0) return;
    const force_n = lengthOf(forceOnTool_n);
    this.force.add({ time_s, force_n });
    this.charts.add({ time_s, force_n, tip_m, contact, energies_j: snapshot.inside?.energies_j ?? null });
  }

  clear(): void {
    this.force.clear();
    this.charts.clear();
  }

  /** The next chart. */
  next(): void {
    this.choose(CHARTS[(CHARTS.indexOf(this.kind) + 1) % CHARTS.length]);
  }

  private choose(kind: ChartKind): void {
    this.kind = kind;
    this.choice.value = kind;
    this.panel.plot.setAttribute("aria-label", text(`chart_${kind}_about`));
    keepSettings({ chart: kind });
  }

  /** Saves all numbers that there are, of every chart. */
  save(): void {
    download(new Blob([this.charts.csv()], { type: "text/csv" }), "glisson-plot.csv");
  }

  draw(timing: Timing | null): void {
    if (timing !== null && timing !== this.shownTiming) this.charts.addTiming(timing);
    this.shownTiming = timing;
    if (this.panel.plot.hidden) return;
    const chart = this.charts.chart(this.kind, this.force);
    drawChart(this.panel.plot, chart);
    const names = chart.lines.map(({ name, colour }) => `${colour} ${name}`).join("|") + chart.yUnit;
    if (this.legend.dataset.names === names) return;
    this.legend.dataset.names = names;
    const parts = chart.lines.map(({ name, colour }) => {
      const part = document.createElement("span");
      part.textContent = name;
      part.style.color = colour;
      return part;
    });
    this.legend.replaceChildren(...parts, `(${chart.yUnit})`);
  }
}
