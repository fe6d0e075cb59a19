import { describe, expect, it } from "vitest";
import { contactArrowScale_m_per_n } from "../src/contacts";

describe("arrows of contacts", () => {
  it.each([1e-5, 3e-4, 0.0123, 0.1, 1, 7.7, 30])("of %d N fill a good part of the greatest length, and 10 mm are a round force", (largest_n) => {
    const scale = contactArrowScale_m_per_n(largest_n, 0.05);
    const length_m = scale * largest_n;
    expect(length_m).toBeLessThanOrEqual(0.05 * (1 + 1e-9));
    expect(length_m).toBeGreaterThanOrEqual(0.05 / 2.5 - 1e-12);
    const force_n = 0.01 / scale;
    const figure = force_n / Math.pow(10, Math.floor(Math.log10(force_n) + 1e-9));
    expect([1, 2, 5].some((f) => Math.abs(figure - f) < 1e-6)).toBe(true);
  });

  it("without a force there is a length all the same", () => {
    expect(contactArrowScale_m_per_n(0, 0.05)).toBeGreaterThan(0);
  });
});
