// Deviations of robots from the plan: values set at another time, other values than planned, and inaccurate starts.
import { millisSince } from "../text/instant";
import type { Show } from "./show";
import type { Segment, Track } from "./track";
import type { Wave } from "./wave";

export interface Deviation {
  kind: "time" | "value" | "start";
  track: Track;
  /** When it happened, on the mission's axis. */
  at: number;
  /** Actual minus planned, in ms or in the device's unit. */
  by: number;
}

/** A longer list per kind would not be readable. */
export const KEPT = 300;

/** Comparing more values would block the page for seconds. */
const MOST_VALUES = 1_000_000;

/** Whether all lanes can be compared at once, instead of only those whose curves are shown. */
export function comparesAll({ mission }: Show): boolean {
  return mission.set.reduce((sum, { series }) => sum + series.v.n, 0) <= MOST_VALUES;
}

/** Deviations that are smaller than the uncertainty of the robot's clock may be no deviations at all. */
function isKnown(show: Show, { kind, track, at, by }: Deviation): boolean {
  return kind === "value" || Math.abs(by) > show.clockUncertainty(track.robotIndex, at);
}

/** How many deviations are not listed, because they are smaller than the uncertainty of the clocks. */
export interface Found {
  listed: Deviation[];
  uncertain: number;
}

/**
 * Starts first, then times, then values, each sorted by size with the largest first. Values of different units are compared relative to
 * the lane's extent.
 */
export function deviations(show: Show, tracks: readonly Track[]): Found {
  const counts = (deviation: Deviation) => isKnown(show, deviation);
  const times = new Largest(inMs, counts);
  const values = new Largest(inExtents, counts);
  for (const track of tracks) {
    const planned = stepsOfActs(track);
    for (const { wave, source } of show.observed("set", track)) {
      for (const part of partsOf(wave, planned, source.act)) compare(track, wave, part, times, values);
    }
  }
  const starts = new Largest(inMs, counts);
  for (const error of startErrors(show)) starts.push(error);
  const kinds = [starts, times, values];
  return { listed: kinds.flatMap((kind) => kind.sorted()), uncertain: kinds.reduce((sum, kind) => sum + kind.uncertain, 0) };
}

const inMs = ({ by }: Deviation) => Math.abs(by);
const inExtents = ({ by, track }: Deviation) => Math.abs(by) / (track.extent.high - track.extent.low || 1);

/** Keeps the largest deviations, without a list of all. */
class Largest {
  private list: Deviation[] = [];
  uncertain = 0;

  constructor(
    private readonly size: (deviation: Deviation) => number,
    private readonly counts: (deviation: Deviation) => boolean,
  ) {}

  push(deviation: Deviation): void {
    if (!this.counts(deviation)) {
      this.uncertain++;
      return;
    }
    this.list.push(deviation);
    if (this.list.length >= 4 * KEPT) this.list = this.sorted();
  }

  sorted(): Deviation[] {
    return this.list.sort((a, b) => this.size(b) - this.size(a)).slice(0, KEPT);
  }
}

/** The steps of a device in one act: the steps of all its scripts, numbered consecutively. */
interface Steps {
  act: number;
  segments: readonly Segment[];
  waves: readonly Wave[];
  /** Number of the first step of each segment. */
  firsts: readonly number[];
  count: number;
  /** On the mission's axis. */
  from: number;
  to: number;
  playedUntil: number;
}

/** Acts that were not played at all have no steps to compare. */
function stepsOfActs(track: Track): Steps[] {
  const acts = new Map<number, Segment[]>();
  for (const segment of track.segments) {
    if (segment.playedUntil === -Infinity || track.wave(segment).count === 0) continue;
    acts.set(segment.act, [...(acts.get(segment.act) ?? []), segment]);
  }
  return [...acts].map(([act, segments]) => {
    const waves = segments.map((segment) => track.wave(segment));
    let count = 0;
    const firsts = waves.map((wave) => (count += wave.count) - wave.count);
    const last = segments.length - 1;
    const from = segments[0].start + waves[0].time(0);
    const to = segments[last].start + waves[last].time(waves[last].count - 1);
    return { act, segments, waves, firsts, count, from, to, playedUntil: segments[0].playedUntil };
  });
}

/** Values that were set in one act: from `first` up to, but not including, `end`. */
interface Part {
  steps: Steps;
  first: number;
  end: number;
}

/** If the act of a value is not recorded, the first value of an act may be set up to this much early. */
const EARLY_MS = 250;

function partsOf(wave: Wave, planned: readonly Steps[], act: number | null): Part[] {
  const begins = planned.map(({ from }, i) => {
    if (act !== null) return -Infinity;
    return i === 0 ? -Infinity : from - Math.min(EARLY_MS, Math.max(0, from - planned[i - 1].to) / 2);
  });
  return planned.flatMap((steps, i) => {
    if (act !== null && steps.act !== act) return [];
    const next = act === null ? (begins[i + 1] ?? Infinity) : Infinity;
    const first = wave.from(begins[i]);
    // Values that a robot sets after the stop began are no steps of the act.
    const end = Math.min(wave.from(next), wave.at(steps.playedUntil) + 1);
    return end > first ? [{ steps, first, end }] : [];
  });
}

function compare(track: Track, wave: Wave, { steps, first, end }: Part, times: Largest, values: Largest): void {
  const set = end - first;
  // A stopped act was played up to a step, any other act completely. If a robot skipped a step, it has set fewer values.
  const inOrder = steps.playedUntil < Infinity ? set <= steps.count : set === steps.count;
  for (let i = first; i < end; i++) {
    const [at, value] = [wave.time(i), wave.value(i)];
    const step = inOrder ? stepOf(steps, i - first) : likely(steps, track, at, value);
    const late = at - step.at;
    const by = value - step.value;
    if (Math.abs(late) >= LEAST_MS) times.push({ kind: "time", track, at, by: late });
    if (Math.abs(by) > tolerance(track, value)) values.push({ kind: "value", track, at, by });
  }
}

/** Half a nanosecond: the rounding error of summed times. */
const LEAST_MS = 5e-7;

interface Step {
  at: number;
  value: number;
}

function stepOf({ segments, waves, firsts }: Steps, number: number): Step {
  let s = firsts.length - 1;
  while (firsts[s] > number) s--;
  const i = number - firsts[s];
  return { at: segments[s].start + waves[s].time(i), value: waves[s].value(i) };
}

/** Steps before and after a time that are considered for a match. */
const AROUND = 4;

/** The nearest step with this value, or else the nearest step. */
function likely(steps: Steps, track: Track, at: number, value: number): Step {
  const number = before(steps, at);
  let best: Step | null = null;
  let bestFits = false;
  for (let n = Math.max(0, number - AROUND); n <= Math.min(steps.count - 1, number + 1 + AROUND); n++) {
    const step = stepOf(steps, n);
    const fits = Math.abs(step.value - value) <= tolerance(track, value);
    const nearer = best === null || Math.abs(step.at - at) < Math.abs(best.at - at);
    if (best === null || (fits && !bestFits) || (fits === bestFits && nearer)) [best, bestFits] = [step, fits];
  }
  return best ?? stepOf(steps, 0);
}

/** Number of the last step at or before a time; -1 before the first. */
function before({ segments, waves, firsts }: Steps, at: number): number {
  let s = segments.length - 1;
  while (s > 0 && segments[s].start + waves[s].time(0) > at) s--;
  return firsts[s] + waves[s].at(at - segments[s].start);
}

/** Half of the device's granularity, or else the rounding error of floats. */
function tolerance(track: Track, value: number): number {
  return Math.max((track.device.granularity ?? 0) / 2, Math.abs(value) * 1e-9, 1e-12);
}

/** Each deviation is placed at the planned start of its script, which may be long after the act's start. */
function startErrors(show: Show): Deviation[] {
  const { acts, epoch, report } = show.mission;
  return (report?.acts ?? []).flatMap((reported) => {
    const act = acts.find(({ number }) => number === reported.number);
    if (act === undefined) return [];
    return reported.robots.flatMap(({ robot, devices }) =>
      devices.flatMap(({ device, planned_start, start_error_ms: by }) => {
        const track = show.tracks.find((candidate) => candidate.robot.id === robot && candidate.device.id === device);
        if (track === undefined || by === null || by === 0) return [];
        const planned = planned_start === null ? null : millisSince(epoch, planned_start);
        return [{ kind: "start" as const, track, at: planned ?? act.start, by }];
      }),
    );
  });
}
