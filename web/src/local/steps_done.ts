/** The steps that were done, to be done again by another Worker: without those that later ones made needless. */
import type { Step } from "../patient/state";

export interface StepDone {
  readonly name: Step;
  readonly choice: object;
}

const organOf = ({ choice }: StepDone): string | undefined => (choice as { name?: string }).name;

/** The list with one more step. */
export function withStep(done: readonly StepDone[], step: StepDone): StepDone[] {
  if (step.name === "open") return [step];
  const before = step.name === "mesh" || step.name === "organ" || step.name === "remove" ? done.filter(({ name }) => name !== "mesh") : [...done];
  if (step.name !== "organ") return [...before, step];
  // An organ that is found anew keeps its place among the others.
  const isOfSame = (other: StepDone): boolean => (other.name === "organ" || other.name === "remove") && organOf(other) === organOf(step);
  const last = before.findLastIndex(isOfSame);
  return last >= 0 && before[last]!.name === "organ" ? before.with(last, step) : [...before, step];
}
