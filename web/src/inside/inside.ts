/** The inside of bodies: what the user looks at, the server that is asked for it, and the legend with its controls. */
import type { Connection } from "../connection";
import { text } from "../language";
import type { Hello } from "../protocol";
import { keepSettings, readSettings } from "../settings";
import type { TextKey } from "../texts_en";
import { SCALE, valueText } from "./colours";
import type { InsidePicture } from "./picture";
import { AXES, cutPlane, thickness_m, type CutPlane, type PlaneAxis } from "./plane";
import { FIELDS, type FieldKind } from "./snapshot";

/** One press of a key moves the plane by this much [m]. */
const STRIDE_M = 0.002;

function choice<T extends string>(name: "field" | "plane", all: readonly T[], chosen: (value: T) => void): HTMLSelectElement {
  const select = document.createElement("select");
  select.setAttribute("aria-label", text(`inside_${name}`));
  for (const value of all) select.append(new Option(text(`inside_${name}_${value}` as TextKey), value));
  select.addEventListener("change", () => chosen(select.value as T));
  return select;
}

export class Inside {
  private field: FieldKind;
  private axis: PlaneAxis = "off";
  private share = 0.5;
  private flipped = false;
  private energies = false;
  private bounds: Hello["bounds"] | null = null;
  private asked = "";
  private readonly fieldChoice = choice("field", FIELDS, (field) => this.showField(field));
  private readonly planeChoice = choice("plane", AXES, (axis) => this.turn(axis));
  private readonly place = document.createElement("input");
  private readonly side = document.createElement("input");
  private readonly scale = document.createElement("div");

  constructor(
    private readonly root: HTMLElement,
    private readonly picture: InsidePicture,
    private readonly connection: () => Connection,
    private readonly changed: (plane: CutPlane | null) => void,
  ) {
    this.field = readSettings().field;
    root.setAttribute("aria-label", text("inside_title"));
    this.place.type = "range";
    this.place.min = "0";
    this.place.max = "1";
    this.place.step = "0.005";
    this.place.setAttribute("aria-label", text("inside_place"));
    this.place.addEventListener("input", () => this.put(Number(this.place.value)));
    this.side.type = "checkbox";
    this.side.addEventListener("change", () => {
      this.flipped = this.side.checked;
      this.ask();
    });
    const side = document.createElement("label");
    side.append(this.side, text("inside_other_side"));
    this.scale.className = "inside-scale";
    root.append(this.fieldChoice, this.scale, this.planeChoice, this.place, side);
    this.layOut();
  }

  begin({ bounds }: Hello): void {
    this.bounds = bounds;
    // A new connection knows nothing of what is looked at.
    this.asked = "";
    this.ask();
  }

  /** Whether energies are plotted, which come from inside. */
  plotEnergies(energies: boolean): void {
    if (energies === this.energies) return;
    this.energies = energies;
    this.ask();
  }

  nextField(): void {
    this.showField(FIELDS[(FIELDS.indexOf(this.field) + 1) % FIELDS.length]);
  }

  nextPlane(): void {
    this.turn(AXES[(AXES.indexOf(this.axis) + 1) % AXES.length]);
  }

  /** The plane goes deeper into the organ (+1) or comes out of it (-1). */
  move(direction: 1 | -1): void {
    if (this.axis === "off" || this.bounds === null) return;
    this.put(this.share + (direction * STRIDE_M) / thickness_m(this.axis, this.bounds));
  }

  private showField(field: FieldKind): void {
    this.field = field;
    keepSettings({ field });
    this.ask();
  }

  private turn(axis: PlaneAxis): void {
    this.axis = axis;
    this.ask();
  }

  private put(share: number): void {
    this.share = Math.min(1, Math.max(0, share));
    this.ask();
  }

  private ask(): void {
    this.layOut();
    if (this.bounds === null) return;
    const plane = cutPlane(this.axis, this.share, this.flipped, this.bounds);
    const message = { type: "inside", field: this.field, plane, energies: this.energies } as const;
    const now = JSON.stringify(message);
    if (now === this.asked) return;
    const isNothing = this.field === "none" && plane === null && !this.energies;
    // Who never looked need not say that it looks at nothing.
    if (this.asked !== "" || !isNothing) this.connection().send(message);
    this.asked = now;
    this.changed(plane);
  }

  private layOut(): void {
    this.fieldChoice.value = this.field;
    this.planeChoice.value = this.axis;
    this.place.value = String(this.share);
    for (const part of [this.place, this.side.parentElement]) if (part !== null) part.hidden = this.axis === "off";
    this.root.hidden = this.field === "none" && this.axis === "off";
    this.showScale();
  }

  /** The legend, with the scale's ends as they are now. */
  showScale(): void {
    this.scale.hidden = this.field === "none";
    const ends = [0, 0.5, 1].map((share) => (share === 1 && this.field !== "quality" ? "≥ " : "") + valueText(this.field, share * this.picture.top)).join("|");
    if (this.scale.hidden || this.scale.dataset.ends === ends) return;
    this.scale.dataset.ends = ends;
    const bar = document.createElement("div");
    bar.style.background = `linear-gradient(to right, ${SCALE.join(", ")})`;
    const marks = document.createElement("p");
    marks.append(...ends.split("|").map((end) => Object.assign(document.createElement("span"), { textContent: end })));
    this.scale.title = text(`inside_about_${this.field}`);
    this.scale.replaceChildren(bar, marks);
  }

  /** What is looked at now. */
  get looks(): { readonly field: FieldKind; readonly plane: PlaneAxis; readonly share: number; readonly top: number } {
    return { field: this.field, plane: this.axis, share: this.share, top: this.picture.top };
  }
}
