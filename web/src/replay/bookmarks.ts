/**
 * The bookmarks of a recording: those in it, and those of who looks at it, which the browser keeps for each recording and which
 * an address can bring: `session.html#t=12.3&b=12.3~text&b=15`.
 */
import type { Store } from "../settings";
import { inOrder, type Bookmark } from "./notes";

/** Letters of a text at most, as in sessions, and bookmarks of who looks on: choices. */
export const LONGEST_TEXT = 120;
const MOST_OWN = 200;
const STORED = "glisson_bookmarks_";

export interface ListedBookmark extends Bookmark {
  /** It is of who looks on, and not in the recording. */
  readonly isOwn: boolean;
}

/** A text without what cannot be seen, no longer than it may be. */
function cleanText(text: string): string {
  // eslint-disable-next-line no-control-regex
  return [...text.replace(/[\u0000-\u001f\u007f-\u009f]/g, " ").trim()].slice(0, LONGEST_TEXT).join("");
}

/** A number of a recording that others do not have, most likely: FNV-1a of 32 bits over its beginning. */
export function nameOfRecording(bytes: Uint8Array): string {
  let hash = 0x811c9dc5;
  for (const byte of bytes.subarray(0, 4096)) hash = Math.imul(hash ^ byte, 0x01000193);
  return `${bytes.length}-${(hash >>> 0).toString(16)}`;
}

const timeOf = (text: string): number | null => (/^\d+(\.\d+)?$/.test(text) ? Number(text) : null);

/** The bookmarks that an address brings. */
export function bookmarksInFragment(fragment: string): Bookmark[] {
  return new URLSearchParams(fragment.replace(/^#/, "")).getAll("b").flatMap((entry) => {
    const [time, ...words] = entry.split("~");
    const time_s = timeOf(time);
    return time_s === null ? [] : [{ time_s, text: cleanText(words.join("~")) }];
  });
}

/** The end of an address that begins at `time_s` and brings `bookmarks`. */
export function fragmentOf(time_s: number, bookmarks: readonly Bookmark[]): string {
  const fields = new URLSearchParams({ t: time_s.toFixed(2) });
  for (const { time_s: at_s, text } of bookmarks) fields.append("b", text === "" ? String(at_s) : `${at_s}~${text}`);
  return `#${fields.toString()}`;
}

/** What of a text in the browser's memory are bookmarks. */
function stored(text: string | null): Bookmark[] {
  try {
    const list: unknown = JSON.parse(text ?? "[]");
    if (!Array.isArray(list)) return [];
    return (list as unknown[]).flatMap((item) => {
      const { time_s, text: words } = (item ?? {}) as Record<string, unknown>;
      return typeof time_s === "number" && Number.isFinite(time_s) && typeof words === "string" ? [{ time_s, text: cleanText(words) }] : [];
    });
  } catch {
    return [];
  }
}

export class Bookmarks {
  private own: Bookmark[];

  constructor(
    /** Those in the recording. */
    private readonly recorded: () => readonly Bookmark[],
    private readonly name: string,
    private readonly end_s: number,
    /** Null where the browser keeps nothing. */
    private readonly memory: Store | null,
  ) {
    this.own = stored(memory?.getItem(STORED + name) ?? null);
  }

  /** All of them in the order of their times; where one is in the recording and of who looks on, the latter. */
  get all(): ListedBookmark[] {
    const listed = (isOwn: boolean) => (bookmark: Bookmark): ListedBookmark => ({ ...bookmark, isOwn });
    return inOrder([...this.recorded().map(listed(false)), ...this.own.map(listed(true))]) as ListedBookmark[];
  }

  get ofViewer(): readonly Bookmark[] {
    return this.own;
  }

  /** Adds one, or gives the one of that moment another text. Answers its time, which is one of a hundredth of a second. */
  set(time_s: number, text: string): number {
    const at_s = Math.round(100 * time_s) / 100;
    this.own = inOrder([...this.own, { time_s: at_s, text: cleanText(text) }]).slice(0, MOST_OWN);
    this.keep();
    return at_s;
  }

  remove(time_s: number): void {
    this.own = this.own.filter((bookmark) => bookmark.time_s !== time_s);
    this.keep();
  }

  /** Takes what an address brings; answers whether it brought something. */
  take(fragment: string): boolean {
    const brought = bookmarksInFragment(fragment).filter(({ time_s }) => time_s <= this.end_s + 0.01);
    for (const { time_s, text } of brought) this.set(time_s, text);
    return brought.length > 0;
  }

  private keep(): void {
    try {
      this.memory?.setItem(STORED + this.name, JSON.stringify(this.own));
    } catch {
      // A browser that keeps nothing of files has them as long as the page is open.
    }
  }
}
