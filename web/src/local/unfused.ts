/**
 * The simulation's program for browsers without WebAssembly's relaxed multiplication and addition: each of them becomes a multiplication
 * and an addition. So a page holds the program once.
 */

/** f32x4 and f64x2: a * b + c, and c - a * b, of WebAssembly's relaxed vector instructions. */
const RELAXED_MADD = new Map([[0x105, "f32"], [0x107, "f64"]] as const);
const RELAXED_NMADD = new Map([[0x106, "f32"], [0x108, "f64"]] as const);
/** Those with a counterpart: choices of whole lanes, which is one bit by bit, and the lesser and greater of numbers (f32x4, f64x2). */
const COUNTERPARTS = new Map([
  [0x109, 0x52], [0x10a, 0x52], [0x10b, 0x52], [0x10c, 0x52],
  [0x10d, 0xe8], [0x10e, 0xe9], [0x10f, 0xf4], [0x110, 0xf5],
]);
/** The first of the relaxed instructions: no other may be there. */
const FIRST_RELAXED = 0x100;
/** Instructions of vectors, behind the prefix. */
const VECTOR = { f32: { mul: 0xe6, add: 0xe4, neg: 0xe1 }, f64: { mul: 0xf2, add: 0xf0, neg: 0xed } } as const;
const V128 = 0x7b;

class Reader {
  constructor(readonly bytes: Uint8Array, public at = 0) {}

  /** @throws Error behind the end */
  byte(): number {
    if (this.at >= this.bytes.length) throw new Error("the program ends within an instruction");
    return this.bytes[this.at++];
  }

  /** LEB128; of signed numbers only the length is right. */
  number(): number {
    let [value, shift] = [0, 0];
    for (;;) {
      const byte = this.byte();
      value |= (byte & 0x7f) << shift;
      shift += 7;
      if (byte < 0x80) return value >>> 0;
    }
  }

  /** A list of bytes behind their number; answers that. */
  list(): number {
    const n = this.number();
    this.at += n;
    return n;
  }

  numbers(n: number): void {
    for (let i = 0; i < n; i++) this.number();
  }
}

const leb = (value: number): number[] => (value < 0x80 ? [value] : [(value & 0x7f) | 0x80, ...leb(value >>> 7)]);

/** Alignment, with a memory's number where there are several, and offset. */
function skipAddress(code: Reader): void {
  if ((code.number() & 0x40) !== 0) code.number();
  code.number();
}

/** Behind the prefix 0xfc: how many numbers follow each instruction. */
const NUMBERS_AFTER = [0, 0, 0, 0, 0, 0, 0, 0, 2, 1, 2, 1, 2, 1, 2, 1, 1, 1];

/** Skips what follows a vector instruction. */
function skipVector(code: Reader, instruction: number): void {
  if (instruction <= 11 || instruction === 92 || instruction === 93) skipAddress(code);
  else if (instruction === 12 || instruction === 13) code.at += 16;
  else if (instruction >= 21 && instruction <= 34) code.at += 1;
  else if (instruction >= 84 && instruction <= 91) {
    skipAddress(code);
    code.at += 1;
  }
}

/** Skips what follows any other instruction. @throws Error for one that is not known */
function skip(code: Reader, instruction: number): void {
  if (instruction === 0x0e) code.numbers(code.number() + 1);
  else if (instruction === 0x11 || instruction === 0x13) code.numbers(2);
  else if (instruction === 0x1c) code.list();
  else if (instruction >= 0x28 && instruction <= 0x3e) skipAddress(code);
  else if (instruction === 0x43) code.at += 4;
  else if (instruction === 0x44) code.at += 8;
  else if (instruction === 0xfc) code.numbers(NUMBERS_AFTER[code.number()]);
  else if (
    (instruction >= 0x02 && instruction <= 0x04) || instruction === 0x0c || instruction === 0x0d || instruction === 0x10 || instruction === 0x12 ||
    (instruction >= 0x20 && instruction <= 0x26) || (instruction >= 0x3f && instruction <= 0x42) || instruction === 0xd0 || instruction === 0xd2
  ) code.number();
  else if (!(instruction <= 0x1b || (instruction >= 0x45 && instruction <= 0xc4) || instruction === 0xd1)) {
    throw new Error(`an instruction 0x${instruction.toString(16)} of WebAssembly is not known`);
  }
}

/** What a relaxed instruction becomes, with a local of its own to keep the third operand in. */
function separate(instruction: number, local: number): number[] {
  const counterpart = COUNTERPARTS.get(instruction);
  if (counterpart !== undefined) return [0xfd, ...leb(counterpart)];
  const lanes = RELAXED_MADD.get(instruction as 0x105) ?? RELAXED_NMADD.get(instruction as 0x106);
  if (lanes === undefined) throw new Error(`a relaxed instruction 0x${instruction.toString(16)} of WebAssembly is not known`);
  const { mul, add, neg } = VECTOR[lanes];
  const sign = RELAXED_NMADD.has(instruction as 0x106) ? [0xfd, ...leb(neg)] : [];
  return [0x21, ...leb(local), 0xfd, ...leb(mul), ...sign, 0x20, ...leb(local), 0xfd, ...leb(add)];
}

/** A function's code, with what was relaxed apart; the same bytes where nothing was. */
function functionWithout(bytes: Uint8Array, nParameters: number): Uint8Array {
  const code = new Reader(bytes);
  const nGroups = code.number();
  const groupsFrom = code.at;
  let nLocals = nParameters;
  for (let i = 0; i < nGroups; i++) {
    nLocals += code.number();
    code.byte();
  }
  const instructionsFrom = code.at;
  const parts: (Uint8Array | number[])[] = [];
  let copied = instructionsFrom;
  while (code.at < bytes.length) {
    const from = code.at;
    const instruction = code.byte();
    if (instruction !== 0xfd) {
      skip(code, instruction);
      continue;
    }
    const vector = code.number();
    if (vector < FIRST_RELAXED) {
      skipVector(code, vector);
      continue;
    }
    parts.push(bytes.subarray(copied, from), separate(vector, nLocals));
    copied = code.at;
  }
  if (code.at !== bytes.length) throw new Error("a function of WebAssembly ends within an instruction");
  if (parts.length === 0) return bytes;
  const groups = bytes.subarray(groupsFrom, instructionsFrom);
  return joined([leb(nGroups + 1), groups, [1, V128], ...parts, bytes.subarray(copied)]);
}

function joined(parts: readonly (Uint8Array | readonly number[])[]): Uint8Array<ArrayBuffer> {
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

/** Number of parameters of each type of function. */
function parametersOfTypes(section: Reader): number[] {
  return Array.from({ length: section.number() }, () => {
    section.byte();
    const n = section.list();
    section.list();
    return n;
  });
}

const [TYPES, FUNCTIONS, CODE] = [1, 3, 10];

/** The program without relaxed instructions. @throws Error where it is none, or has instructions that are not known */
export function unfused(program: Uint8Array): Uint8Array<ArrayBuffer> {
  const all = new Reader(program, 8);
  const parts: (Uint8Array | readonly number[])[] = [program.subarray(0, 8)];
  let types: number[] = [];
  let functions: number[] = [];
  while (all.at < program.length) {
    const begin = all.at;
    const kind = all.byte();
    const end = all.number() + all.at;
    const section = new Reader(program.subarray(0, end), all.at);
    if (kind === TYPES) types = parametersOfTypes(section);
    else if (kind === FUNCTIONS) functions = Array.from({ length: section.number() }, () => section.number());
    if (kind === CODE) {
      const bodies: (Uint8Array | readonly number[])[] = [leb(section.number())];
      for (const type of functions) {
        const length = section.number();
        const body = functionWithout(program.subarray(section.at, section.at + length), types[type]);
        section.at += length;
        bodies.push(leb(body.length), body);
      }
      const content = joined(bodies);
      parts.push([CODE], leb(content.length), content);
    } else {
      parts.push(program.subarray(begin, end));
    }
    all.at = end;
  }
  return joined(parts);
}
