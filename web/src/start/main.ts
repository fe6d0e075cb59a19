/** The page that one begins with: a task, a scene or a new patient is chosen, made, and comes at the same address. */
import "../style.css";
import "./start.css";
import { languageChoice, text, translatePage } from "../language";
import { fetchServed, openServed, type Making } from "../served";
import { sceneItem, sessionItem, taskItem } from "./lists";
import { begin, fetchOffers, type Wanted } from "./offers";

/** How often the program is asked, while something is started and else [ms]: another page may start something. */
const ASK_BUSY_MS = 250;
const ASK_IDLE_MS = 2000;

function part<T extends HTMLElement = HTMLElement>(id: string): T {
  const node = document.getElementById(id);
  if (node === null) throw new Error(`start.html has no element "${id}"`);
  return node as T;
}

/** Who comes first has control of the instruments: pages that did not start it leave the one that did so long [ms]. */
const OTHERS_WAIT_MS = 3000;

/** What is being started was asked for here. */
let isOurs = false;
/** What this page was refused, until it asks for something else. */
let refused: string | null = null;
let timer: number | undefined;

function showProblem(error: string | null): void {
  const node = part("error");
  const words = error === null ? (refused === null ? null : text("start_refused", { why: refused })) : error;
  node.hidden = words === null;
  if (node.textContent !== (words ?? "")) node.textContent = words ?? "";
}

function showMaking(job: Making | null, words: string | null): void {
  const isBusy = job !== null || words !== null;
  part("making").hidden = !isBusy;
  const values = job === null ? {} : { what: job.what, seconds: job.seconds.toFixed(0) };
  part("status").textContent = words ?? (job === null ? "" : text(job.is_cancelled ? "start_cancelling" : "start_making", values));
  const progress = part<HTMLProgressElement>("progress");
  // A share of 0 is none that was told.
  if (job !== null && job.share > 0) progress.value = job.share;
  else progress.removeAttribute("value");
  part("cancel").hidden = job === null || job.is_cancelled;
  for (const button of document.querySelectorAll<HTMLButtonElement>("button.begins")) button.disabled = isBusy;
}

/** Asks how far it is, and again after a while; what comes after this page is loaded. */
async function ask(): Promise<void> {
  clearTimeout(timer);
  const now = await fetchServed();
  if (now !== null && now.page !== "start") {
    showMaking(null, text("start_opening"));
    window.setTimeout(openServed, isOurs ? 0 : OTHERS_WAIT_MS);
    return;
  }
  if (now === null) showMaking(null, text("start_lost"));
  else {
    showMaking(now.job, now.is_ready ? text("start_opening") : null);
    showProblem(now.error);
    if (now.job === null && !now.is_ready) isOurs = false;
  }
  const isBusy = now === null || now.job !== null || now.is_ready;
  timer = window.setTimeout(() => void ask(), isBusy ? ASK_BUSY_MS : ASK_IDLE_MS);
}

async function choose(what: Wanted, choice: object): Promise<void> {
  refused = null;
  try {
    await begin(what, choice);
    isOurs = what !== "cancel" && what !== "set_aside";
    if (what === "set_aside") await list();
  } catch (error) {
    refused = error instanceof Error ? error.message : String(error);
  }
  await ask();
}

async function list(): Promise<void> {
  try {
    const { tasks, sessions, scenes, folders, is_cut } = await fetchOffers();
    const start = (what: Wanted, choice: object): void => void choose(what, choice);
    part("cut-off").hidden = sessions.length === 0;
    part("sessions").replaceChildren(...sessions.map((session) => sessionItem(session, start)));
    part("tasks").replaceChildren(...tasks.map((task) => taskItem(task, start)));
    part("scenes").replaceChildren(...scenes.map((scene) => sceneItem(scene, start)));
    part("scenes-about").textContent = text("start_scenes_about", { folders: folders.join(", ") });
    const note = part("scenes-note");
    note.hidden = scenes.length > 0 && !is_cut;
    note.textContent = text(is_cut ? "start_scenes_cut" : "start_no_scenes");
  } catch (error) {
    refused = error instanceof Error ? error.message : String(error);
    showProblem(null);
  }
}

/** Up and down go from one thing that can be started to the next. */
function step(by: 1 | -1): boolean {
  const all = [...document.querySelectorAll<HTMLButtonElement>("button.begins:not(:disabled):not(.second)")];
  const at = all.findIndex((button) => button === document.activeElement || button.parentElement?.contains(document.activeElement));
  const next = all[at < 0 ? (by > 0 ? 0 : all.length - 1) : at + by];
  next?.focus();
  next?.scrollIntoView({ block: "nearest" });
  return next !== undefined;
}

document.title = text("start_title");
translatePage();
part("language").append(languageChoice());
part("cancel").addEventListener("click", () => void choose("cancel", {}));
part("patient").addEventListener("click", () => void choose("patient", {}));
part("again").addEventListener("click", () => void list().then(ask));
window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target instanceof HTMLSelectElement) return;
  if (event.key === "Escape" && !part("cancel").hidden) void choose("cancel", {});
  else if ((event.key === "ArrowDown" && step(1)) || (event.key === "ArrowUp" && step(-1))) event.preventDefault();
});
void list().then(ask);
