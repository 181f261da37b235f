// What became of an act, and from when on what was planned of it was not played.
import type { Played } from "../mission";

/** On the mission's axis; `Infinity` where all of it was played, as far as is known; `-Infinity` where nothing was. */
export function playedUntil({ fate, over }: Played): number {
  if (fate === undefined || fate === "played") return Infinity;
  if (fate === "withdrawn") return -Infinity;
  return over ?? Infinity;
}

export function nameOfAct({ name, number }: Pick<Played, "name" | "number">): string {
  return name === "" ? `act ${number + 1}` : name;
}
