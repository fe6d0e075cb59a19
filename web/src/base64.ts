/** Base64 of long contents. */

/** Letters of base64 that are decoded at once: whole groups of four. */
const PORTION = 1 << 20;

/** Decodes base64. @throws Error if it is none */
export function bytesOfBase64(letters: string): Uint8Array {
  const bytes = new Uint8Array(Math.floor((letters.length * 3) / 4));
  let n = 0;
  for (let at = 0; at < letters.length; at += PORTION) {
    const portion = atob(letters.slice(at, at + PORTION));
    for (let i = 0; i < portion.length; i++) bytes[n++] = portion.charCodeAt(i);
  }
  return bytes.subarray(0, n);
}

/** Bytes that are encoded at once: whole groups of three. */
const PIECE = 3 << 13;

/** Encodes base64. */
export function base64OfBytes(bytes: Uint8Array): string {
  let letters = "";
  for (let at = 0; at < bytes.length; at += PIECE) letters += btoa(String.fromCharCode(...bytes.subarray(at, at + PIECE)));
  return letters;
}
