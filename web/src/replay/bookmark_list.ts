/** The list of bookmarks: each jumps there; those of who looks on can be named and taken away, and copied with an address. */
import { text } from "../language";
import { fragmentOf, LONGEST_TEXT, type Bookmarks, type ListedBookmark } from "./bookmarks";
import { element, entryButton } from "./entry";
import { timeText } from "./timeline";

export interface BookmarkListEvents {
  jump(time_s: number): void;
  /** Another one is there, or one is not any more. */
  changed(): void;
  /** The time that is shown [s]. */
  now(): number;
  notice(words: string): void;
}

export class BookmarkList {
  private readonly list = element("ol", "bookmarks");

  constructor(
    private readonly root: HTMLElement,
    private readonly bookmarks: Bookmarks,
    private readonly events: BookmarkListEvents,
  ) {
    root.setAttribute("aria-label", text("replay_bookmarks"));
    this.list.setAttribute("aria-label", text("replay_bookmarks"));
    const share = element("button", "bookmarks-share", text("replay_share_bookmarks"));
    share.setAttribute("type", "button");
    share.addEventListener("click", () => this.share());
    root.append(element("h2", "", text("replay_bookmarks")), this.list, share);
    this.show();
  }

  get all(): readonly ListedBookmark[] {
    return this.bookmarks.all;
  }

  /** Marks the moment that is shown, and asks for its text. */
  mark(): void {
    const now_s = this.events.now();
    const known = this.all.find(({ time_s }) => Math.abs(time_s - now_s) < 5e-3);
    const time_s = this.bookmarks.set(known?.time_s ?? now_s, known?.text ?? "");
    this.show();
    this.events.changed();
    this.list.querySelector<HTMLInputElement>(`input[data-time="${time_s}"]`)?.focus();
  }

  /** Takes the bookmarks that an address brings. */
  take(fragment: string): void {
    if (!this.bookmarks.take(fragment)) return;
    this.show();
    this.events.changed();
  }

  /** The page's address becomes one of this moment that brings the bookmarks, and is copied where the browser allows it. */
  private share(): void {
    window.history.replaceState(null, "", fragmentOf(this.events.now(), this.bookmarks.ofViewer));
    const copied = navigator.clipboard?.writeText(window.location.href) ?? Promise.reject(new Error());
    const tell = (key: "replay_shared" | "replay_shared_copied") => (): void => this.events.notice(text(key));
    copied.then(tell("replay_shared_copied"), tell("replay_shared"));
  }

  /** Draws the list anew. */
  show(): void {
    const { all } = this.bookmarks;
    this.root.hidden = all.length === 0;
    this.list.replaceChildren(...all.map((bookmark) => this.item(bookmark)));
  }

  private item({ time_s, text: words, isOwn }: ListedBookmark): HTMLElement {
    const item = element("li", isOwn ? "own" : "");
    const time = timeText(time_s);
    const jump = entryButton(time, isOwn ? "" : words || text("replay_bookmark"), () => this.events.jump(time_s));
    item.append(jump);
    if (!isOwn) return item;
    jump.setAttribute("aria-label", text("replay_bookmark_at", { time }));
    const name = document.createElement("input");
    Object.assign(name, { type: "text", value: words, maxLength: LONGEST_TEXT, placeholder: text("replay_bookmark_text") });
    name.dataset.time = String(time_s);
    name.setAttribute("aria-label", text("replay_bookmark_text_at", { time }));
    name.addEventListener("change", () => this.bookmarks.set(time_s, name.value));
    // Then keys are those of the player again.
    name.addEventListener("keydown", ({ key }) => (key === "Enter" || key === "Escape") && name.blur());
    const remove = element("button", "", "×");
    remove.setAttribute("type", "button");
    remove.setAttribute("aria-label", text("replay_bookmark_remove", { time }));
    remove.addEventListener("click", () => {
      this.bookmarks.remove(time_s);
      this.show();
      this.events.changed();
    });
    item.append(name, remove);
    return item;
  }
}
