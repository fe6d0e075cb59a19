import { describe, expect, it } from "vitest";
import { base64OfBytes, bytesOfBase64 } from "../src/base64";
import { filled, packed, unpacked } from "../src/page_parts";

describe("what pages have in them", () => {
  it("comes back from letters, whatever its length", async () => {
    for (const n of [0, 1, 2, 3, 1000, (3 << 13) + 1, 100_000]) {
      const bytes = Uint8Array.from({ length: n }, (_, i) => (i * 31) % 256);
      expect(base64OfBytes(bytes)).toBe(Buffer.from(bytes).toString("base64"));
      expect(bytesOfBase64(base64OfBytes(bytes))).toEqual(bytes);
      expect(await unpacked(bytesOfBase64(await packed(bytes)))).toEqual(bytes);
    }
  });

  it("is put into its element, or refused where there is none", () => {
    const page = '<p></p><script id="program" type="application/octet-stream"></script>';
    expect(filled(page, "program", "abc")).toBe('<p></p><script id="program" type="application/octet-stream">abc</script>');
    expect(() => filled(page, "scene-files", "abc")).toThrow("scene-files");
  });
});
