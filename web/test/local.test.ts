import { describe, expect, it } from "vitest";
import { mayGoOn } from "../src/local/kept";
import { RecordingFile } from "../src/local/recording";
import { unfused } from "../src/local/unfused";

const section = (kind: number, content: readonly number[]): number[] => [kind, content.length, ...content];

/** A module with one function that takes and gives vectors: `code` between its operands and its end, and what it gives exported. */
function moduleOf(nParameters: number, code: readonly number[]): Uint8Array {
  const V128 = 0x7b;
  const operands = Array.from({ length: nParameters }, (_, i) => [0x20, i]).flat();
  const body = [0, ...operands, ...code, 0x0b];
  return Uint8Array.from([
    0, 0x61, 0x73, 0x6d, 1, 0, 0, 0,
    ...section(1, [1, 0x60, nParameters, ...Array<number>(nParameters).fill(V128), 1, V128]),
    ...section(3, [1, 0]),
    ...section(7, [1, 1, "f".charCodeAt(0), 0, 0]),
    ...section(10, [1, body.length, ...body]),
  ]);
}

describe("a page with its simulation in itself", () => {
  it("takes relaxed multiplication and addition apart", () => {
    const relaxed = moduleOf(3, [0xfd, 0x87, 0x02]);
    const apart = unfused(relaxed);
    expect(WebAssembly.validate(apart as BufferSource)).toBe(true);
    // One local of its own, the fourth: set, multiply, get, add.
    const body = [1, 1, 0x7b, 0x20, 0, 0x20, 1, 0x20, 2, 0x21, 3, 0xfd, 0xf2, 1, 0x20, 3, 0xfd, 0xf0, 1, 0x0b];
    expect([...apart.slice(-body.length)]).toEqual(body);
    const negated = unfused(moduleOf(3, [0xfd, 0x88, 0x02]));
    expect(WebAssembly.validate(negated as BufferSource)).toBe(true);
    expect([...negated.slice(-11)]).toEqual([0xfd, 0xf2, 1, 0xfd, 0xed, 1, 0x20, 3, 0xfd, 0xf0, 1, 0x0b].slice(-11));
    // Two lanes' greater numbers have an instruction of their own.
    const greater = unfused(moduleOf(2, [0xfd, 0x90, 0x02]));
    expect([...greater.slice(-4)]).toEqual([0xfd, 0xf5, 1, 0x0b]);
  });

  it("leaves everything else as it is, and refuses what it does not know", () => {
    const plain = moduleOf(2, [0xfd, 0xf0, 1]);
    expect([...unfused(plain)]).toEqual([...plain]);
    expect(() => unfused(moduleOf(2, [0xfd, 0x92, 0x02]))).toThrow(/0x112/);
    expect(() => unfused(moduleOf(2, [0xfe]))).toThrow(/0xfe/);
    expect(() => unfused(plain.slice(0, -2))).toThrow(/ends within/);
  });

  it("gives away what is recorded once, with its place", () => {
    const file = new RecordingFile();
    file.add(Uint8Array.of(1, 2));
    file.add(Uint8Array.of(3));
    expect(file.take()).toEqual({ bytes: Uint8Array.of(1, 2, 3), from: 0 });
    expect(file.take()).toEqual({ bytes: Uint8Array.of(), from: 3 });
    file.add(Uint8Array.of(4));
    expect(file.take()).toEqual({ bytes: Uint8Array.of(4), from: 3 });
    expect(file.stat().size).toBe(4n);
  });

  it("lets nobody forget a session that another page may be recording", () => {
    const session = { id: 1, name: "liver", begun_ms: 0, kept_ms: 50_000 };
    expect([mayGoOn(session, 50_500), mayGoOn(session, 70_000)]).toEqual([true, false]);
  });
});
