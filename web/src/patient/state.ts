/** What the server says of the patient, and what it can be asked (crates/glisson-view/src/patient/api.rs). */

export type Point = readonly [number, number, number];
export type PlaneName = "axial" | "coronal" | "sagittal";

export interface ImageSummary {
  readonly format: string;
  readonly modality: string | null;
  readonly voxels: Point;
  readonly spacing_mm: Point;
  /** Distance of the voxels' layers along each patient axis. */
  readonly steps_mm: Point;
  /** Corners of the image's box, LPS [mm]. */
  readonly from_mm: Point;
  readonly to_mm: Point;
  /** Centre and width. */
  readonly window: readonly [number, number];
  /** Least and greatest. */
  readonly values: readonly [number, number];
  readonly labels: readonly { readonly label: number; readonly name: string }[];
  readonly notes: readonly string[];
}

export interface OrganSummary {
  readonly volume_ml: number;
  readonly cut_off_at: readonly string[];
}

export interface MeshSummary {
  readonly tetrahedra: number;
  readonly nodes: number;
  readonly volume_ml: number;
  readonly volume_error: number;
  readonly dihedral_deg: readonly [number, number];
  readonly mean_edge_mm: number;
  readonly thin_places: number;
}

export interface PatientState {
  /** Grows whenever pictures change. */
  readonly version: number;
  /** Grows with each image. */
  readonly image_number: number;
  readonly job: { readonly what: string; readonly seconds: number } | null;
  readonly error: string | null;
  readonly series: readonly string[];
  readonly image: ImageSummary | null;
  readonly organ: OrganSummary | null;
  readonly mesh: MeshSummary | null;
  readonly started: boolean;
  readonly offers: {
    readonly tissues: readonly string[];
    readonly models: readonly { readonly name: string; readonly about: string }[];
    readonly held: readonly string[];
    /** Least, offered, most. */
    readonly tetrahedra: Point;
  };
}

const API = "/api/patient/";

/** @throws Error with the server's words. */
async function asked(path: string, init?: RequestInit): Promise<Response> {
  const response = await fetch(API + path, init);
  if (!response.ok) throw new Error((await response.text()).trim() || `the server answers ${response.status}`);
  return response;
}

export async function fetchState(): Promise<PatientState> {
  return (await asked("state")).json() as Promise<PatientState>;
}

/** Begins a step of the server. */
export async function post(step: "open" | "organ" | "mesh" | "start", choice: object): Promise<void> {
  await asked(step, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(choice) });
}

/** Sends the files of an image; answers the number under which they came. */
export async function sendFiles(files: readonly File[], tell: (done: number) => void): Promise<number> {
  const { upload } = (await (await asked("files", { method: "POST" })).json()) as { upload: number };
  for (const [number, file] of files.entries()) {
    await asked(`files/${upload}/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
    tell(number + 1);
  }
  return upload;
}

/** Address of a slice's picture; `version` makes a new one of the same slice. */
export function sliceAddress(plane: PlaneName, at_mm: Point, window: readonly [number, number], version: number): string {
  const numbers = [...at_mm, ...window].map((x) => x.toFixed(3)).join("/");
  return `${API}slice/${plane}/${numbers}?v=${version}`;
}

export const PICTURE = `${API}picture.png`;
