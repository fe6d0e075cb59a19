import { Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { Hands } from "../src/hands";
import { rollOf, toolNumber } from "../src/keys";
import type { Messages } from "../src/overlays";
import type { Hello, ToolInfo } from "../src/protocol";

const TOOL: ToolInfo = {
  name: "grasper",
  kind: "grasper",
  tip_radius_m: 0.002,
  shaft_radius_m: 0.002,
  shaft_length_m: 0.3,
  jaws: { length_m: 0.02, width_m: 0.005, greatest_opening_rad: 1 },
  optics: null,
  trocar_m: null,
  home_tip_m: [0, 0, 0],
  home_shaft: [0, -1, 0],
  home_jaw: 1,
};
const HELLO = { tools: [{ ...TOOL, home_jaw: 0 }, TOOL] } as unknown as Hello;

function messages(): { texts: string[]; sink: Messages } {
  const texts: string[] = [];
  return { texts, sink: { error: (text: string) => texts.push(text) } as unknown as Messages };
}

describe("several instruments", () => {
  const shown = (tool: number) => ({ tip_m: new Vector3(tool, 0, 0), shaft: new Vector3(0, -1, 0) });

  it("keys 1 to 4 take one of those that are there", () => {
    const hands = new Hands();
    hands.begin(HELLO);
    const { texts, sink } = messages();
    expect(hands.choose(toolNumber("tool_2")!, sink)).toBe(true);
    expect(hands.choose(toolNumber("tool_3")!, sink)).toBe(false);
    expect([hands.chosen, texts.length, toolNumber("cut")]).toEqual([1, 1, null]);
  });

  it("a second pointer takes the next one that is no endoscope and that this page may move", () => {
    const all = () => true;
    const hands = new Hands();
    hands.begin(HELLO);
    expect(hands.second(all)).toBe(1);
    expect(hands.second((tool) => tool !== 1)).toBeNull();
    const endoscope = { ...TOOL, optics: { view_angle_rad: 0, field_of_view_rad: 1 } };
    hands.begin({ tools: [TOOL, endoscope, TOOL] } as unknown as Hello);
    expect(hands.second(all)).toBe(2);
    hands.choose(2, messages().sink);
    expect(hands.second(all)).toBe(0);
    hands.begin({ tools: [TOOL, endoscope] } as unknown as Hello);
    expect([hands.chosen, hands.second(all)]).toEqual([1, 0]);
    hands.choose(0, messages().sink);
    expect(hands.second(all)).toBeNull();
  });

  it("jaws and trigger are sent where the instrument is shown, once", () => {
    const hands = new Hands();
    hands.begin(HELLO);
    hands.choose(1, messages().sink);
    expect(hands.advance(0.02, shown)).toEqual([]);
    hands.press("jaws");
    hands.press("trigger");
    const [{ tool, pose }] = hands.advance(0.02, shown);
    const message = hands.message(tool, pose, null);
    expect(message).toEqual({ type: "tool", tool: 1, tip_m: [1, 0, 0], shaft: [0, -1, 0], roll_rad: 0, jaw: 0, trigger: 1 });
    expect(hands.advance(0.02, shown)).toEqual([]);
    hands.forget();
    expect(hands.message(1, pose, null)).toMatchObject({ jaw: 1, trigger: 0 });
  });

  it("keys − and + roll it from where it is shown, and the roll stays", () => {
    const hands = new Hands();
    hands.begin(HELLO);
    const step = rollOf("roll_left")!;
    expect([step > 0, rollOf("roll_right"), rollOf("cut")]).toEqual([true, -step, null]);
    hands.roll(0, step, 0.5);
    hands.roll(0, step, 99);
    const [{ tool, pose }] = hands.advance(0.02, shown);
    expect(hands.message(tool, pose, null)).toMatchObject({ tool: 0, roll_rad: 0.5 + 2 * step });
    expect(hands.message(1, pose, null)).toMatchObject({ roll_rad: 0 });
    hands.forget();
    expect(hands.message(0, pose, null)).toMatchObject({ roll_rad: 0 });
  });
});
