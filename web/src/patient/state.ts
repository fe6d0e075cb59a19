/** What is said of the patient, and what can be asked (crates/glisson-patient/src/steps.rs). */

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
  /** Whether the numbers were taken for labels though the file does not say so. */
  readonly are_labels_guessed: boolean;
  /** Where outlines are drawn. */
  readonly plane_of_slices: PlaneName;
}

/** A closed line in a slice; without points: the organ is not in it. */
export interface Outline {
  readonly through_mm: Point;
  readonly points_mm: readonly Point[];
}

export interface OrganSummary {
  readonly name: string;
  readonly volume_ml: number;
  readonly cut_off_at: readonly string[];
  readonly n_outlines: number;
  /** Slices whose contours did not come to rest. */
  readonly not_at_rest_mm: readonly Point[];
}

export interface MeshSummary {
  readonly tetrahedra: number;
  readonly nodes: number;
  readonly organs: readonly { readonly name: string; readonly tetrahedra: number; readonly volume_ml: number; readonly volume_error: number }[];
  /** Organs that hang together are one. */
  readonly bodies: number;
  /** Tetrahedra of each step of quality. */
  readonly n_of_quality: readonly number[];
  /** Pieces that were left out. */
  readonly crumbs: number;
  readonly dihedral_deg: readonly [number, number];
  readonly mean_edge_mm: number;
  readonly thin_places: number;
}

export interface PatientState {
  /** Grows whenever pictures change. */
  readonly version: number;
  /** Grows with each image. */
  readonly image_number: number;
  readonly job: { readonly what: string; readonly seconds: number; readonly share: number; readonly is_cancelled: boolean } | null;
  readonly error: string | null;
  readonly series: readonly string[];
  readonly image: ImageSummary | null;
  readonly organs: readonly OrganSummary[];
  readonly mesh: MeshSummary | null;
  readonly started: boolean;
  /** A start page comes after this one. */
  readonly can_leave: boolean;
  readonly offers: {
    readonly tissues: readonly string[];
    readonly models: readonly { readonly name: string; readonly about: string }[];
    readonly held: readonly string[];
    /** Least, offered, most. */
    readonly tetrahedra: Point;
    /** From which smallest dihedral angle on tetrahedra have which colour. */
    readonly quality: readonly { readonly from_deg: number; readonly colour: Point }[];
  };
}

export type Step = "open" | "values" | "organ" | "remove" | "mesh" | "start" | "cancel" | "leave";

/** The picture of a slice; `version` makes a new one of the same slice. */
export function slicePicture(plane: PlaneName, at_mm: Point, window: readonly [number, number], version: number): string {
  const numbers = [...at_mm, ...window].map((x) => x.toFixed(3)).join("/");
  return `slice/${plane}/${numbers}?v=${version}`;
}

/** How the tetrahedra are looked at. */
export interface MeshLook {
  readonly azimuth_deg: number;
  readonly elevation_deg: number;
  readonly cut: PlaneName | "none";
  /** Of the organs' box, along the cut's normal. */
  readonly share: number;
  readonly colours: "organ" | "quality";
}

export function meshPicture(look: MeshLook, version: number): string {
  const { azimuth_deg, elevation_deg, cut, share, colours } = look;
  return `mesh/${azimuth_deg.toFixed(1)}/${elevation_deg.toFixed(1)}/${cut}/${share.toFixed(3)}/${colours}?v=${version}`;
}
