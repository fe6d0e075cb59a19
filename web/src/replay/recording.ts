/**
 * A recording "GLSR" (docs/replay.md): its head is read at once; blocks of frames are unpacked when they are looked at. Frames
 * come out as the messages of docs/protocol.md, so that all that draws the live page draws them too.
 */
import { fail, fieldsOf, numberAt, type Fields } from "../fields";
import { decodeBinary, decodeText, type Hello, type Snapshot, type Topology } from "../protocol";
import { Taker } from "../bytes";
import { expectedPlaces, NO_SURFACE, takeSurface, topologyOf, type Surface } from "./surface";
import { decodeNotes, type Notes } from "./notes";
import { decodeStory, type Story } from "./story";

const HEAD_BYTES = 12;
const VERSION = 1;
/** Where a SNAPSHOT frame says how many vertices it has. */
const N_VERTICES_AT = 56;
/** Blocks that stay unpacked. */
const MOST_KEPT = 6;
/** Frames that stay decoded: the one that is shown, and the next. */
const MOST_RECENT = 3;

/** What is shown at a time. */
export interface Shown {
  readonly snapshot: Snapshot;
  /** With another version when the surface is another. */
  readonly topology: Topology;
}

interface Block {
  readonly first: number;
  readonly end: number;
  readonly packed: Uint8Array;
  readonly rawBytes: number;
}

/** A frame within its unpacked block, from where the next one is taken. */
interface Cursor {
  readonly block: number;
  readonly from: Taker;
  frame: number;
  surface: Surface;
  places: Int32Array;
  head: Uint8Array;
  tail: Uint8Array;
}

async function unpack(packed: Uint8Array, most: number): Promise<Uint8Array> {
  const stream = new Blob([packed as Uint8Array<ArrayBuffer>]).stream().pipeThrough(new DecompressionStream("deflate"));
  const parts: Uint8Array[] = [];
  let n = 0;
  for (const reader = stream.getReader(); ; ) {
    const { done, value } = await reader.read();
    if (done) break;
    n += value.length;
    if (n > most) fail("the recording is broken: a part is larger than it says");
    parts.push(value);
  }
  const whole = new Uint8Array(n);
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}

function numbersAt(fields: Fields, name: string): number[] {
  const value = fields[name];
  if (!Array.isArray(value) || !value.every((x) => Number.isFinite(x))) fail(`recording.${name} must be an array of numbers`);
  return value as number[];
}

function rowsAt(fields: Fields, name: string): number[][] {
  const value = fields[name];
  if (!Array.isArray(value)) fail(`recording.${name} must be an array`);
  return value.map((row: unknown) => numbersAt({ [name]: row }, name));
}

/** The last of ascending times that is not after `time_s`; the first where all are. */
export function frameIn(times_s: readonly number[], time_s: number): number {
  let [low, high] = [0, times_s.length];
  // Times are rounded to a ten-thousandth.
  while (high - low > 1) {
    const middle = (low + high) >>> 1;
    if (times_s[middle] <= time_s + 1e-4) low = middle;
    else high = middle;
  }
  return low;
}

/** A part of a recording that is unpacked may have [bytes]; as in the program that writes it. */
const MOST_UNPACKED = 2 ** 28;

export class Recording {
  readonly rate_hz: number;
  readonly step_m: number;
  /** Of each frame. */
  readonly times_s: readonly number[];
  /** Size of the force on each instrument, frame by frame [N]. */
  readonly forces_n: readonly (readonly number[])[];
  /** What the session is called; empty where nothing is beside it. */
  readonly name: string;
  readonly story: Story | null;
  readonly notes: Notes;
  private readonly hellos: ReadonlyArray<{ readonly first: number; readonly hello: Hello }>;
  private readonly blocks: readonly Block[];
  /** Unpacked blocks, those that were looked at last behind. */
  private readonly raw = new Map<number, Uint8Array>();
  private readonly coming = new Set<number>();
  private readonly wholes = new Map<number, Surface>();
  private readonly topologies = new WeakMap<Surface, Topology>();
  private cursor: Cursor | null = null;
  /** The frames that were looked at last. */
  private readonly recent = new Map<number, Shown>();

  /** Reads a recording. @throws ProtocolError */
  static async read(bytes: Uint8Array): Promise<Recording> {
    if (bytes.length < HEAD_BYTES || String.fromCharCode(...bytes.subarray(0, 4)) !== "GLSR") fail("this is no recording: it does not begin with GLSR");
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const version = view.getUint32(4, true);
    if (version !== VERSION) fail(`the recording has version ${version} of the format, this page plays ${VERSION}`);
    const from = new Taker(bytes.subarray(HEAD_BYTES));
    const head = await unpack(from.bytes(view.getUint32(8, true)), MOST_UNPACKED);
    return new Recording(fieldsOf(JSON.parse(new TextDecoder().decode(head)), "recording"), from);
  }

  private constructor(head: Fields, from: Taker) {
    this.rate_hz = numberAt(head, "rate_hz", "recording", 0);
    this.step_m = numberAt(head, "step_m", "recording", 0);
    this.times_s = numbersAt(head, "time_s");
    this.forces_n = rowsAt(head, "force_n");
    this.name = typeof head.name === "string" ? head.name : "";
    this.story = decodeStory(head.task);
    this.notes = decodeNotes(head.notes);
    if (!Array.isArray(head.hellos) || head.hellos.length === 0) fail("recording.hellos must be an array of one or more");
    this.hellos = head.hellos.map((item: unknown) => {
      const entry = fieldsOf(item, "recording.hellos");
      const hello = decodeText(JSON.stringify(entry.hello));
      if (hello.type !== "hello") fail("recording.hellos has something else");
      return { first: numberAt(entry, "first_frame", "recording.hellos", 0), hello };
    });
    const rows = rowsAt(head, "blocks");
    this.blocks = rows.map(([first, n, rawBytes], i) => {
      const end = rows[i + 1]?.[0] ?? this.nFrames;
      if (!(first < end && rawBytes <= MOST_UNPACKED && (i > 0 || first === 0))) fail("recording.blocks makes no sense");
      return { first, end, packed: from.bytes(n), rawBytes };
    });
    if (this.nFrames === 0 || this.forces_n.length !== this.nFrames || this.blocks.length === 0) fail("the recording has no frames");
  }

  get nFrames(): number {
    return this.times_s.length;
  }

  get begin_s(): number {
    return this.times_s[0];
  }

  get end_s(): number {
    return this.times_s[this.nFrames - 1];
  }

  /** The last frame that is not after `time_s`. */
  frameAt(time_s: number): number {
    return frameIn(this.times_s, time_s);
  }

  /** The scene at a frame; the same object as long as it is the same. */
  helloAt(frame: number): Hello {
    return (this.hellos.findLast(({ first }) => first <= frame) ?? this.hellos[0]).hello;
  }

  /** Unpacks what frame `frame` is in. @throws ProtocolError */
  async load(frame: number): Promise<void> {
    const number = this.blocks.findLastIndex(({ first }) => first <= frame);
    await this.loadBlock(number);
    if (this.wholes.has(number)) return;
    const from = new Taker(this.raw.get(number)!);
    const at = from.number();
    if (at > number) fail("the recording is broken: a block has no surface");
    if (at < number) {
      if (!this.wholes.has(at)) await this.load(this.blocks[at].first);
      this.wholes.set(number, this.wholes.get(at)!);
      await this.loadBlock(number);
    } else {
      this.wholes.set(number, takeSurface(NO_SURFACE, from));
    }
  }

  private async loadBlock(number: number): Promise<void> {
    const kept = this.raw.get(number);
    const { packed, rawBytes } = this.blocks[number];
    const raw = kept ?? (await unpack(packed, rawBytes));
    this.raw.delete(number);
    this.raw.set(number, raw);
    const [oldest] = this.raw.keys();
    if (this.raw.size > MOST_KEPT) this.raw.delete(oldest);
  }

  /** What is shown at a frame; null while that is not unpacked: `ready` is called when it is, `failed` when it cannot be. */
  at(frame: number, ready: () => void, failed: (error: unknown) => void): Shown | null {
    const recent = this.recent.get(frame);
    if (recent !== undefined) return recent;
    const number = this.blocks.findLastIndex(({ first }) => first <= frame);
    const isReady = this.cursor?.block === number && this.cursor.frame <= frame;
    if (!isReady && !(this.raw.has(number) && this.wholes.has(number))) {
      this.fetch(number, ready, failed);
      return null;
    }
    // What comes next is unpacked before it is needed.
    if (number + 1 < this.blocks.length && !this.raw.has(number + 1)) this.fetch(number + 1, () => undefined, failed);
    const shown = this.decode(number, frame);
    this.recent.set(frame, shown);
    const [oldest] = this.recent.keys();
    if (this.recent.size > MOST_RECENT) this.recent.delete(oldest);
    return shown;
  }

  private fetch(number: number, ready: () => void, failed: (error: unknown) => void): void {
    if (this.coming.has(number)) return;
    this.coming.add(number);
    const done = (): boolean => this.coming.delete(number);
    this.load(this.blocks[number].first).then(() => { done(); ready(); }, (error: unknown) => { done(); failed(error); });
  }

  private decode(number: number, frame: number): Shown {
    let cursor = this.cursor;
    // One that something broken stopped is not gone on with.
    this.cursor = null;
    if (cursor === null || cursor.block !== number || cursor.frame > frame) {
      const from = new Taker(this.raw.get(number)!);
      const whole = this.wholes.get(number)!;
      if (from.number() === number) takeSurface(NO_SURFACE, from);
      cursor = { block: number, from, frame: this.blocks[number].first - 1, surface: whole, places: whole.rest.slice(), head: new Uint8Array(), tail: new Uint8Array() };
    }
    while (cursor.frame < frame) this.advance(cursor);
    this.cursor = cursor;
    return { snapshot: this.snapshotOf(cursor), topology: this.topologyFor(cursor.surface) };
  }

  private advance(cursor: Cursor): void {
    const { from } = cursor;
    cursor.frame += 1;
    if (cursor.frame > this.blocks[cursor.block].first && from.byte() === 1) {
      const surface = takeSurface(cursor.surface, from);
      cursor.places = expectedPlaces(surface, cursor.surface, cursor.places);
      cursor.surface = surface;
    }
    cursor.head = from.changed(cursor.head);
    const { places } = cursor;
    for (let axis = 0; axis < 3; axis++) {
      for (let i = axis; i < places.length; i += 3) places[i] += from.signed();
    }
    cursor.tail = from.changed(cursor.tail);
  }

  private snapshotOf({ head, places, tail }: Cursor): Snapshot {
    const bytes = new Uint8Array(head.length + 4 * places.length + tail.length);
    bytes.set(head);
    const view = new DataView(bytes.buffer);
    if (head.length < N_VERTICES_AT + 4 || 3 * view.getUint32(N_VERTICES_AT, true) !== places.length) {
      fail("the recording is broken: a frame has not the vertices of its surface");
    }
    for (let i = 0; i < places.length; i++) view.setFloat32(head.length + 4 * i, places[i] * this.step_m, true);
    bytes.set(tail, head.length + 4 * places.length);
    const message = decodeBinary(bytes.buffer);
    if (message.kind !== "snapshot") fail("the recording is broken: a frame is something else");
    return message;
  }

  private topologyFor(surface: Surface): Topology {
    const known = this.topologies.get(surface);
    if (known !== undefined) return known;
    const topology = topologyOf(surface, this.step_m);
    this.topologies.set(surface, topology);
    return topology;
  }
}
