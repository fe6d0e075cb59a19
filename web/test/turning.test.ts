import { describe, expect, it } from "vitest";
import { decodeText, ProtocolError } from "../src/protocol";
import { shownValue, steppedValue, typedValue, type ParameterState } from "../src/turning/parameters";

const young: ParameterState = {
  name: "young_modulus",
  body: 0,
  value: 5000,
  of_scene: 5000,
  coming: null,
  least: 50,
  greatest: 1e7,
  refusal: null,
};

describe("what can be turned", () => {
  it("is decoded, and what is not known is passed over", () => {
    const message = { type: "parameters", material: "liver", parameters: [{ unit: "Pa", ...young }, { unit: "m", ...young, name: "colour" }] };
    const decoded = decodeText(JSON.stringify(message));
    expect(decoded).toMatchObject({ type: "parameters", material: "liver" });
    expect(decoded.type === "parameters" && decoded.parameters).toEqual([young]);
    const broken = { ...message, parameters: [{ ...young, value: "5" }] };
    expect(() => decodeText(JSON.stringify(broken))).toThrow(ProtocolError);
  });

  it("is shown in the units of people, and read from them exactly", () => {
    expect(shownValue("young_modulus", 5123.456)).toBe(5.123);
    expect(shownValue("hand_return_time", 0.002)).toBe(2);
    for (const kilopascals of ["2.5", " 2,5 "]) expect(typedValue(young, kilopascals)).toBe(2500);
    expect(typedValue({ name: "stiffness_damping", least: 0, greatest: 1 }, "0.3")).toBe(0.0003);
    for (const nothing of ["", "soft", "0.001", "1e9", "NaN"]) expect(typedValue(young, nothing)).toBeNull();
  });

  it("goes up and down by a tenth, within its range", () => {
    expect(steppedValue(young, 1)).toBe(5500);
    expect(steppedValue({ ...young, coming: 5500 }, -1)).toBe(5000);
    expect(steppedValue({ ...young, value: 1e7 }, 1)).toBe(1e7);
    expect(steppedValue({ ...young, value: 0, least: 0 }, 1)).toBe(1e4);
    expect(steppedValue({ ...young, name: "poisson_ratio", value: 0.45, least: 0, greatest: 0.499 }, 1)).toBe(0.46);
    expect(steppedValue({ ...young, name: "poisson_ratio", value: 0.495, least: 0, greatest: 0.499 }, 1)).toBe(0.499);
  });
});
