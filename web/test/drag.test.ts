import { describe, expect, it } from "vitest";
import { Vector3 } from "three";
import {
  APPROACH_GAP_M,
  depthAfterWheel,
  FOLLOW_STRIDE_M,
  MAX_DEPTH_M,
  MAX_REACH_M,
  MIN_DEPTH_M,
  moveTowards,
  PRESS_DEPTH_M,
  PRESS_STRIDE_M,
  Push,
  rayMeetsPlane,
  RETRACT_M,
  shaftDirection,
  type PushStart,
  type Ray,
} from "../src/drag";
import { ToolDriver } from "../src/tool_driver";

const v = (x: number, y: number, z: number): Vector3 => new Vector3(x, y, z);
/** The camera looks along +y; the surface faces it, turned a little. */
const VIEW = { right: v(1, 0, 0), up: v(0, 0, 1), forward: v(0, 1, 0) };
const EYE = v(0, -1, 0);
const START: PushStart = { hit_m: v(0, 0, 0), normal: v(0.3, -1, 0.2).normalize(), tipRadius_m: 0.005, view: VIEW };
const through = (x: number, z: number): Ray => ({ origin: EYE, direction: v(x, 0, z).sub(EYE).normalize() });

function pushToRest(push: Push): void {
  for (let i = 0; i < 500 && !push.settled(); i++) push.advance(1 / 60);
  expect(push.settled()).toBe(true);
}

const near = (a: Vector3, b: Vector3, tolerance = 1e-12): void => expect(a.distanceTo(b)).toBeLessThanOrEqual(tolerance);

describe("rays", () => {
  it("meet the plane where they should", () => {
    near(rayMeetsPlane(through(0.1, -0.2), v(0, 0, 0), VIEW.forward)!, v(0.1, 0, -0.2));
  });
  it("along or away from the plane meet nothing", () => {
    expect(rayMeetsPlane({ origin: EYE, direction: v(1, 0, 0) }, v(0, 0, 0), VIEW.forward)).toBeNull();
    expect(rayMeetsPlane({ origin: EYE, direction: v(0, -1, 0) }, v(0, 0, 0), VIEW.forward)).toBeNull();
  });
});

describe("a push", () => {
  it("starts outside the surface, above the picked point", () => {
    const push = new Push(START, through(0, 0));
    near(push.pose().tip_m, START.normal.clone().multiplyScalar(START.tipRadius_m + APPROACH_GAP_M));
  });

  it("stays on the normal through the picked point until it touches", () => {
    const push = new Push(START, through(0, 0));
    for (let i = 0; i < 200; i++) {
      const { tip_m } = push.advance(1 / 60);
      const height = tip_m.dot(START.normal);
      if (height <= START.tipRadius_m - PRESS_STRIDE_M + 1e-12) return;
      near(tip_m.clone().addScaledVector(START.normal, -height), v(0, 0, 0));
    }
    throw new Error("it never touched");
  });

  it("presses 5 mm in along the view without any motion of the hand", () => {
    const push = new Push(START, through(0, 0));
    pushToRest(push);
    const touch = START.normal.clone().multiplyScalar(START.tipRadius_m);
    near(push.pose().tip_m, touch.addScaledVector(VIEW.forward, PRESS_DEPTH_M));
  });

  it("keeps the contact point exactly under the pointer, at any depth", () => {
    const push = new Push(START, through(0, 0));
    for (const [x, z, depth] of [[0.01, 0.02, 0.005], [-0.03, 0.01, 0], [0.02, -0.04, 0.02]] as const) {
      const ray = through(x, z);
      push.follow(ray);
      push.depth_m = depth;
      const fromEye = push.contactTarget().sub(EYE);
      near(fromEye.clone().normalize(), ray.direction);
    }
  });

  it("bounds its stride whatever the display's rate", () => {
    const push = new Push(START, through(0, 0));
    push.follow(through(0.05, 0.03));
    let before = push.pose().tip_m;
    let longest = 0;
    for (let i = 0; i < 200; i++) {
      const { tip_m } = push.advance(0.1);
      longest = Math.max(longest, tip_m.distanceTo(before));
      before = tip_m;
    }
    expect(longest).toBeLessThanOrEqual(FOLLOW_STRIDE_M + 1e-12);
    expect(push.settled()).toBe(true);
  });

  it("does not move in no time", () => {
    const push = new Push(START, through(0, 0));
    const before = push.pose().tip_m;
    near(push.advance(0).tip_m, before, 0);
    near(push.advance(-1).tip_m, before, 0);
  });

  it("stays within its reach", () => {
    const push = new Push(START, through(0, 0));
    push.follow(through(3, 3));
    expect(push.contactTarget().length()).toBeCloseTo(MAX_REACH_M, 12);
  });

  it("keeps its target when the pointer's ray misses the plane", () => {
    const push = new Push(START, through(0, 0));
    const before = push.tipTarget();
    push.follow({ origin: EYE, direction: v(0, -1, 0) });
    near(push.tipTarget(), before, 0);
  });
});

describe("wheel and stride", () => {
  it("a notch is a millimetre, within bounds", () => {
    expect(depthAfterWheel(0.005, 2)).toBeCloseTo(0.007, 12);
    expect(depthAfterWheel(0.005, -100)).toBe(MIN_DEPTH_M);
    expect(depthAfterWheel(0.005, 100)).toBe(MAX_DEPTH_M);
  });
  it("moveTowards arrives exactly", () => {
    expect(moveTowards(v(0, 0, 0), v(0.3, 0, 0), 1).equals(v(0.3, 0, 0))).toBe(true);
    near(moveTowards(v(0, 0, 0), v(2, 0, 0), 0.5), v(0.5, 0, 0));
  });
});

describe("the shaft", () => {
  it("is a unit vector that leaves the surface, for every direction of it", () => {
    for (let i = 0; i < 200; i++) {
      const angle = i * 2.399963;
      const z = 1 - (2 * i + 1) / 200;
      const r = Math.sqrt(1 - z * z);
      const normal = v(r * Math.cos(angle), r * Math.sin(angle), z);
      const shaft = shaftDirection(normal, VIEW);
      expect(shaft.length()).toBeCloseTo(1, 12);
      expect(shaft.dot(normal)).toBeGreaterThan(0.15);
    }
  });
  it("comes towards the camera and is seen from the side", () => {
    const shaft = shaftDirection(v(0, -1, 0), VIEW);
    expect(shaft.dot(VIEW.forward)).toBeLessThan(-0.5);
    expect(Math.hypot(shaft.x, shaft.z)).toBeGreaterThan(0.4);
  });
});

describe("the tool driver", () => {
  const drive = (driver: ToolDriver, frames = 600): number => {
    let sent = 0;
    for (let i = 0; i < frames; i++) if (driver.advance(1 / 60) !== null) sent += 1;
    return sent;
  };

  it("sends nothing until the hand does something, and nothing once settled", () => {
    const driver = new ToolDriver();
    expect(drive(driver)).toBe(0);
    driver.beginPush(START, through(0, 0));
    expect(drive(driver)).toBeGreaterThan(5);
    expect(driver.settled).toBe(true);
    expect(drive(driver)).toBe(0);
  });

  it("first sends the pose outside the surface as it is", () => {
    const driver = new ToolDriver();
    driver.beginPush(START, through(0, 0));
    const first = driver.advance(0.1)!;
    expect(first.tip_m.dot(START.normal)).toBeCloseTo(START.tipRadius_m + APPROACH_GAP_M, 12);
  });

  it("retracts along the shaft", () => {
    const driver = new ToolDriver();
    driver.beginPush(START, through(0, 0));
    drive(driver);
    const before = driver.pose!;
    driver.retract();
    drive(driver);
    near(driver.pose!.tip_m, before.tip_m.clone().addScaledVector(before.shaft, RETRACT_M), 1e-9);
    expect(driver.pushing).toBe(false);
  });

  it("adds up presses of keys", () => {
    const driver = new ToolDriver();
    const home = { tip_m: v(0, -0.1, 0), shaft: v(0, -1, 0) };
    for (let i = 0; i < 3; i++) driver.nudge(v(0.001, 0, 0), home);
    drive(driver);
    near(driver.pose!.tip_m, v(0.003, -0.1, 0));
  });

  it("is led through a pivot, as fast as a hand", () => {
    const driver = new ToolDriver();
    const pivot = v(0, -0.3, 0);
    const home = { tip_m: v(0, -0.1, 0), shaft: v(0, -1, 0) };
    expect(driver.goal_m).toBeNull();
    driver.lead(v(0.05, -0.1, 0), pivot, home);
    expect(driver.goal_m).toEqual(v(0.05, -0.1, 0));
    expect(drive(driver)).toBeLessThan(15);
    near(driver.pose!.tip_m, v(0.05, -0.1, 0), 1e-12);
    near(driver.pose!.shaft, v(-0.05, -0.2, 0).normalize(), 1e-12);
  });

  it("keys do not disturb a push, the wheel needs one", () => {
    const driver = new ToolDriver();
    expect(driver.wheel(1)).toBe(false);
    driver.beginPush(START, through(0, 0));
    drive(driver);
    const before = driver.pose!.tip_m;
    driver.nudge(v(1, 0, 0), driver.pose!);
    expect(drive(driver)).toBe(0);
    near(driver.pose!.tip_m, before, 0);
    expect(driver.wheel(2)).toBe(true);
    drive(driver);
    near(driver.pose!.tip_m, before.clone().addScaledVector(VIEW.forward, 0.002));
  });

  it("forgets", () => {
    const driver = new ToolDriver();
    driver.beginPush(START, through(0, 0));
    driver.forget();
    expect(drive(driver)).toBe(0);
    expect(driver.active).toBe(false);
  });
});
