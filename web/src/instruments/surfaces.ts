/** What parts of instruments are made of, by name. */
import type { ShaderMaterial } from "three";
import { solidMaterial, type SolidLook } from "../materials";

/** Distance of the marks on a shaft [m]. */
export const MARK_SPACING_M = 0.01;

const LOOKS = {
  polished: { colour: 0xe4e8ec, metal: 1, softness: 0.06 },
  steel: { colour: 0xc4cad0, metal: 1, softness: 0.16 },
  marked_steel: { colour: 0xc9ced4, metal: 1, softness: 0.14, bands: { spacing_m: MARK_SPACING_M, colour: 0x24282c } },
  titanium: { colour: 0xd9d4cc, metal: 1, softness: 0.1 },
  insulation: { colour: 0x15181b, metal: 0, softness: 0.22, bands: { spacing_m: MARK_SPACING_M, colour: 0x434a51 } },
  ceramic: { colour: 0xe8e0d2, metal: 0, softness: 0.12 },
  cannula: { colour: 0x9fb4bd, metal: 0, softness: 0.12 },
  glass: { colour: 0x0b1620, metal: 0, softness: 0.04 },
  light: { colour: 0xfff6e6, metal: 0, softness: 0.4, glow: 0.9 },
  hole: { colour: 0x050607, metal: 0, softness: 0.6 },
  grip: { colour: 0x20262c, metal: 0, softness: 0.3 },
} as const satisfies Record<string, SolidLook>;

export type Look = keyof typeof LOOKS;

/** Materials that are made when they are first asked for; who made them disposes of them. */
export class Surfaces {
  private readonly made = new Map<Look, ShaderMaterial>();

  of(look: Look): ShaderMaterial {
    const known = this.made.get(look) ?? solidMaterial(LOOKS[look]);
    this.made.set(look, known);
    return known;
  }
}
