// Fate of an act, and when it stopped following the plan.
import type { Played } from "../mission";

/** On the mission's axis. `Infinity` if all of it was played, as far as is known; `-Infinity` if nothing was played. */
export function playedUntil({ fate, over }: Played): number {
  if (fate === undefined || fate === "played") return Infinity;
  if (fate === "withdrawn") return -Infinity;
  return over ?? Infinity;
}

export function nameOfAct({ name, number }: Pick<Played, "name" | "number">): string {
  return name === "" ? `act ${number + 1}` : name;
}
