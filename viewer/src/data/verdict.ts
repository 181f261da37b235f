// What became of the mission, in one sentence or two.
import type { Report } from "../mission";
import { shortClock, time } from "../text/amount";
import { timeOfDay } from "../text/time";
import { robotStates, type RobotState } from "./robots";
import type { Show } from "./show";

export interface Verdict {
  /** "bad": something failed; "warn": all was played, with flaws, or the end is not known. */
  grade: "good" | "warn" | "bad";
  text: string;
  /** The instant that it concerns. */
  at: number | null;
}

export function verdict(show: Show): Verdict {
  const { report } = show.mission;
  const states = robotStates(show);
  if (report === null || report.outcome === null) return unknownEnd(show, states);
  return nameOf(report) in PLAYED ? played(show, states) : failed(show, states);
}

/** Outcomes of missions that were played to their end. */
const PLAYED: Record<string, string> = {
  done: "",
  done_without: "without some of the robots",
  done_skipping: "but acts were skipped",
  out_of_tolerance: "but the robots started too far apart",
  steps_late: "but late",
};

/** An outcome with details is an object with one key. */
function nameOf({ outcome }: Pick<Report, "outcome">): string {
  return typeof outcome === "string" ? outcome : (Object.keys(outcome ?? {})[0] ?? "");
}

function played(show: Show, states: readonly RobotState[]): Verdict {
  const { report, kind, findings } = show.mission;
  const name = report === null ? "" : nameOf(report);
  const late = states.filter(({ lateSteps }) => lateSteps > 0).sort((a, b) => (b.lateMost ?? 0) - (a.lateMost ?? 0));
  const verb = kind === "dry_run" ? "Plays" : "Played";
  const misses = (report?.requirements ?? []).filter(({ result }) => result !== "met");
  const sentences: string[] = [];
  if (late.length > 0) sentences.push(`${verb}.`, lateness(late));
  else if (PLAYED[name] !== "") sentences.push(`${verb}, ${PLAYED[name]}: ${starts(show)}.`);
  else sentences.push(`${verb} as planned: ${starts(show)}.`);
  const dropped = states.filter(({ leftOut, failure }) => leftOut || failure !== null);
  if (dropped.length > 0) sentences.push(`${dropped[0].id}: ${dropped[0].failure?.text ?? "left out"}.`);
  if (misses.length > 0) sentences.push(`${count(misses.length, "requirement")} not met: ${misses[0].requirement}.`);
  if (findings.length > 0) sentences.push(`${count(findings.length, "finding")} to check.`);
  const flawless = sentences.length === 1 && late.length === 0 && PLAYED[name] === "";
  const at = late[0]?.late[0]?.from ?? dropped[0]?.failure?.at ?? null;
  return { grade: flawless ? "good" : "warn", text: sentences.join(" "), at };
}

/** The robots' starts, with the accuracy with which they are known and the tolerance. */
export function starts(show: Show): string {
  const { report, robots, kind } = show.mission;
  const took = robots.length;
  const start = kind === "dry_run" ? "start" : "started";
  const first = `${count(took, "robot")} ${took === 1 && kind === "dry_run" ? "starts" : start}`;
  if (report === null) return first;
  if (took === 1) return first;
  const spread = report.true_spread_ms ?? report.spread_ms;
  if (spread === null) return first;
  const { allowed } = budget(show);
  const within = report.true_spread_ms != null ? time(spread) : `${time(spread)} by their own clocks${knownTo(show)}`;
  return `${first} within ${within}${allowed === null ? "" : `; ${time(allowed)} allowed`}`;
}

function knownTo(show: Show): string {
  const uncertainty = clockUncertainty(show);
  return uncertainty === null ? "" : `, which are known to ±${time(uncertainty)}`;
}

/** The largest uncertainty of a robot's clock; `null` if no clock is known. */
export function clockUncertainty(show: Show): number | null {
  const known = robotStates(show).map(({ clock }) => clock?.uncertainty_ms ?? null);
  return known.reduce((most, value) => (value !== null && (most === null || value > most) ? value : most), null);
}

/** The largest prediction and the strictest tolerance of the starts of all acts. */
export function budget({ mission }: Show): { predicted: number | null; allowed: number | null } {
  const skews = (mission.report?.acts ?? []).flatMap(({ skew }) => (skew === null ? [] : [skew]));
  const most = (values: (number | null)[], pick: (...all: number[]) => number) => {
    const known = values.filter((value): value is number => value !== null);
    return known.length === 0 ? null : pick(...known);
  };
  return {
    predicted: most(skews.map(({ predicted_ms }) => predicted_ms), Math.max),
    allowed: most(skews.map(({ tolerance_ms }) => tolerance_ms), Math.min),
  };
}

function lateness(late: readonly RobotState[]): string {
  const [worst, ...others] = late;
  const by = worst.lateMost === null ? `late in ${count(worst.lateSteps, "step")}` : `up to ${time(worst.lateMost)} late`;
  const more = others.length === 0 ? "" : `, and ${count(others.length, "other robot")} less`;
  return `${worst.id} was ${by}${when(worst)}${more}.`;
}

/** "at 0:09.2" if it is known to a second, else "between 0:08.0 and 0:12.0". */
function when({ late }: RobotState): string {
  if (late.length === 0) return "";
  const from = Math.min(...late.map((part) => part.from));
  const to = Math.max(...late.map((part) => part.to));
  return to - from < 1000 ? ` at ${shortClock(from)}` : ` between ${shortClock(from)} and ${shortClock(to)}`;
}

const WORDS: Record<string, string> = {
  stopped: "Stopped",
  abandoned: "Abandoned",
  aborted: "Aborted",
  failed: "Failed",
};

function failed(show: Show, states: readonly RobotState[]): Verdict {
  const { report } = show.mission;
  const name = report === null ? "" : nameOf(report);
  const first = firstFailure(states);
  const at = first?.failure?.at ?? stoppedAt(show);
  const word = WORDS[name] ?? `Ended as "${name.replaceAll("_", " ")}"`;
  const parts = [`${word}${at === null ? "" : ` at ${shortClock(at)}`}`];
  if (first !== undefined) parts[0] += `: ${first.id}: ${first.failure?.text ?? ""}`;
  else if (report?.because) parts[0] += `: ${report.because}`;
  return { grade: "bad", text: `${[...parts, ...unconfirmed(show, states)].join("; ")}.`, at };
}

function firstFailure(states: readonly RobotState[]): RobotState | undefined {
  const failed = states.filter(({ failure }) => failure !== null);
  return failed.sort((a, b) => (a.failure?.at ?? Infinity) - (b.failure?.at ?? Infinity))[0];
}

function unconfirmed(show: Show, states: readonly RobotState[]): string[] {
  const open = states.filter(({ stop }) => stop !== null && !stop.confirmed);
  if (open.length === 0) return [];
  const until = open.map(({ stop }) => stop?.until ?? null);
  const names = open.slice(0, 3).map(({ id }) => id).join(", ") + (open.length > 3 ? ` and ${open.length - 3} more` : "");
  const whose = open.length === 1 ? `the stop of ${names} is` : `the stops of ${names} are`;
  const last = until.some((at) => at === null) ? null : Math.max(...(until as number[]));
  if (last === null) return [`${whose} not confirmed`];
  return [`${whose} not confirmed until ${timeOfDay(show.mission.epoch, last).replace(/\.\d+$/, "")} (${shortClock(last)})`];
}

function stoppedAt({ mission }: Show): number | null {
  return mission.events.find(({ kind }) => kind === "stopping")?.at ?? null;
}

function unknownEnd(show: Show, states: readonly RobotState[]): Verdict {
  const { mission } = show;
  const until = mission.known_until ?? mission.to;
  const first = firstFailure(states);
  const more = first === undefined ? "" : ` ${first.id}: ${first.failure?.text}.`;
  const what = mission.kind === "dry_run" ? "Its end is not known" : `The ${mission.kind} ends at ${shortClock(until)}, before the mission does`;
  return { grade: "warn", text: `${what}.${more}`, at: until };
}

const count = (n: number, what: string) => `${n} ${what}${n === 1 ? "" : "s"}`;
