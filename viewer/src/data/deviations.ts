// Where robots differ from the plan: values that they set at another time, other values than planned, and starts that were off.
import type { Show } from "./show";
import type { Segment, Track } from "./track";

export interface Deviation {
  kind: "time" | "value" | "start";
  track: Track;
  /** When it was, on the mission's axis. */
  at: number;
  /** In ms, or in the device's unit: what was, minus what was planned. */
  by: number;
}

/** More than this many of a kind are no list to read. */
export const KEPT = 300;

/** Comparing more values would stop the page for seconds. */
const MOST_VALUES = 1_000_000;

/** Whether all lanes can be compared at once, or only those whose curves are shown. */
export function comparesAll({ mission }: Show): boolean {
  return mission.set.reduce((sum, { series }) => sum + series.v.n, 0) <= MOST_VALUES;
}

/** Starts first, then times, then values; in each kind the largest first. Values of different units are compared by the lane's extent. */
export function deviations(show: Show, tracks: readonly Track[]): Deviation[] {
  const times = new Largest(inMs);
  const values = new Largest(inExtents);
  for (const track of tracks) {
    for (const { wave, source } of show.observed("set", track)) {
      const segments = track.segments.filter((segment) => source.act === null || segment.act === source.act);
      for (let i = 0; i < wave.count; i++) compare(track, segments, wave.time(i), wave.value(i), times, values);
    }
  }
  const starts = new Largest(inMs);
  for (const error of startErrors(show)) starts.push(error);
  return [...starts.sorted(), ...times.sorted(), ...values.sorted()];
}

const inMs = ({ by }: Deviation) => Math.abs(by);
const inExtents = ({ by, track }: Deviation) => Math.abs(by) / (track.extent.high - track.extent.low || 1);

/** Keeps the largest, without a list of all. */
class Largest {
  private list: Deviation[] = [];

  constructor(private readonly size: (deviation: Deviation) => number) {}

  push(deviation: Deviation): void {
    this.list.push(deviation);
    if (this.list.length >= 4 * KEPT) this.list = this.sorted();
  }

  sorted(): Deviation[] {
    return this.list.sort((a, b) => this.size(b) - this.size(a)).slice(0, KEPT);
  }
}

function compare(track: Track, segments: readonly Segment[], at: number, value: number, times: Largest, values: Largest): void {
  const segment = last(segments, at) ?? segments[0];
  if (segment === undefined) return;
  const wave = track.wave(segment);
  if (wave.count === 0) return;
  const local = at - segment.start;
  const step = nearest(wave, local);
  const late = local - wave.time(step);
  const close = Math.abs(value - wave.value(step)) <= tolerance(track, value);
  if (close) {
    if (late !== 0) times.push({ kind: "time", track, at, by: late });
    return;
  }
  const planned = wave.valueAt(Math.max(local, wave.time(0)), track.device.interpolation);
  const by = value - planned;
  if (Math.abs(by) > tolerance(track, value)) values.push({ kind: "value", track, at, by });
}

/** Half of the device's granularity; without one, what floats lose. */
function tolerance(track: Track, value: number): number {
  return Math.max((track.device.granularity ?? 0) / 2, Math.abs(value) * 1e-9, 1e-12);
}

function last(segments: readonly Segment[], at: number): Segment | undefined {
  let found: Segment | undefined;
  for (const segment of segments) if (segment.start <= at) found = segment;
  return found;
}

function nearest(wave: { at: (ms: number) => number; time: (i: number) => number; count: number }, ms: number): number {
  const before = Math.max(0, wave.at(ms));
  const after = Math.min(before + 1, wave.count - 1);
  return Math.abs(wave.time(after) - ms) < Math.abs(wave.time(before) - ms) ? after : before;
}

function startErrors(show: Show): Deviation[] {
  const { acts, report } = show.mission;
  return (report?.acts ?? []).flatMap((reported) => {
    const act = acts.find(({ number }) => number === reported.number);
    if (act === undefined) return [];
    return reported.robots.flatMap((robot) =>
      robot.devices.flatMap((device) => {
        const track = show.tracks.find(
          (candidate) => candidate.robot.id === robot.robot && candidate.device.id === device.device,
        );
        const by = device.start_error_ms;
        return track === undefined || by === null || by === 0 ? [] : [{ kind: "start" as const, track, at: act.start, by }];
      }),
    );
  });
}
