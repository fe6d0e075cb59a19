/** Those who watch together: who they are, who controls, and what who teaches does. The server decides who that is. */
import { fail, fieldsOf, numberAt, stringAt, vec3At, type Vec3 } from "./fields";
import { text } from "./language";
import type { ClientMessage } from "./protocol";

export interface Person {
  readonly number: number;
  readonly name: string;
  readonly isTeacher: boolean;
  /** Where this one points, on the tissue at rest [m]. */
  readonly pointsAt_m: Vec3 | null;
}

export interface ClassNews {
  readonly type: "class";
  readonly you: number;
  /** Number of who controls. */
  readonly controls: number | null;
  readonly people: readonly Person[];
}

export interface MarksNews {
  readonly type: "marks";
  /** Each a place or the points of a stroke, on the tissue at rest [m]. */
  readonly marks: ReadonlyArray<readonly Vec3[]>;
}

type Fields = Record<string, unknown>;

function listAt(fields: Fields, key: string, what: string): readonly Fields[] {
  const list = fields[key];
  if (!Array.isArray(list)) fail(`${what}.${key} is no list`);
  return (list as unknown[]).map((item) => fieldsOf(item, `${what}.${key}`));
}

/** @throws ProtocolError naming the field that is wrong. */
export function decodeClass(fields: Fields): ClassNews {
  const people = listAt(fields, "people", "class").map((person) => ({
    number: numberAt(person, "number", "class.people", 0),
    name: stringAt(person, "name", "class.people"),
    isTeacher: person.is_teacher === true,
    pointsAt_m: person.points_at_m === null ? null : vec3At(person, "points_at_m", "class.people"),
  }));
  const controls = fields.controls === null ? null : numberAt(fields, "controls", "class", 0);
  return { type: "class", you: numberAt(fields, "you", "class", 0), controls, people };
}

/** @throws ProtocolError naming the field that is wrong. */
export function decodeMarks(fields: Fields): MarksNews {
  const marks = listAt(fields, "marks", "marks").map((mark) => {
    const { points_m } = mark;
    if (!Array.isArray(points_m) || points_m.length === 0) fail("marks.points_m is no list of points");
    return (points_m as unknown[]).map((point) => vec3At({ point }, "point", "marks.points_m"));
  });
  return { type: "marks", marks };
}

/** What a person is called: those without a name are numbered. */
export function nameOf({ name, number, isTeacher }: Person): string {
  const shown = name === "" ? text("class_nameless", { number }) : name;
  return isTeacher ? text("class_teacher", { name: shown }) : shown;
}

export interface ClassEvents {
  send(message: ClientMessage): void;
  /** Drawing begins or ends. */
  draws(on: boolean): void;
}

const NAME_KEY = "glisson_name";

/** The list and its buttons. */
export class Classroom {
  private news: ClassNews | null = null;
  private readonly list = document.createElement("ul");
  private readonly name = document.createElement("input");
  private readonly buttons: Record<"take" | "draw" | "erase", HTMLButtonElement>;
  drawing = false;

  constructor(
    private readonly root: HTMLElement,
    private readonly events: ClassEvents,
  ) {
    const title = document.createElement("h2");
    title.textContent = text("class_title");
    const label = document.createElement("label");
    label.textContent = text("class_name");
    this.name.maxLength = 40;
    this.name.value = localStorage.getItem(NAME_KEY) ?? "";
    this.name.addEventListener("change", () => this.introduce());
    // Then keys are those of the simulation again.
    this.name.addEventListener("keydown", (event) => event.key === "Enter" && this.name.blur());
    label.append(this.name);
    const button = (press: () => void): HTMLButtonElement => {
      const made = document.createElement("button");
      made.type = "button";
      made.addEventListener("click", (event) => {
        press();
        // After a mouse click the space bar should pause again, not press this button.
        if (event.detail > 0) made.blur();
      });
      return made;
    };
    this.buttons = { take: button(() => this.take()), draw: button(() => this.draw()), erase: button(() => this.erase()) };
    this.buttons.draw.textContent = text("class_draw");
    this.buttons.erase.textContent = text("class_erase");
    const row = document.createElement("div");
    row.append(...Object.values(this.buttons));
    root.append(title, this.list, label, row);
    root.hidden = true;
  }

  /** Of each connection anew. */
  private introduce(): void {
    const name = this.name.value.trim();
    localStorage.setItem(NAME_KEY, name);
    if (name !== "" || this.own?.name) this.events.send({ type: "introduce", name });
  }

  private get own(): Person | null {
    return this.news?.people.find(({ number }) => number === this.news?.you) ?? null;
  }

  get teaches(): boolean {
    return this.own?.isTeacher ?? false;
  }

  /** The others that point somewhere. */
  get pointing(): readonly Vec3[] {
    const others = this.news?.people.filter(({ number }) => number !== this.news?.you) ?? [];
    return others.flatMap(({ pointsAt_m }) => (pointsAt_m === null ? [] : [pointsAt_m]));
  }

  show(news: ClassNews): void {
    const isNew = this.news?.you !== news.you;
    this.news = news;
    if (isNew) this.introduce();
    const { people, controls, you } = news;
    // Who is alone and does not teach has no use for it.
    this.root.hidden = people.length < 2 && !this.teaches;
    this.list.replaceChildren(
      ...people.map((person) => {
        const item = document.createElement("li");
        const words = [nameOf(person)];
        if (person.number === you) words.push(text("class_you"));
        if (person.number === controls) words.push(text("class_controls"));
        item.textContent = words.join(" · ");
        return item;
      }),
    );
    Object.values(this.buttons).forEach((button) => (button.hidden = !this.teaches));
    this.buttons.take.textContent = text(controls === you ? "class_give_back" : "class_take_over");
    if (!this.teaches && this.drawing) this.draw();
  }

  /** Takes control over, or gives it back. */
  take(): void {
    if (this.teaches) this.events.send({ type: this.news?.controls === this.news?.you ? "give_back" : "take_over" });
  }

  /** The pointer draws from now on, or no longer. */
  draw(): void {
    if (!this.teaches && !this.drawing) return;
    this.drawing = !this.drawing;
    this.buttons.draw.setAttribute("aria-pressed", String(this.drawing));
    this.events.draws(this.drawing);
  }

  erase(): void {
    if (this.teaches) this.events.send({ type: "erase" });
  }
}
