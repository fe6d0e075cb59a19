/** The page for a new patient: image, organ, tetrahedra, simulation. */
import "../style.css";
import "./patient.css";
import { droppedFiles, imageFiles } from "./drop";
import { fetchState, PICTURE, post, sendFiles, sliceAddress, type ImageSummary, type PatientState, type PlaneName, type Point } from "./state";
import { clamped, type Box } from "./planes";
import { PlaneView, type Cross, type ShownPoint } from "./view";

/** How often the server is asked, while a step runs and else [ms]. */
const ASK_BUSY_MS = 250;
const ASK_IDLE_MS = 2000;
const PLANES: readonly PlaneName[] = ["axial", "coronal", "sagittal"];

function part<T extends HTMLElement>(id: string): T {
  const node = document.getElementById(id);
  if (node === null) throw new Error(`patient.html has no element "${id}"`);
  return node as T;
}

const status = part("status");
const errorLine = part("error");
const points: ShownPoint[] = [];
let state: PatientState | null = null;
let cross: Cross | null = null;
let window_: [number, number] = [0, 1];
/** The number of the image whose controls are set up. */
let shownImage = 0;
/** What the server said went wrong, as it was shown. */
let serverError: string | null = null;
let isSending = false;

const views = new Map(
  PLANES.map((plane) => [plane, new PlaneView(plane, part(plane), { go, setPoint })] as const),
);

function go(to_mm: Point): void {
  if (cross === null) return;
  cross = { ...cross, at_mm: clamped(cross.box, to_mm) };
  showPlanes();
}

function chosenKind(): ShownPoint["kind"] {
  const chosen = document.querySelector<HTMLInputElement>('input[name="kind"]:checked');
  return chosen?.value === "outside" ? "outside" : "inside";
}

function choosesByLabel(): boolean {
  return (state?.image?.labels.length ?? 0) > 0;
}

function setPoint(at_mm: Point, kind = chosenKind()): void {
  if (choosesByLabel() || state?.image == null) return;
  points.push({ at_mm, kind });
  showPoints();
  showPlanes();
}

function showPoints(): void {
  const list = part("points");
  list.replaceChildren(
    ...points.map((point, number) => {
      const item = document.createElement("li");
      item.className = point.kind;
      const words = `${point.kind} ${point.at_mm.map((x) => x.toFixed(1)).join(", ")} mm`;
      item.append(words, " ");
      const remove = document.createElement("button");
      remove.type = "button";
      remove.textContent = "remove";
      remove.setAttribute("aria-label", `remove the point ${words}`);
      remove.addEventListener("click", () => {
        points.splice(number, 1);
        showPoints();
        showPlanes();
      });
      item.append(remove);
      return item;
    }),
  );
}

function showPlanes(): void {
  if (cross === null || state === null) return;
  for (const [plane, view] of views) {
    view.load(sliceAddress(plane, cross.at_mm, window_, state.version));
    view.mark(cross, points);
    const caption = part(plane).parentElement?.querySelector("figcaption");
    const normal = { axial: 2, coronal: 1, sagittal: 0 }[plane];
    if (caption != null) caption.textContent = `${plane} ${cross.at_mm[normal]!.toFixed(1)} mm`;
  }
  part("window").textContent = `${window_[0].toFixed(0)} ± ${(0.5 * window_[1]).toFixed(0)}`;
}

function facts(list: HTMLElement, rows: readonly (readonly [string, string])[]): void {
  list.replaceChildren(
    ...rows.flatMap(([name, value]) => {
      const [term, text] = [document.createElement("dt"), document.createElement("dd")];
      [term.textContent, text.textContent] = [name, value];
      return [term, text];
    }),
  );
}

function options(select: HTMLSelectElement, list: readonly { readonly value: string; readonly text: string }[], chosen?: string): void {
  if (select.options.length === list.length) return;
  select.replaceChildren(...list.map(({ value, text }) => new Option(text, value, false, value === chosen)));
}

function setUpImage(image: ImageSummary): void {
  const box: Box = { from_mm: image.from_mm, to_mm: image.to_mm };
  const middle = image.from_mm.map((x, i) => 0.5 * (x + image.to_mm[i]!)) as unknown as Point;
  cross = { box, steps_mm: image.steps_mm, at_mm: middle };
  points.length = 0;
  showPoints();
  window_ = [...image.window];
  const [least, most] = image.values;
  const range = (id: string, min: number, max: number, value: number): void => {
    const input = part<HTMLInputElement>(id);
    [input.min, input.max, input.step] = [String(min), String(max), String(Math.max((max - min) / 500, 1e-3))];
    input.value = String(value);
  };
  range("centre", least, most, window_[0]);
  range("width", 1, Math.max(most - least, 2), window_[1]);
  const labels = image.labels.map(({ label, name }) => ({ value: String(label), text: name }));
  const select = part<HTMLSelectElement>("label");
  select.replaceChildren();
  options(select, labels, labels.find(({ text }) => text === "liver")?.value);
  facts(part("found"), [
    ["format", image.modality === null ? image.format : `${image.format}, ${image.modality}`],
    ["voxels", `${image.voxels.join(" × ")} of ${image.spacing_mm.map((x) => x.toFixed(2)).join(" × ")} mm`],
    ["holds", labels.length > 0 ? `${labels.length} labels` : `values from ${least} to ${most}`],
  ]);
  part("notes").replaceChildren(
    ...image.notes.map((note) => Object.assign(document.createElement("li"), { textContent: note })),
  );
}

/** Shows what went wrong, until the next thing is done. */
function complain(words: string | null): void {
  errorLine.hidden = words === null;
  errorLine.textContent = words ?? "";
  if (words !== null) console.warn(words);
}

function complainOf(error: unknown): void {
  complain(error instanceof Error ? error.message : String(error));
}

function show(now: PatientState): void {
  const isNew = state === null || state.version !== now.version;
  state = now;
  const { image, organ, mesh, job } = now;
  if (!isSending) {
    status.textContent = job === null ? stepWords(now) : `${job.what}… ${job.seconds.toFixed(0)} s`;
    status.classList.toggle("busy", job !== null);
  }
  if (now.error !== serverError) {
    serverError = now.error;
    complain(now.error);
  }
  if (isNew) {
    const series = part("series");
    series.hidden = now.series.length === 0;
    series.replaceChildren(...now.series.map(seriesButton));
  }
  part("organ").hidden = part("planes").hidden = image === null;
  part("mesh").hidden = organ === null;
  part("start").hidden = mesh === null;
  for (const button of document.querySelectorAll<HTMLButtonElement>("main section > button")) button.disabled = job !== null;
  if (image === null) return;
  if (now.image_number !== shownImage) {
    shownImage = now.image_number;
    setUpImage(image);
  }
  part("by-label").hidden = !choosesByLabel();
  part("by-points").hidden = choosesByLabel();
  part("find").textContent = choosesByLabel() ? "Take this label" : "Find the organ";
  if (organ !== null) {
    const cut = organ.cut_off_at.length > 0 ? `, cut off at the border of the image: ${organ.cut_off_at.join(", ")}` : "";
    part("organ-found").textContent = `${organ.volume_ml.toFixed(1)} ml${cut}`;
  } else {
    part("organ-found").textContent = "";
  }
  const input = part<HTMLInputElement>("tetrahedra");
  if (input.value === "") {
    const [least, offered, most] = now.offers.tetrahedra;
    [input.min, input.max, input.value] = [String(least), String(most), String(offered)];
  }
  const picture = part<HTMLImageElement>("picture");
  picture.hidden = mesh === null;
  if (mesh !== null) {
    if (isNew) picture.src = `${PICTURE}?v=${now.version}`;
    part("picture-caption").textContent = `${mesh.tetrahedra} tetrahedra`;
    facts(part("mesh-found"), [
      ["tetrahedra", `${mesh.tetrahedra}, ${mesh.nodes} nodes`],
      ["volume", `${mesh.volume_ml.toFixed(1)} ml, ${(100 * mesh.volume_error).toFixed(2)} % off the voxels`],
      ["dihedral angles", `${mesh.dihedral_deg[0].toFixed(1)} to ${mesh.dihedral_deg[1].toFixed(1)} degrees`],
      ["mean edge", `${mesh.mean_edge_mm.toFixed(1)} mm`],
      ["thin places", String(mesh.thin_places)],
    ]);
  } else {
    part("picture-caption").textContent = "";
  }
  const named = (names: readonly string[]): { value: string; text: string }[] => names.map((name) => ({ value: name, text: name }));
  options(part("tissue"), named(now.offers.tissues), "liver");
  options(part("model"), now.offers.models.map(({ name, about }) => ({ value: name, text: `${name}: ${about}` })));
  options(part("held"), named(now.offers.held));
  if (isNew) showPlanes();
}

function stepWords(now: PatientState): string {
  if (now.image === null && now.series.length > 0) return "the folder holds several series: choose one";
  if (now.image === null) return "waiting for an image";
  if (now.organ === null) return choosesByLabel() ? "choose the organ's label" : "set points in and around the organ, then find it";
  if (now.mesh === null) return "fill the organ with tetrahedra";
  return "choose tissue, model and what holds it, then start";
}

function seriesButton(words: string, place: number): HTMLLIElement {
  const [item, button] = [document.createElement("li"), document.createElement("button")];
  button.type = "button";
  button.textContent = words;
  button.addEventListener("click", () => void step("open", { series: place + 1 }));
  item.append(button);
  return item;
}

async function step(name: "open" | "organ" | "mesh" | "start", choice: object): Promise<void> {
  complain(null);
  try {
    await post(name, choice);
    serverError = null;
    await ask();
  } catch (error) {
    complainOf(error);
  }
}

async function take(files: readonly File[]): Promise<void> {
  if (isSending) return;
  complain(null);
  if (files.length === 0) {
    complain("there is no file of an image in it");
    return;
  }
  isSending = true;
  status.classList.add("busy");
  let upload: number | undefined;
  try {
    upload = await sendFiles(files, (done) => {
      status.textContent = `sending ${done} of ${files.length} files…`;
    });
  } catch (error) {
    complainOf(error);
  }
  isSending = false;
  if (upload !== undefined) await step("open", { upload });
}

let timer: number | undefined;
let isAsking = false;

/** Asks the server how far it is, and again after a while. */
async function ask(): Promise<void> {
  // The question under way is asked again soon enough.
  if (isAsking) return;
  clearTimeout(timer);
  isAsking = true;
  try {
    const now = await fetchState();
    show(now);
    if (now.started) {
      await goToSimulation();
      return;
    }
  } catch (error) {
    // Another page may have started the simulation.
    if (await isSimulationThere()) {
      location.reload();
      return;
    }
    status.textContent = "the server does not answer";
    console.warn(error);
  }
  isAsking = false;
  timer = window.setTimeout(() => void ask(), state?.job != null ? ASK_BUSY_MS : ASK_IDLE_MS);
}

/** Whether the simulation is served at this address by now. */
async function isSimulationThere(): Promise<boolean> {
  try {
    return (await (await fetch("/", { cache: "no-store" })).text()).includes('id="scene"');
  } catch (error) {
    console.warn(error);
    return false;
  }
}

/** The simulation is served at this address in a moment: then a reload shows it. */
async function goToSimulation(): Promise<void> {
  status.textContent = "starting the simulation…";
  while (!(await isSimulationThere())) await new Promise((resolve) => setTimeout(resolve, ASK_BUSY_MS));
  location.reload();
}

part("find").addEventListener("click", () => {
  const of = (kind: ShownPoint["kind"]): Point[] => points.filter((point) => point.kind === kind).map((point) => point.at_mm);
  const byLabel = { label: part<HTMLSelectElement>("label").value };
  void step("organ", choosesByLabel() ? byLabel : { inside_mm: of("inside"), outside_mm: of("outside") });
});
part("fill").addEventListener("click", () => {
  void step("mesh", { tetrahedra: Math.round(part<HTMLInputElement>("tetrahedra").valueAsNumber) || 0 });
});
part("run").addEventListener("click", () => {
  const value = (id: string): string => part<HTMLSelectElement>(id).value;
  void step("start", { tissue: value("tissue"), model: value("model"), held: value("held") });
});
for (const id of ["folder", "files"]) {
  const input = part<HTMLInputElement>(id);
  input.addEventListener("change", () => {
    const files = imageFiles([...(input.files ?? [])]);
    // The same file may be chosen again.
    input.value = "";
    void take(files);
  });
}
for (const [place, id] of ["centre", "width"].entries()) {
  const input = part<HTMLInputElement>(id);
  input.addEventListener("input", () => {
    window_[place] = input.valueAsNumber;
    showPlanes();
  });
}
const drop = part("drop");
document.addEventListener("dragover", (event) => {
  event.preventDefault();
  drop.classList.add("over");
});
document.addEventListener("dragleave", () => drop.classList.remove("over"));
document.addEventListener("drop", (event) => {
  event.preventDefault();
  drop.classList.remove("over");
  if (event.dataTransfer !== null) droppedFiles(event.dataTransfer).then(take, complainOf);
});
document.addEventListener("keydown", (event) => {
  const isTyping = event.target instanceof HTMLInputElement && event.target.type === "number";
  const kind = { i: "inside", o: "outside" }[event.key.toLowerCase()];
  if (kind === undefined || isTyping || event.ctrlKey || event.altKey || event.metaKey) return;
  const input = document.querySelector<HTMLInputElement>(`input[name="kind"][value="${kind}"]`);
  if (input !== null) input.checked = true;
});
void ask();
