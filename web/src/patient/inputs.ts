/** What is said of the organ that is looked for: its name, points and outlines, kept for each organ. */
import { text } from "../language";
import type { Outline, PlaneName, Point } from "./state";
import type { ShownPoint } from "./view";

export type Method = "points" | "contours";
export type Kind = ShownPoint["kind"] | "outline";

/** Corners of an outline at least. */
const LEAST_CORNERS = 3;

interface Said {
  readonly method: Method;
  readonly points: readonly ShownPoint[];
  readonly byHand: readonly Outline[];
}

export class Inputs {
  method: Method = "points";
  points: ShownPoint[] = [];
  byHand: Outline[] = [];
  draft: Point[] = [];
  private readonly saidOf = new Map<string, Said>();

  clear(): void {
    [this.points, this.byHand, this.draft] = [[], [], []];
  }

  /** A new image: nothing that was said is of it. */
  forget(): void {
    this.clear();
    this.saidOf.clear();
  }

  /** What is asked of the server. */
  choice(name: string): object {
    this.saidOf.set(name, { method: this.method, points: [...this.points], byHand: [...this.byHand] });
    const of = (kind: ShownPoint["kind"]): Point[] => this.points.filter((point) => point.kind === kind).map((point) => point.at_mm);
    const isByContours = this.method === "contours";
    return {
      name,
      method: this.method,
      inside_mm: of("inside"),
      outside_mm: isByContours ? [] : of("outside"),
      outlines: isByContours ? this.byHand : [],
    };
  }

  /** Goes on with what was said of an organ. */
  recall(name: string): void {
    const said = this.saidOf.get(name);
    this.clear();
    if (said === undefined) return;
    [this.method, this.points, this.byHand] = [said.method, [...said.points], [...said.byHand]];
  }

  /** Closes the outline that is being drawn, beside others that are in its slice; answers what is wrong with it, if something is. */
  finish(isInSlice: (outline: Outline) => boolean): string | null {
    const [first] = this.draft;
    if (first === undefined || this.draft.length < LEAST_CORNERS) {
      return text("patient_corners", { least: LEAST_CORNERS, n: this.draft.length });
    }
    // The organ is in the slice after all.
    this.byHand = this.byHand.filter((outline) => outline.points_mm.length > 0 || !isInSlice(outline));
    this.byHand.push({ through_mm: first, points_mm: this.draft });
    this.draft = [];
    return null;
  }

  /** Says that the organ is not in the slice of a point, whatever was drawn there. */
  leaveOut(through_mm: Point, isInSlice: (outline: Outline) => boolean): void {
    this.draft = [];
    this.byHand = this.byHand.filter((outline) => !isInSlice(outline));
    this.byHand.push({ through_mm, points_mm: [] });
  }
}

/** An outline in words. */
export function outlineWords({ through_mm, points_mm }: Outline, plane: PlaneName): string {
  const along = { axial: 2, coronal: 1, sagittal: 0 }[plane];
  const what = points_mm.length > 0 ? text("patient_n_corners", { n: points_mm.length }) : text("patient_not_in_slice");
  return text("patient_outline_at", { plane: text(`patient_${plane}`), at: through_mm[along]!.toFixed(1), what });
}
