// The outcome of the mission in a few words.
import type { Report } from "../mission";

/** An outcome with details is an object with one key. */
export function outcomeText({ outcome }: Report): string {
  if (outcome === null) return "outcome unknown";
  const name = typeof outcome === "string" ? outcome : (Object.keys(outcome)[0] ?? "");
  return name.replaceAll("_", " ");
}
