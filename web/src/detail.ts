/** How much is drawn: all of it, or what a processor can draw. One choice for all shaders, which are compiled for it. */
import type { ShaderMaterial } from "three";

export type DetailChoice = "auto" | "low" | "full";
export const DETAIL_CHOICES: readonly DetailChoice[] = ["auto", "low", "full"];

/** The choice after another one. */
export function nextDetail(choice: DetailChoice): DetailChoice {
  return DETAIL_CHOICES[(DETAIL_CHOICES.indexOf(choice) + 1) % DETAIL_CHOICES.length];
}

/** Unless it is chosen, everything is drawn where a GPU does it. */
export function isFull(choice: DetailChoice, software: boolean): boolean {
  return choice === "auto" ? !software : choice === "full";
}

const followers = new Set<ShaderMaterial>();
let full = false;

function compileFor(material: ShaderMaterial): void {
  if (full) material.defines.FULL_DETAIL = "";
  else delete material.defines.FULL_DETAIL;
  material.needsUpdate = true;
}

/** From now on the material is compiled with `FULL_DETAIL` where all is drawn. */
export function followsDetail(material: ShaderMaterial): void {
  followers.add(material);
  compileFor(material);
  material.addEventListener("dispose", () => followers.delete(material));
}

/** Whether all is drawn now. */
export function isFullDetail(): boolean {
  return full;
}

export function setFullDetail(isFullNow: boolean): void {
  if (full === isFullNow) return;
  full = isFullNow;
  for (const material of followers) compileFor(material);
}
