// Fate of an act, and when it stopped following the plan.
import type { Mission, Played } from "../mission";

/** On the mission's axis. `Infinity` if all of it was played, as far as is known; `-Infinity` if nothing was played. */
export function playedUntil({ fate, over }: Played): number {
  if (fate === undefined || fate === "played") return Infinity;
  if (fate === "withdrawn") return -Infinity;
  return over ?? Infinity;
}

/** Acts of a mission whose file ends before it does: nothing is known of their later parts. */
export function knownActs({ acts, known_until }: Mission): Played[] {
  if (typeof known_until !== "number") return acts;
  return acts.map((act) => (act.fate === "open" && act.over === null && known_until < act.end ? { ...act, over: known_until } : act));
}

export function nameOfAct({ name, number }: Pick<Played, "name" | "number">): string {
  return name === "" ? `act ${number + 1}` : name;
}
