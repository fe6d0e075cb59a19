/** The list of a task's stages and of the moments that went wrong: each is a button that jumps there. */
import { text } from "../language";
import { clockText } from "../task";
import { COLOURS, element, entryButton, LETTERS } from "./entry";
import { endingText, type Story } from "./story";

interface Entry {
  readonly from_s: number;
  readonly to_s: number;
  readonly button: HTMLButtonElement;
}

/** Where what is told of one of two recordings is listed: in a part that is shut, for it lies over a picture. */
export function storyOf(story: HTMLElement, recording: number): HTMLElement {
  const both = story.querySelector("details") ?? story.appendChild(document.createElement("details"));
  story.setAttribute("aria-label", text("replay_both_tasks"));
  if (recording === 0) both.append(element("summary", "", text("replay_both_tasks")));
  const part = element("section", "story-part");
  part.style.setProperty("--colour", COLOURS[recording]);
  part.dataset.letter = `${LETTERS[recording]} `;
  part.style.setProperty("--letter", `"${LETTERS[recording]} "`);
  both.append(part);
  return part;
}

export class MomentList {
  private readonly entries: Entry[] = [];

  constructor(root: HTMLElement, story: Story | null, jump: (time_s: number, tool: number | null) => void) {
    root.hidden = story === null;
    if (story === null) return;
    root.setAttribute("aria-label", text("replay_task", { title: (root.dataset.letter ?? "") + story.title }));
    const ending = element("p", "story-ending", endingText(story));
    ending.dataset.passed = String(story.isPassed);
    root.append(element("h2", "", story.title), ending);
    const entry = (from_s: number, to_s: number, title: string, detail: string, tool: number | null): HTMLElement => {
      const button = entryButton(clockText(from_s), title, () => jump(from_s, tool), detail);
      this.entries.push({ from_s, to_s, button });
      const item = document.createElement("li");
      item.append(button);
      return item;
    };
    const list = (title: string, className: string, items: readonly HTMLElement[], none: string): void => {
      root.append(element("h3", "", title));
      if (items.length === 0) return root.append(element("p", "dim", none));
      const node = element("ol", className);
      node.setAttribute("aria-label", title);
      node.append(...items);
      root.append(node);
    };
    const { stages, moments } = story;
    list(text("replay_stages"), "stages", stages.map(({ began_s, ended_s, title }) => entry(began_s, ended_s, title, `${(ended_s - began_s).toFixed(1)} s`, null)), text("replay_none_done"));
    list(text("replay_wrong"), "moments", moments.map(({ from_s, to_s, title, detail, tool }) => entry(from_s, to_s, title, detail, tool)), text("replay_nothing"));
  }

  /** Marks what is going on. */
  show(time_s: number): void {
    for (const { from_s, to_s, button } of this.entries) {
      const isNow = time_s >= from_s - 1e-3 && time_s < Math.max(to_s, from_s + 0.1) - 1e-3;
      if (isNow === button.hasAttribute("aria-current")) continue;
      if (isNow) button.setAttribute("aria-current", "step");
      else button.removeAttribute("aria-current");
    }
  }
}
