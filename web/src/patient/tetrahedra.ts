/** The tetrahedra: what came out, turned by mouse or arrows, cut open, coloured by organ or by quality; and the organs' tissues. */
import { facts, item, named, options, part } from "./dom";
import { text } from "../language";
import { Loader } from "./loader";
import { meshPicture, type MeshLook, type MeshSummary, type PatientState } from "./state";

/** Share by which the volume of an organ may be off. */
const WELL_MET = 0.015;
/** Turn of a pixel that is dragged, and of an arrow [degrees]. */
const DEGREES_A_PIXEL = 0.5;
const DEGREES_A_KEY = 15;
/** Seen from above or below at most [degrees]. */
const STEEPEST = 85;
const ARROWS: Readonly<Record<string, readonly [number, number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

export class TetrahedraSection {
  private readonly loader: Loader;
  private azimuth_deg = 20;
  private elevation_deg = 16;
  private version = 0;

  constructor(pictureOf: (name: string) => Promise<string>) {
    this.loader = new Loader(pictureOf);
    const view = part("picture");
    view.append(this.loader.picture);
    view.addEventListener("pointerdown", (event) => view.setPointerCapture(event.pointerId));
    view.addEventListener("pointermove", (event) => {
      if (event.buttons === 1) this.turn(DEGREES_A_PIXEL * event.movementX, DEGREES_A_PIXEL * event.movementY);
    });
    view.addEventListener("keydown", (event) => {
      const by = ARROWS[event.key];
      if (by === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      this.turn(DEGREES_A_KEY * by[0], DEGREES_A_KEY * by[1]);
    });
    for (const id of ["colours", "cut", "share"]) part(id).addEventListener("input", () => this.load());
  }

  private turn(right_deg: number, down_deg: number): void {
    this.azimuth_deg = (this.azimuth_deg + right_deg) % 360;
    this.elevation_deg = Math.min(Math.max(this.elevation_deg + down_deg, -STEEPEST), STEEPEST);
    this.load();
  }

  private load(): void {
    const look: MeshLook = {
      azimuth_deg: this.azimuth_deg,
      elevation_deg: this.elevation_deg,
      cut: part<HTMLSelectElement>("cut").value as MeshLook["cut"],
      share: part<HTMLInputElement>("share").valueAsNumber,
      colours: part<HTMLSelectElement>("colours").value as MeshLook["colours"],
    };
    part("quality").hidden = look.colours !== "quality";
    this.loader.load(meshPicture(look, this.version));
  }

  /** Shows the tetrahedra as they are by now. */
  show({ mesh, version, offers }: PatientState): void {
    part("mesh-figure").hidden = mesh === null;
    if (version === this.version) return;
    this.version = version;
    if (mesh === null) {
      facts(part("mesh-found"), []);
      return;
    }
    part("picture-caption").textContent = text("patient_n_tetrahedra", { n: mesh.tetrahedra });
    showFacts(mesh);
    showTissues(mesh, offers.tissues);
    const steps = offers.quality.map(({ from_deg, colour }, at) => {
      const next = offers.quality[at + 1]?.from_deg;
      const range = next === undefined ? text("patient_from", { from: from_deg }) : text("patient_from_to", { from: from_deg, to: next });
      const node = item(text("patient_degrees", { range, n: mesh.n_of_quality[at] ?? 0 }), []);
      node.style.setProperty("--colour", `rgb(${colour.join(" ")})`);
      return node;
    });
    part("quality").replaceChildren(...steps);
    this.load();
  }

  /** The tissue of each organ. */
  tissues(): string[] {
    return [...document.querySelectorAll<HTMLSelectElement>("#tissues select")].map((select) => select.value);
  }
}

function showFacts(mesh: MeshSummary): void {
  const volumes = mesh.organs.map(({ name, tetrahedra, volume_ml, volume_error }): readonly [string, string] => {
    const isThin = Math.abs(volume_error) > WELL_MET;
    const size = text("patient_size", { volume: volume_ml.toFixed(1), percent: (100 * volume_error).toFixed(2), note: isThin ? text("patient_too_thin") : "" });
    return [name, mesh.organs.length > 1 ? text("patient_size_of", { n: tetrahedra, size }) : size];
  });
  const crumbs: (readonly [string, string])[] = mesh.crumbs > 0 ? [[text("patient_left_out"), text("patient_crumbs", { n: mesh.crumbs })]] : [];
  facts(part("mesh-found"), [
    [text("patient_row_tetrahedra"), text("patient_nodes", { tetrahedra: mesh.tetrahedra, nodes: mesh.nodes })],
    ...volumes,
    [text("patient_bodies"), mesh.bodies === 1 ? "1" : text("patient_free", { n: mesh.bodies })],
    [text("patient_angles"), text("patient_angles_are", { from: mesh.dihedral_deg[0].toFixed(1), to: mesh.dihedral_deg[1].toFixed(1) })],
    [text("patient_edge"), `${mesh.mean_edge_mm.toFixed(1)} mm`],
    [text("patient_thin"), String(mesh.thin_places)],
    ...crumbs,
  ]);
}

/** A tissue for each organ; that of its name, where there is one. */
function showTissues(mesh: MeshSummary, tissues: readonly string[]): void {
  const names = mesh.organs.map(({ name }) => name);
  const shown = [...document.querySelectorAll<HTMLElement>("#tissues label")].map((label) => label.dataset["organ"]);
  if (shown.join("\n") === names.join("\n")) return;
  part("tissues").replaceChildren(
    ...names.map((name) => {
      const [label, select] = [document.createElement("label"), document.createElement("select")];
      label.dataset["organ"] = name;
      const own = name.toLowerCase().replaceAll(" ", "_");
      options(select, named(tissues), tissues.includes(own) ? own : "liver");
      label.append(`${text("patient_tissue_of", { organ: name })} `, select);
      return label;
    }),
  );
}
