/** The lists of what can be started. */
import { text } from "../language";
import { clockText } from "../task";
import type { SceneOffer, SessionOffer, TaskOffer, Wanted } from "./offers";

export type Begin = (what: Wanted, choice: object) => void;

function element<K extends keyof HTMLElementTagNameMap>(name: K, className = "", words = ""): HTMLElementTagNameMap[K] {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = words;
  return node;
}

/** A button whose name tells a screen reader what it starts. */
function beginning(words: string, whole: string, press: () => void): HTMLButtonElement {
  const button = element("button", "begins", words);
  button.type = "button";
  button.setAttribute("aria-label", whole);
  button.addEventListener("click", press);
  return button;
}

/** `7 stages, at most 3:00`. */
export function taskFacts(task: Pick<TaskOffer, "stages" | "time_limit_s">): string {
  const { length } = task.stages;
  const stages = length === 1 ? text("start_one_stage") : text("start_stages", { n: length });
  return `${stages}, ${text("start_time", { time: clockText(task.time_limit_s) })}`;
}

/** A choice with a label; none where there is nothing to choose. */
function choiceOf(label: string, values: ReadonlyArray<string | number>, usual: string | number | null): HTMLSelectElement | null {
  if (values.length < 2) return null;
  const select = element("select");
  select.setAttribute("aria-label", label);
  select.title = label;
  for (const value of values) select.append(new Option(`${label}: ${value}`, String(value), false, value === usual));
  return select;
}

export function taskItem(task: TaskOffer, begin: Begin): HTMLLIElement {
  const item = element("li");
  const stages = element("ol", "stages");
  stages.append(...task.stages.map((stage) => element("li", "", stage)));
  const whole = element("details");
  whole.append(element("summary", "", taskFacts(task)), stages);
  const buttons = element("div", "buttons");
  const { name, title } = task;
  const level = choiceOf(text("start_level"), task.levels, task.level);
  const patient = choiceOf(text("start_patient_seed"), task.patients, task.patients[0] ?? null);
  const variant = (): object => ({ name, level: level?.value ?? null, patient: patient === null ? null : Number(patient.value) });
  buttons.append(beginning(text("start_go"), text("start_go_with", { what: title }), () => begin("task", variant())));
  if (task.has_demonstration) {
    const watch = beginning(text("start_watch"), text("start_watch_with", { what: title }), () => begin("task", { ...variant(), demonstrate: true }));
    watch.classList.add("second");
    buttons.append(watch);
  }
  const choices = element("div", "choices");
  choices.append(...[level, patient].filter((choice) => choice !== null));
  item.append(element("h3", "", title), element("p", "", task.about), whole, choices, buttons);
  item.dataset.task = name;
  return item;
}

export function sceneItem(scene: SceneOffer, begin: Begin): HTMLLIElement {
  const item = element("li");
  const words = element("div", "words");
  words.append(element("h3", "", scene.name ?? scene.file));
  if (scene.name !== null) words.append(element("span", "file", scene.file));
  if (scene.task !== null) words.append(element("span", "dim", text("start_has_task", { title: scene.task })));
  item.append(words);
  if (scene.error === null) {
    const whole = text("start_go_with", { what: scene.name === null ? scene.file : `${scene.name}, ${scene.file}` });
    item.append(beginning(text("start_go"), whole, () => begin("scene", { file: scene.file })));
  } else {
    words.append(element("span", "problem", text("start_broken", { error: scene.error })));
  }
  item.dataset.scene = scene.file;
  return item;
}

/** A session that was cut off: it is gone on with, or no longer offered. */
export function sessionItem({ session, title, time_s }: SessionOffer, begin: Begin): HTMLLIElement {
  const item = element("li");
  const words = element("div", "words");
  words.append(element("h3", "", title), element("span", "file", session), element("span", "dim", text("start_cut_off_at", { time: clockText(time_s) })));
  const buttons = element("div", "buttons");
  const keep = beginning(text("start_set_aside"), text("start_set_aside_what", { what: session }), () => begin("set_aside", { session }));
  keep.classList.add("second");
  buttons.append(beginning(text("start_go_on"), text("start_go_on_with", { what: session }), () => begin("session", { session })), keep);
  item.append(words, buttons);
  item.dataset.session = session;
  return item;
}
