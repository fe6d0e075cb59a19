/** The session of this visit, to be saved, and those of earlier ones that are kept. */
import { text } from "../language";
import { mayGoOn, OVER_AFTER_MS, type Kept, type KeptSession } from "./kept";
import { download } from "../download";

/** Letters, figures and hyphens of a name. */
const inFileName = (name: string): string => name.toLowerCase().replaceAll(/[^\p{L}\p{N}]+/gu, "-").replaceAll(/^-|-$/g, "");

function button(words: string, press: () => Promise<void>): HTMLButtonElement {
  const node = document.createElement("button");
  node.type = "button";
  node.textContent = words;
  node.addEventListener("click", () => {
    node.disabled = true;
    void press().finally(() => (node.disabled = false));
  });
  return node;
}

/** What the list asks of the page. */
export interface SessionEvents {
  /** Comes when all that happened up to now was recorded. */
  keep(): Promise<void>;
  /** What its scene is called. */
  name(): string;
  notice(words: string): void;
}

export class SessionList {
  private readonly root = document.createElement("section");
  private readonly words = document.createElement("p");
  private readonly list = document.createElement("ul");
  /** This visit's, by a number of its own. */
  private readonly begun_ms = Date.now();
  private readonly id = this.begun_ms + Math.random();
  /** What is not kept yet: what the storage refuses is tried again before what comes after it. */
  private readonly pieces: { readonly bytes: Uint8Array; readonly from: number }[] = [];
  private writing: Promise<void> = Promise.resolve();

  /** `kept`: null where the browser gives no storage. */
  constructor(parent: HTMLElement, private readonly kept: Kept | null, private readonly events: SessionEvents) {
    this.root.className = "kept";
    this.root.setAttribute("aria-label", text("local_sessions"));
    this.words.setAttribute("role", "status");
    this.words.textContent = text("local_making");
    this.root.append(this.words, this.list);
    parent.append(this.root);
    this.refresh();
    // What another page does not record any more can be forgotten then.
    setTimeout(() => this.refresh(), OVER_AFTER_MS + 1000);
  }

  /** The scene is made, and its time passes. */
  opened(): void {
    this.words.textContent = text(this.kept === null ? "local_not_kept" : "local_kept");
  }

  /** What this page's simulation recorded, from a byte on. */
  recorded(bytes: Uint8Array, from: number): void {
    if (this.kept === null) return;
    this.pieces.push({ bytes, from });
    this.writing = this.writing.then(() => this.write(this.kept!));
  }

  private async write(kept: Kept): Promise<void> {
    try {
      for (let piece = this.pieces[0]; piece !== undefined; piece = this.pieces[0]) {
        const session = { id: this.id, name: this.events.name(), begun_ms: this.begun_ms, kept_ms: Date.now() };
        await kept.add(session, piece.bytes, piece.from);
        this.pieces.shift();
        if (piece.from === 0) this.refresh();
      }
    } catch (error) {
      this.events.notice(text("local_storage_failed", { reason: String(error) }));
    }
  }

  private refresh(): void {
    this.show().catch((error: unknown) => this.events.notice(text("local_storage_failed", { reason: String(error) })));
  }

  private async show(): Promise<void> {
    if (this.kept === null) return;
    const sessions = await this.kept.list();
    this.list.replaceChildren(...sessions.reverse().map((session) => this.line(this.kept!, session)));
  }

  private line(kept: Kept, session: KeptSession): HTMLElement {
    const { id, name, begun_ms } = session;
    const isOwn = id === this.id;
    const line = document.createElement("li");
    const words = document.createElement("span");
    words.textContent = isOwn ? text("local_this_session") : text("local_earlier_session", { name, when: new Date(begun_ms).toLocaleString() });
    const date = new Date(begun_ms).toISOString().slice(0, 19).replaceAll(/[:T]/g, "-");
    const press = async (): Promise<void> => {
      if (isOwn) await this.events.keep().then(() => this.writing);
      download(await kept.session(id), `${inFileName(name)}-${date}.jsonl`);
    };
    line.append(words, button(text("local_save"), press));
    // Another page may be recording it.
    if (!isOwn && !mayGoOn(session, Date.now())) {
      line.append(button(text("local_forget"), async () => {
        await kept.forget(id);
        this.refresh();
      }));
    }
    return line;
  }
}
