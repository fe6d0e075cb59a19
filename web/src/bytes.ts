/** Numbers of recordings (docs/replay.md) and of coded positions (docs/protocol.md): seven bits to a byte, the lowest first; signed ones as 0, -1, 1, -2, ... */
import { fail } from "./fields";

/** Takes from the front of bytes that may be anything. */
export class Taker {
  private at = 0;

  constructor(private readonly from: Uint8Array) {}

  get left(): number {
    return this.from.length - this.at;
  }

  /** The next `n` bytes. @throws ProtocolError if there are fewer */
  bytes(n: number): Uint8Array {
    if (n > this.left) fail("a message or a recording ends too early");
    this.at += n;
    return this.from.subarray(this.at - n, this.at);
  }

  byte(): number {
    if (this.at >= this.from.length) fail("a message or a recording ends too early");
    return this.from[this.at++];
  }

  number(): number {
    let x = 0;
    for (let shift = 0; shift < 35; shift += 7) {
      const byte = this.byte();
      if (shift === 28 && (byte & 0x7f) > 0xf) break;
      x |= (byte & 0x7f) << shift;
      if (byte < 0x80) return x >>> 0;
    }
    return fail("a number of a message or a recording has more than 32 bits");
  }

  signed(): number {
    const x = this.number();
    return (x >>> 1) ^ -(x & 1);
  }

  /** Bytes of which only the bits were written that differ from those `before` at the same places. */
  changed(before: Uint8Array): Uint8Array {
    const bytes = this.bytes(this.number()).slice();
    const n = Math.min(bytes.length, before.length);
    for (let i = 0; i < n; i++) bytes[i] ^= before[i];
    return bytes;
  }
}
