/**
 * Where suction tubes suck and rinse, from what snapshots tell: the trigger of one that sucks is pressed, and the lever of one that
 * rinses, which is where other instruments have their jaws. What they do is done to pictures of blood and smoke alone.
 */
import { Vector3 } from "three";
import type { Hello, SnapshotHeader, ToolState } from "../protocol";

/** Kinds of instruments that suck and rinse. */
const SUCTION = "suction";
/** Water comes out of the tip, and reaches so far: the middle of what it rinses, and its radius [m]. A choice. */
const RINSED_AHEAD_M = 6e-3;

export function isSucking(kind: string | undefined, { trigger }: Pick<ToolState, "trigger">): boolean {
  return kind === SUCTION && trigger > 0.5;
}

export function isRinsing(kind: string | undefined, { jaw }: Pick<ToolState, "jaw">): boolean {
  return kind === SUCTION && jaw < 0.5;
}

/** Places that are sucked at and rinsed now. */
export interface Washing {
  readonly sucked_m: readonly Vector3[];
  readonly rinsed_m: readonly Vector3[];
}

export const NO_WASHING: Washing = { sucked_m: [], rinsed_m: [] };

export function washingOf({ tools }: Pick<SnapshotHeader, "tools">, hello: Pick<Hello, "tools">): Washing {
  const kindOf = (i: number): string | undefined => hello.tools[i]?.kind;
  const tip = ({ tip_m, shownFurtherOut_m }: ToolState): Vector3 => new Vector3(...tip_m).add(new Vector3(...shownFurtherOut_m));
  return {
    sucked_m: tools.filter((tool, i) => isSucking(kindOf(i), tool)).map(tip),
    rinsed_m: tools.filter((tool, i) => isRinsing(kindOf(i), tool)).map((tool) => tip(tool).addScaledVector(new Vector3(...tool.shaft), -RINSED_AHEAD_M)),
  };
}
