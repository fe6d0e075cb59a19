/**
 * What tissue looks like, by the words in a body's name: colours of its dark and light patches (linear, lit by white), how strongly
 * vessels show, and lobules. Chosen by eye; no optical measurement stands behind them, and nothing is said about mechanics.
 */
import { Color } from "three";
import type { BodyInfo } from "../protocol";

export interface TissueLook {
  readonly dark: readonly [number, number, number];
  readonly light: readonly [number, number, number];
  /** Fine vessels in its cover, 0 to 1. */
  readonly vessels: number;
  /** Lobules, 0 to 1: faint in a liver, all there is in fat. */
  readonly lobules: number;
}

const look = (dark: TissueLook["dark"], light: TissueLook["light"], vessels: number, lobules: number): TissueLook => ({ dark, light, vessels, lobules });

/** First the words, then what they look like; the first that fits holds. */
const TABLE: ReadonlyArray<readonly [words: RegExp, look: TissueLook]> = [
  [/gall|vesicula|vésicule/, look([0.072, 0.085, 0.05], [0.19, 0.2, 0.125], 0.85, 0)],
  [/tumou?r|nodule|metasta/, look([0.26, 0.19, 0.14], [0.42, 0.34, 0.26], 0.2, 0.15)],
  [/vessel|artery|vein|duct|aorta|cava|ureter/, look([0.17, 0.075, 0.052], [0.29, 0.165, 0.12], 0.6, 0)],
  [/ligament|falciform|periton/, look([0.2, 0.095, 0.06], [0.37, 0.22, 0.155], 0.8, 0.3)],
  [/fat|oment|adipos|mesent/, look([0.175, 0.088, 0.022], [0.3, 0.178, 0.055], 0.45, 1)],
  [/spleen|rate/, look([0.048, 0.009, 0.017], [0.11, 0.021, 0.034], 0, 0.15)],
  [/kidney|rein/, look([0.075, 0.018, 0.012], [0.165, 0.047, 0.031], 0.15, 0.1)],
  [/stomach|bowel|colon|intestin|duoden|estomac/, look([0.185, 0.07, 0.05], [0.3, 0.145, 0.105], 1, 0)],
  [/muscle|diaphragm|heart/, look([0.13, 0.02, 0.014], [0.26, 0.06, 0.042], 0.2, 0)],
];
/** Of a liver, and of what nothing is known. */
const LIVER = look([0.047, 0.0112, 0.0082], [0.116, 0.0272, 0.0182], 0, 0.2);
/** A rigid body without a colour of its own: bone. */
const BONE = look([0.55, 0.49, 0.36], [0.72, 0.67, 0.53], 0, 0);

/** By the words of a name. */
export function lookOf(name: string): TissueLook {
  return TABLE.find(([words]) => words.test(name.toLowerCase()))?.[1] ?? LIVER;
}

/** The look of a body that may have a colour of its own, whose light and dark it then shows. */
function lookOfBody({ name, color, is_rigid }: BodyInfo): TissueLook {
  const named = is_rigid ? BONE : lookOf(name);
  if (color === null) return named;
  const shade = (factor: number): [number, number, number] => {
    const { r, g, b } = new Color(color).multiplyScalar(factor);
    return [r, g, b];
  };
  return { ...named, dark: shade(0.66), light: shade(1.12) };
}

/** Of each body by its number; of one organ by its tissue. */
export function looksOf(bodies: readonly BodyInfo[], material: string): TissueLook[] {
  return bodies.length > 0 ? bodies.map(lookOfBody) : [lookOf(material)];
}
