// The fate of an act, in words.
import { playedUntil } from "../data/fate";
import type { ActCourse, Played } from "../mission";
import { clock, duration } from "./time";

export function fateText({ fate, over }: Pick<Played, "fate" | "over">): string {
  const when = typeof over === "number" ? ` at ${clock(over)}` : "";
  if (fate === "played") return "played";
  if (fate === "stopped") return `stopped${when}`;
  if (fate === "withdrawn") return `withdrawn before anything moved${when === "" ? "" : `,${when}`}`;
  if (fate === "unknown") return "unknown whether it was played to its end";
  return when === "" ? "outcome unknown" : `not known from${when.slice(3)}`;
}

/** For an act that was planned from `start` to `end`; empty if it was played. */
export function notPlayed(act: Played, start: number, end: number): string {
  const until = playedUntil(act);
  if (until >= end) return "";
  return until <= start ? "planned, not played" : `planned, not played from ${clock(until)}`;
}

const OF_COURSE: Record<string, string> = {
  not_reached: "not reached",
  still_waiting: "still waiting at the end",
  nobody_left: "skipped: no robot was left to play it",
  withdrawn: "withdrawn before anything moved",
  stopped: "stopped before its end",
  unknown: "unknown whether it was played",
  played: "played",
};

export function courseText({ fate, played, awaited, within_ms }: ActCourse): string {
  const last = fate === "timed_out" ? timedOut(awaited, within_ms) : (OF_COURSE[fate] ?? (fate.replaceAll("_", " ") || "not known"));
  if (fate === "played") return played > 1 ? `played ${played} times` : last;
  return played === 0 ? last : `played ${played === 1 ? "once" : `${played} times`}, then ${last}`;
}

function timedOut(awaited: string, within: number | null): string {
  return `skipped: ${awaited === "" ? "what it waited for" : awaited} did not occur${within === null ? "" : ` within ${duration(within)}`}`;
}
