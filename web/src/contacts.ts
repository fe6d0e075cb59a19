/** Key C: contact points are asked for where the page is live, shown in the picture and counted in a legend. Nothing is sent while they are not shown. */
import type { Connection } from "./connection";
import { KIND_COLOURS, type ContactMarks } from "./contact_marks";
import { CONTACT_KINDS, leftOut, type ContactPoints } from "./contact_points";
import { text } from "./language";
import { forceText, lengthOf } from "./panel";
import { niceCeiling } from "./plot";

/** The longest arrow, as a share of the distance of the eye. */
const LONGEST_ARROW = 0.18;

/** What is left of the greatest force from one snapshot to the next: half of it after two seconds. */
const FADES_BY = 0.994;
/** Smaller forces than this are not told apart [N]. */
const LEAST_N = 1e-6;

/** Length of an arrow for a newton [m/N], so that none of a force up to `largest_n` is longer than `longest_m`; 10 mm are a round force. */
export function contactArrowScale_m_per_n(largest_n: number, longest_m: number): number {
  return 0.01 / niceCeiling((0.01 * Math.max(largest_n, LEAST_N)) / longest_m, 1e-9);
}

function row(colour: string, label: string, n: string, force: string): HTMLElement {
  const line = document.createElement("tr");
  const cells = ["", label, n, force].map((words) => Object.assign(document.createElement("td"), { textContent: words }));
  const dot = Object.assign(document.createElement("span"), { className: "contact-dot" });
  dot.style.background = colour;
  cells[0].append(dot);
  line.append(...cells);
  return line;
}

export class Contacts {
  private shown = false;
  private points: ContactPoints | null = null;
  /** Greatest force, which fades: arrows grow shorter at once when forces grow, and longer again some seconds later. */
  private largest_n = 0;
  private state = "";

  constructor(
    private readonly legend: HTMLElement,
    private readonly marks: ContactMarks,
  ) {
    legend.setAttribute("aria-label", text("contacts_title"));
  }

  /** Key C; a recording has no connection that is asked for them. */
  turn(shown: boolean, connection: Connection | null): void {
    this.shown = shown;
    this.forget();
    connection?.send({ type: "contacts", shown });
  }

  /** A new connection knows nothing of what is shown. */
  ask(connection: Connection): void {
    if (this.shown) connection.send({ type: "contacts", shown: true });
  }

  forget(): void {
    this.points = null;
    this.largest_n = 0;
  }

  take(points: ContactPoints | null): void {
    this.points = this.shown ? points : null;
    this.largest_n *= FADES_BY;
    for (const { force_n } of this.points?.points ?? []) this.largest_n = Math.max(this.largest_n, lengthOf(force_n));
  }

  /** Draws them for an eye at `distance_m`. */
  show(distance_m: number): void {
    const scale_m_per_n = contactArrowScale_m_per_n(this.largest_n, LONGEST_ARROW * distance_m);
    this.marks.show(this.points, distance_m, scale_m_per_n);
    this.showLegend(scale_m_per_n);
  }

  private showLegend(scale_m_per_n: number): void {
    this.legend.hidden = !this.shown;
    if (!this.shown) return;
    const { points } = this;
    const state = JSON.stringify([points?.sums, points?.points.length, scale_m_per_n]);
    if (state === this.state) return;
    this.state = state;
    const title = Object.assign(document.createElement("h2"), { textContent: text("contacts_title") });
    const table = document.createElement("table");
    CONTACT_KINDS.forEach((kind, i) => {
      const sum = points?.sums[i];
      if (sum === undefined || sum.n === 0) return;
      const line = row(KIND_COLOURS[kind], text(`contacts_${kind}`), String(sum.n), forceText(sum.force_n));
      line.dataset.kind = kind;
      line.title = text("contacts_row_about");
      table.append(line);
    });
    const notes = [points === null ? text("contacts_waiting") : points.points.length === 0 ? text("contacts_none") : ""];
    if (points !== null && points.points.length > 0) {
      notes[0] = text("contacts_scale", { force: forceText(0.01 / scale_m_per_n) });
      const n = leftOut(points);
      if (n > 0) notes.push(text("contacts_left_out", { n: points.points.length, m: n }));
    }
    const foot = notes.map((note) => Object.assign(document.createElement("div"), { className: "contact-note", textContent: note }));
    this.legend.replaceChildren(title, table, ...foot);
  }
}
