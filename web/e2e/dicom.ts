/** Writes the slices of a NIfTI volume as a DICOM series, explicit little endian (PS3.5, PS3.10), in no order of names. */
import { readFileSync } from "node:fs";
import { gunzipSync } from "node:zlib";

export interface NamedFile {
  readonly name: string;
  readonly mimeType: string;
  readonly buffer: Buffer;
}

const LONG_LENGTH = new Set(["OB", "OW", "UN", "SQ"]);

function element(tag: number, vr: string, value: Buffer): Buffer {
  const padding = value.length % 2 === 0 ? [] : [Buffer.from(vr === "UI" ? "\0" : " ")];
  const body = Buffer.concat([value, ...padding]);
  const isLong = LONG_LENGTH.has(vr);
  const head = Buffer.alloc(isLong ? 12 : 8);
  head.writeUInt16LE(tag >>> 16, 0);
  head.writeUInt16LE(tag & 0xffff, 2);
  head.write(vr, 4, "ascii");
  if (isLong) head.writeUInt32LE(body.length, 8);
  else head.writeUInt16LE(body.length, 6);
  return Buffer.concat([head, body]);
}

const text = (tag: number, vr: string, value: string): Buffer => element(tag, vr, Buffer.from(value, "ascii"));

function short(tag: number, value: number): Buffer {
  const bytes = Buffer.alloc(2);
  bytes.writeUInt16LE(value);
  return element(tag, "US", bytes);
}

const ROOT = "1.2.826.0.1.3680043.10.1338";
const CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2";
const EXPLICIT_LITTLE_ENDIAN = "1.2.840.10008.1.2.1";

/** The slices of a NIfTI-1 volume of 16-bit or 32-bit values without rotation, all or the first `count`, as series number `series`. */
export function dicomSeries(niftiFile: string, series = 3, count = Infinity): NamedFile[] {
  const bytes = gunzipSync(readFileSync(niftiFile));
  const dims = [1, 2, 3].map((i) => bytes.readInt16LE(40 + 2 * i)) as [number, number, number];
  const spacing = [1, 2, 3].map((i) => bytes.readFloatLE(76 + 4 * i)) as [number, number, number];
  const kind = bytes.readInt16LE(70);
  const start = bytes.readFloatLE(108);
  const size = kind === 4 ? 2 : 4;
  const value = (at: number): number =>
    kind === 4 ? bytes.readInt16LE(start + size * at) : kind === 16 ? bytes.readFloatLE(start + size * at) : NaN;
  const [slope, intercept] = [bytes.readFloatLE(112) || 1, bytes.readFloatLE(116)];
  // NIfTI is RAS: rows of the matrix of the file, of which only the origin is needed here.
  const originRas = [280, 296, 312].map((row) => bytes.readFloatLE(row + 12)) as [number, number, number];
  const steps = [280, 296, 312].map((row, i) => bytes.readFloatLE(row + 4 * i)) as [number, number, number];
  const files: NamedFile[] = [];
  for (let k = 0; k < Math.min(dims[2], count); k++) {
    const pixels = Buffer.alloc(2 * dims[0] * dims[1]);
    for (let at = 0; at < dims[0] * dims[1]; at++) {
      const hu = slope * value(k * dims[0] * dims[1] + at) + intercept;
      pixels.writeUInt16LE(Math.min(Math.max(Math.round(hu) + 1024, 0), 4095), 2 * at);
    }
    // To LPS the first two axes turn round.
    const position = [-originRas[0], -originRas[1], originRas[2] + k * steps[2]];
    const directions = [-Math.sign(steps[0]), 0, 0, 0, -Math.sign(steps[1]), 0];
    const meta = Buffer.concat([
      element(0x00020001, "OB", Buffer.from([0, 1])),
      text(0x00020002, "UI", CT_IMAGE),
      text(0x00020003, "UI", `${ROOT}.${series}.1.${k + 1}`),
      text(0x00020010, "UI", EXPLICIT_LITTLE_ENDIAN),
      text(0x00020012, "UI", `${ROOT}.0`),
    ]);
    const length = Buffer.alloc(4);
    length.writeUInt32LE(meta.length);
    const data = Buffer.concat([
      text(0x00080016, "UI", CT_IMAGE),
      text(0x00080018, "UI", `${ROOT}.${series}.1.${k + 1}`),
      text(0x00080060, "CS", "CT"),
      text(0x00100010, "PN", "Secret^Name"),
      text(0x00100020, "LO", "SECRET-ID"),
      text(0x0020000d, "UI", `${ROOT}.2`),
      text(0x0020000e, "UI", `${ROOT}.2.${series}`),
      text(0x00200011, "IS", String(series)),
      text(0x00200032, "DS", position.map((x) => x.toFixed(4)).join("\\")),
      text(0x00200037, "DS", directions.join("\\")),
      short(0x00280002, 1),
      text(0x00280004, "CS", "MONOCHROME2"),
      short(0x00280010, dims[1]),
      short(0x00280011, dims[0]),
      text(0x00280030, "DS", `${spacing[1]}\\${spacing[0]}`),
      short(0x00280100, 16),
      short(0x00280101, 12),
      short(0x00280102, 11),
      short(0x00280103, 0),
      text(0x00281052, "DS", "-1024"),
      text(0x00281053, "DS", "1"),
      element(0x7fe00010, "OW", pixels),
    ]);
    const file = Buffer.concat([Buffer.alloc(128), Buffer.from("DICM"), element(0x00020000, "UL", length), meta, data]);
    files.push({ name: `IM${series}${(7919 * (k + 1)) % 9973}`, mimeType: "application/dicom", buffer: file });
  }
  return files;
}
