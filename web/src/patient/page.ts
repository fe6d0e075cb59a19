/** The page for a new patient: image, organs, tetrahedra, simulation. */
import "../style.css";
import "./patient.css";
import { facts, item, named, options, part } from "./dom";
import { droppedFiles, imageFiles } from "./drop";
import type { Desk } from "./desk";
import { OrganSection } from "./organs";
import { languageChoice, text, translatePage } from "../language";
import { clamped, middleVoxel, normalAxis, type Box } from "./planes";
import { slicePicture, type ImageSummary, type PatientState, type PlaneName, type Point, type Step } from "./state";
import { TetrahedraSection } from "./tetrahedra";
import { PlaneView, type Cross, type PlaneHandlers } from "./view";
import { reasonOf } from "../reason";

/** How often it is asked how far the patient is, while a step runs and else [ms]. */
const ASK_BUSY_MS = 250;
const ASK_IDLE_MS = 2000;
const PLANES: readonly PlaneName[] = ["axial", "coronal", "sagittal"];

/** Who does the steps. */
let desk: Desk;
const status = part("status");
const errorLine = part("error");
const pictureOf = (name: string): Promise<string> => desk.picture(name);
const tetrahedra = new TetrahedraSection(pictureOf);
let state: PatientState | null = null;
let cross: Cross | null = null;
let window_: [number, number] = [0, 1];
/** The number of the image whose controls are set up. */
let shownImage = 0;
/** What was said to have gone wrong, as it was shown. */
let shownError: string | null = null;
let isSending = false;

const organs = new OrganSection({ state: () => state, cross: () => cross, go, step, outlines: (organ) => desk.outlines(organ), complain, showPlanes });
const handlers: PlaneHandlers = {
  go,
  set: (at_mm, plane) => organs.set(at_mm, plane),
  isDrawing: (plane) => organs.isDrawing(plane),
  finish: () => organs.finish(),
};
const views = new Map(PLANES.map((plane) => [plane, new PlaneView(plane, part(plane), handlers, pictureOf)] as const));

function go(to_mm: Point): void {
  if (cross === null) return;
  cross = { ...cross, at_mm: clamped(cross.box, to_mm) };
  showPlanes();
}

function showPlanes(): void {
  if (cross === null || state === null) return;
  const marks = organs.marks();
  for (const [plane, view] of views) {
    view.load(slicePicture(plane, cross.at_mm, window_, state.version));
    view.mark(cross, marks);
    const caption = part(plane).parentElement?.querySelector("figcaption");
    if (caption != null) caption.textContent = text("patient_plane_at", { plane: text(`patient_${plane}`), at: cross.at_mm[normalAxis(plane)]!.toFixed(1) });
  }
  part("window").textContent = `${window_[0].toFixed(0)} ± ${(0.5 * window_[1]).toFixed(0)}`;
}

function setUpImage(image: ImageSummary): void {
  const box: Box = { from_mm: image.from_mm, to_mm: image.to_mm };
  cross = { box, steps_mm: image.steps_mm, at_mm: middleVoxel(box, image.steps_mm) };
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
    [text("patient_format"), image.modality === null ? image.format : `${image.format}, ${image.modality}`],
    [text("patient_voxels"), text("patient_voxels_of", { n: image.voxels.join(" × "), size: image.spacing_mm.map((x) => x.toFixed(2)).join(" × ") })],
    [text("patient_holds"), labels.length > 0 ? text("patient_n_labels", { n: labels.length }) : text("patient_values", { least, most })],
  ]);
  part("notes").replaceChildren(...image.notes.map((note) => item(note, [])));
  part("as-values").hidden = !image.are_labels_guessed;
  organs.begin();
}

/** Shows what went wrong, until the next thing is done. */
function complain(words: string | null): void {
  errorLine.hidden = words === null;
  errorLine.textContent = words ?? "";
  if (words !== null) console.warn(words);
}

function complainOf(error: unknown): void {
  complain(reasonOf(error));
}

function show(now: PatientState): void {
  const isNew = state === null || state.version !== now.version;
  state = now;
  const { image, mesh, job } = now;
  const isBusy = job !== null;
  if (!isSending) {
    const running = job?.is_cancelled === true ? text("patient_cancelling") : job?.what;
    status.textContent = job === null ? stepWords(now) : `${running}… ${job.seconds.toFixed(0)} s`;
    status.classList.toggle("busy", isBusy);
  }
  part("cancel").hidden = !isBusy || job.is_cancelled;
  part("leave").hidden = !now.can_leave;
  const progress = part<HTMLProgressElement>("progress");
  progress.hidden = !isBusy;
  progress.value = job?.share ?? 0;
  if (now.error !== shownError) {
    shownError = now.error;
    complain(now.error);
  }
  part("organ").hidden = part("planes").hidden = image === null;
  part("mesh").hidden = now.organs.length === 0;
  part("start").hidden = mesh === null;
  for (const button of document.querySelectorAll<HTMLButtonElement>("main section > button, #organs button")) button.disabled = isBusy;
  if (!isNew) return;
  const series = part("series");
  series.hidden = now.series.length === 0;
  series.replaceChildren(...now.series.map(seriesButton));
  if (image === null) return;
  if (now.image_number !== shownImage) {
    shownImage = now.image_number;
    setUpImage(image);
  }
  organs.show();
  const input = part<HTMLInputElement>("tetrahedra");
  if (input.value === "") {
    const [least, offered, most] = now.offers.tetrahedra;
    [input.min, input.max, input.value] = [String(least), String(most), String(offered)];
  }
  tetrahedra.show(now);
  options(part("model"), now.offers.models.map(({ name, about }) => ({ value: name, text: `${name}: ${about}` })));
  options(part("held"), named(now.offers.held));
  showPlanes();
}

function stepWords(now: PatientState): string {
  if (now.image === null && now.series.length > 0) return text("patient_several");
  if (now.image === null) return text("patient_waiting");
  if (now.organs.length === 0) return now.image.labels.length > 0 ? text("patient_choose_label") : text("patient_set_points");
  if (now.mesh === null) return text("patient_look_or_fill");
  return text("patient_choose_tissue");
}

function seriesButton(words: string, place: number): HTMLLIElement {
  return item("", [{ text: words, name: words, press: () => void step("open", { series: place + 1 }) }]);
}

async function step(name: Step, choice: object): Promise<void> {
  complain(null);
  try {
    await desk.post(name, choice);
    shownError = null;
    await ask();
  } catch (error) {
    complainOf(error);
  }
}

async function take(files: readonly File[]): Promise<void> {
  if (isSending) return;
  complain(null);
  if (files.length === 0) {
    complain(text("patient_no_image"));
    return;
  }
  isSending = true;
  status.classList.add("busy");
  let sent: object | undefined;
  try {
    sent = await desk.send(files, (done) => {
      status.textContent = text("patient_sending", { done, n: files.length });
    });
  } catch (error) {
    complainOf(error);
  }
  isSending = false;
  if (sent !== undefined) await step("open", sent);
}

let timer: number | undefined;
let isAsking = false;

/** Asks how far the patient is, and again after a while. */
async function ask(): Promise<void> {
  // The question under way is asked again soon enough.
  if (isAsking) return;
  clearTimeout(timer);
  isAsking = true;
  try {
    const now = await desk.state();
    show(now);
    if (now.started) {
      await goOn(text("patient_starting"));
      return;
    }
  } catch (error) {
    if (await desk.isOver()) {
      await desk.goOn();
      return;
    }
    status.textContent = desk.silence(error);
    console.warn(error);
  }
  isAsking = false;
  timer = window.setTimeout(() => void ask(), state?.job != null ? ASK_BUSY_MS : ASK_IDLE_MS);
}

/** What comes after this page takes its place. */
async function goOn(words: string): Promise<void> {
  clearTimeout(timer);
  status.textContent = words;
  await desk.goOn();
}

/** Back to the start page, without a simulation. */
async function leave(): Promise<void> {
  try {
    await desk.post("leave", {});
    await goOn(text("patient_going_back"));
  } catch (error) {
    complainOf(error);
  }
}

/** What the scene is to be. */
function sceneChoice(): object {
  const value = (id: string): string => part<HTMLSelectElement>(id).value;
  return { tissues: tetrahedra.tissues(), model: value("model"), held: value("held") };
}

/** Shows the page, whose steps `doer` does. */
export function startPatientPage(doer: Desk): void {
  desk = doer;
  translatePage();
  document.querySelector("header")?.append(languageChoice());
  part("as-values").addEventListener("click", () => void step("values", {}));
  part("cancel").addEventListener("click", () => void step("cancel", {}));
  part("leave").addEventListener("click", () => void leave());
  part("fill").addEventListener("click", () => {
    void step("mesh", { tetrahedra: Math.round(part<HTMLInputElement>("tetrahedra").valueAsNumber) || 0 });
  });
  part("run").addEventListener("click", () => void step("start", sceneChoice()));
  part("save").addEventListener("click", () => {
    complain(null);
    desk.save?.(sceneChoice()).catch(complainOf);
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
    const { target } = event;
    const isTyping = (target instanceof HTMLInputElement && ["number", "text"].includes(target.type)) || target instanceof HTMLSelectElement;
    if (isTyping || event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    if (event.key === "Escape" && state?.job != null) void step("cancel", {});
    if (state?.image != null) organs.key(event.key.toLowerCase());
  });
  part("save").hidden = desk.save === undefined;
  void ask();
}
