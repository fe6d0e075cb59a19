/** The organs: what is said of the one that is looked for, and the list of those that were found. */
import { item, part } from "./dom";
import { Inputs, outlineWords, type Kind, type Method } from "./inputs";
import { text } from "../language";
import { isOneSlice, normalAxis } from "./planes";
import type { Outline, PatientState, PlaneName, Point, Step } from "./state";
import type { Cross, Marks } from "./view";
import { reasonOf } from "../reason";

/** What the page does for the section of organs. */
export interface OrganHost {
  readonly state: () => PatientState | null;
  readonly cross: () => Cross | null;
  readonly go: (to_mm: Point) => void;
  readonly step: (name: Step, choice: object) => Promise<void>;
  readonly outlines: (organ: string) => Promise<readonly Outline[]>;
  readonly complain: (words: string | null) => void;
  readonly showPlanes: () => void;
}

const KINDS: Readonly<Record<string, Kind>> = { i: "inside", o: "outside", c: "outline" };

export class OrganSection {
  private readonly inputs = new Inputs();
  /** Contours that were found for the organ that is looked for. */
  private found: readonly Outline[] = [];

  constructor(private readonly host: OrganHost) {
    part("find").addEventListener("click", () => {
      const byLabel = { name: this.name(), label: part<HTMLSelectElement>("label").value };
      void host.step("organ", this.choosesByLabel() ? byLabel : this.inputs.choice(this.name()));
    });
    part("another").addEventListener("click", () => this.lookForAnother());
    part("label").addEventListener("change", () => this.nameByLabel());
    part("name").addEventListener("change", () => this.rename());
    part("method").addEventListener("change", (event) => {
      this.inputs.method = (event.target as HTMLSelectElement).value as Method;
      this.showInputs();
    });
    part("finish").addEventListener("click", () => this.finish());
    part("none-here").addEventListener("click", () => this.leaveOut());
  }

  private choosesByLabel(): boolean {
    return (this.host.state()?.image?.labels.length ?? 0) > 0;
  }

  private planeOfSlices(): PlaneName {
    return this.host.state()?.image?.plane_of_slices ?? "axial";
  }

  private name(): string {
    return part<HTMLInputElement>("name").value.trim();
  }

  private kind(): Kind {
    return (document.querySelector<HTMLInputElement>('input[name="kind"]:checked')?.value ?? "inside") as Kind;
  }

  /** Chooses what the mouse sets, where the method takes it. */
  private chooseKind(kind: Kind): void {
    const input = document.querySelector<HTMLInputElement>(`input[name="kind"][value="${kind}"]`);
    if (input !== null && input.closest("label")?.hidden !== true) input.checked = true;
  }

  /** A new image: nothing that was said is of it. */
  begin(): void {
    this.inputs.forget();
    this.found = [];
    part("contours-about").textContent = text("patient_contours_about", { plane: text(`patient_${this.planeOfSlices()}`) });
    this.nameByLabel();
    this.showInputs();
  }

  /** What lies in the planes. */
  marks(): Marks {
    const { points, byHand, draft, method } = this.inputs;
    const isByContours = method === "contours";
    return { points, found: isByContours ? this.found : [], byHand: isByContours ? byHand : [], draft, planeOfSlices: this.planeOfSlices() };
  }

  isDrawing(plane: PlaneName): boolean {
    return this.kind() === "outline" && plane === this.planeOfSlices() && !this.choosesByLabel();
  }

  /** A point is set, or a corner of an outline. */
  set(at_mm: Point, plane: PlaneName): void {
    const cross = this.host.cross();
    if (this.choosesByLabel() || cross === null) return;
    const kind = this.kind();
    if (kind !== "outline") {
      this.inputs.points.push({ at_mm, kind });
    } else if (plane === this.planeOfSlices()) {
      const [first] = this.inputs.draft;
      // In another slice another outline begins.
      if (first !== undefined && !isOneSlice(plane, { ...cross, at_mm }, first)) this.inputs.draft = [];
      this.inputs.draft.push(at_mm);
    } else {
      this.host.complain(text("patient_draw_in", { plane: text(`patient_${this.planeOfSlices()}`) }));
      return;
    }
    this.showInputs();
  }

  /** Whether an outline is in the slice of a point. */
  private readonly inSliceOf = (point: Point | undefined) => ({ through_mm }: Outline): boolean => {
    const cross = this.host.cross();
    return cross !== null && point !== undefined && isOneSlice(this.planeOfSlices(), { ...cross, at_mm: point }, through_mm);
  };

  finish(): void {
    this.host.complain(this.inputs.finish(this.inSliceOf(this.inputs.draft[0])));
    this.showInputs();
  }

  private leaveOut(): void {
    const at_mm = this.host.cross()?.at_mm;
    if (at_mm !== undefined) this.inputs.leaveOut(at_mm, this.inSliceOf(at_mm));
    this.showInputs();
  }

  /** A key that nobody types. */
  key(key: string): void {
    const kind = KINDS[key];
    const isByContours = this.inputs.method === "contours" && !this.choosesByLabel();
    if (kind !== undefined) {
      this.chooseKind(kind);
    } else if (isByContours && key === "f") {
      this.finish();
    } else if (isByContours && key === "n") {
      this.leaveOut();
    } else if (isByContours && key === "backspace" && this.inputs.draft.length > 0) {
      this.inputs.draft.pop();
      this.host.showPlanes();
    }
  }

  /** Shows what is said of the organ that is looked for. */
  private showInputs(): void {
    const { points, byHand, method } = this.inputs;
    const removed = (id: string, list: unknown[], number: number) => () => {
      list.splice(number, 1);
      this.showInputs();
      // The keyboard goes on at what took the place of what was removed.
      const buttons = part(id).querySelectorAll<HTMLButtonElement>("li button:last-child");
      (buttons[Math.min(number, buttons.length - 1)] ?? part("find")).focus();
    };
    part("points").replaceChildren(
      ...points.map(({ at_mm, kind }, number) => {
        const words = `${text(`patient_kind_${kind}`)} ${at_mm.map((x) => x.toFixed(1)).join(", ")} mm`;
        const node = item(words, [{ text: text("patient_remove"), name: text("patient_remove_point", { what: words }), press: removed("points", points, number) }]);
        node.className = kind;
        return node;
      }),
    );
    part("outlines").replaceChildren(
      ...byHand.map((outline, number) => {
        const words = outlineWords(outline, this.planeOfSlices());
        return item(words, [
          { text: text("patient_go"), name: text("patient_go_to", { what: words }), press: () => this.goToSlice(outline.through_mm) },
          { text: text("patient_remove"), name: text("patient_remove_what", { what: words }), press: removed("outlines", byHand, number) },
        ]);
      }),
    );
    part<HTMLSelectElement>("method").value = method;
    for (const node of document.querySelectorAll<HTMLElement>("[data-method]")) node.hidden = node.dataset["method"] !== method;
    const chosen = document.querySelector<HTMLInputElement>('input[name="kind"]:checked');
    if (chosen?.closest("label")?.hidden === true) this.chooseKind("inside");
    this.host.showPlanes();
  }

  private goToSlice(of_mm: Point): void {
    const at_mm = this.host.cross()?.at_mm;
    if (at_mm === undefined) return;
    const axis = normalAxis(this.planeOfSlices());
    this.host.go(at_mm.map((x, i) => (i === axis ? of_mm[axis]! : x)) as unknown as Point);
  }

  /** The name of a label is that of the organ, unless another one is written. */
  private nameByLabel(): void {
    const label = part<HTMLSelectElement>("label").selectedOptions[0]?.text ?? "organ";
    part<HTMLInputElement>("name").value = this.choosesByLabel() ? label : "liver";
  }

  /** Goes on with an organ that was found, or begins with another one. */
  private lookFor(name: string): void {
    part<HTMLInputElement>("name").value = name;
    this.found = [];
    this.inputs.recall(name);
    this.showInputs();
    this.show();
  }

  /** Another name is another organ: one that was found, or one that begins with what was said of the last. */
  private rename(): void {
    if (this.host.state()?.organs.some(({ name }) => name === this.name()) ?? false) {
      this.lookFor(this.name());
      return;
    }
    this.found = [];
    this.show();
  }

  private lookForAnother(): void {
    const taken = new Set(this.host.state()?.organs.map(({ name }) => name));
    let number = taken.size + 1;
    while (taken.has(`organ ${number}`)) number++;
    this.lookFor(`organ ${number}`);
    part<HTMLInputElement>("name").select();
  }

  /** Shows what was found by now. */
  show(): void {
    const organs = this.host.state()?.organs ?? [];
    part("by-label").hidden = !this.choosesByLabel();
    part("by-points").hidden = this.choosesByLabel();
    part("find").textContent = this.choosesByLabel() ? text("patient_take_label") : text("patient_find");
    part("organs").replaceChildren(
      ...organs.map(({ name, volume_ml }) =>
        item(`${name}: ${volume_ml.toFixed(1)} ml`, [
          { text: text("patient_change"), name: text("patient_change_what", { what: name }), press: () => this.lookFor(name) },
          { text: text("patient_remove"), name: text("patient_remove_what", { what: name }), press: () => void this.host.step("remove", { name }) },
        ]),
      ),
    );
    part("another").hidden = organs.length === 0;
    const organ = organs.find(({ name }) => name === this.name());
    const words: string[] = organ === undefined ? [] : [`${organ.volume_ml.toFixed(1)} ml`];
    if (organ !== undefined && organ.cut_off_at.length > 0) words.push(text("patient_cut_off", { where: organ.cut_off_at.join(", ") }));
    if (organ !== undefined && organ.not_at_rest_mm.length > 0) {
      const axis = normalAxis(this.planeOfSlices());
      words.push(text("patient_not_at_rest", { where: organ.not_at_rest_mm.map((p) => p[axis]!.toFixed(1)).join(", ") }));
    }
    part("organ-found").textContent = words.join("; ");
    void this.showFound(organ?.n_outlines ?? 0);
  }

  /** Fetches the contours that the organ was made from. */
  private async showFound(n_outlines: number): Promise<void> {
    const name = this.name();
    let found: readonly Outline[] = [];
    try {
      if (n_outlines > 0) found = await this.host.outlines(name);
    } catch (error) {
      this.host.complain(reasonOf(error));
    }
    // Meanwhile another organ may be looked for.
    if (name === this.name()) this.found = found;
    this.host.showPlanes();
  }
}
