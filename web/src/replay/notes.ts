/** What who watched a session kept of it: moments to come back to, and what was drawn on the tissue. */
import { fail, fieldsOf, numberAt, stringAt, vec3At, type Vec3 } from "../fields";

export interface Bookmark {
  readonly time_s: number;
  /** What it is about; may be empty. */
  readonly text: string;
}

/** From a moment on something more is drawn, or nothing any longer. */
interface DrawingChange {
  readonly time_s: number;
  /** A place, or the points of a stroke, at rest; null where all went. */
  readonly points_m: readonly Vec3[] | null;
}

/** Of more drawings the oldest goes, as in the class. */
const MOST_DRAWN = 100;

export interface Notes {
  /** In the order of their times, one a moment. */
  readonly bookmarks: readonly Bookmark[];
  readonly drawings: readonly DrawingChange[];
}

/** Bookmarks in the order of their times; of those of one moment the last one. */
export function inOrder(bookmarks: readonly Bookmark[]): Bookmark[] {
  const ofMoment = new Map(bookmarks.map((bookmark) => [bookmark.time_s, bookmark]));
  return [...ofMoment.values()].sort((a, b) => a.time_s - b.time_s);
}

function pointsAt(value: unknown): Vec3[] {
  if (!Array.isArray(value) || value.length === 0) fail("notes.points_m is no list of points");
  return (value as unknown[]).map((point) => vec3At({ point }, "point", "notes.points_m"));
}

/** Decodes the notes of a recording; recordings of before had none. @throws ProtocolError */
export function decodeNotes(value: unknown): Notes {
  if (value == null) return { bookmarks: [], drawings: [] };
  if (!Array.isArray(value)) fail("recording.notes must be an array");
  const bookmarks: Bookmark[] = [];
  const drawings: DrawingChange[] = [];
  for (const item of value as unknown[]) {
    const note = fieldsOf(item, "recording.notes");
    const time_s = numberAt(note, "time_s", "notes", 0);
    if (note.kind === "bookmark") bookmarks.push({ time_s, text: stringAt(note, "text", "notes") });
    else if (note.kind === "drawing") drawings.push({ time_s, points_m: pointsAt(note.points_m) });
    else if (note.kind === "erased") drawings.push({ time_s, points_m: null });
    else fail(`recording.notes has "${String(note.kind)}"; it may have bookmark, drawing and erased`);
  }
  return { bookmarks: inOrder(bookmarks), drawings };
}

/** What is drawn on the tissue at a time. */
export function drawnAt({ drawings }: Notes, time_s: number): ReadonlyArray<readonly Vec3[]> {
  const now = drawings.filter((change) => change.time_s <= time_s + 1e-4);
  const from = now.findLastIndex(({ points_m }) => points_m === null) + 1;
  return now.slice(from).slice(-MOST_DRAWN).flatMap(({ points_m }) => (points_m === null ? [] : [points_m]));
}
