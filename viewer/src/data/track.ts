// One device over the whole mission: the scripts of every act in which it moves, in order.
import type { Device, Lane, Robot, Series } from "../mission";
import type { Wave, Waves } from "./wave";

/** A script of a played act. `start` and `end` are on the mission's axis. The device holds its last value until `end`. */
export interface Segment {
  start: number;
  end: number;
  /** The rest was not played: the act was stopped at this time or (`-Infinity`) withdrawn. */
  playedUntil: number;
  act: number;
  lane: Lane;
  series: Series;
}

/** Planned value of a device, and how it is known. `held`: the last value of a finished script. `unplayed`: planned, but not played. */
export interface Reading {
  value: number;
  known: "moving" | "held" | "unplayed" | "default" | "first" | "unknown";
  segment: Segment | null;
  /** Index of the last step at or before the time. */
  step: number;
}

/**
 * Position of a device according to what was played. `driven`: since `value` was known, the device has been moved by speed or
 * acceleration. `stopped`: when an act was stopped during its movement; its later position is unknown.
 */
export type Position = Reading & { driven: string | null; stopped: number | null };

export interface TrackOf {
  index: number;
  robotIndex: number;
  robot: Robot;
  deviceIndex: number;
  device: Device;
  /** Index into the values of a step, and whether there are several. */
  value: number;
  several: boolean;
}

export class Track {
  private extentOnce: { low: number; high: number } | null = null;

  readonly index: number;
  readonly robotIndex: number;
  readonly robot: Robot;
  readonly deviceIndex: number;
  readonly device: Device;
  readonly value: number;
  /** Display name: the device, and the number of its value if it has several. */
  readonly name: string;

  constructor(
    of: TrackOf,
    readonly segments: readonly Segment[],
    private readonly waves: Waves,
  ) {
    this.index = of.index;
    this.robotIndex = of.robotIndex;
    this.robot = of.robot;
    this.deviceIndex = of.deviceIndex;
    this.device = of.device;
    this.value = of.value;
    this.name = of.several ? `${of.device.id}, value ${of.value + 1}` : of.device.id;
  }

  wave(segment: Segment): Wave {
    return this.waves.of(segment.series);
  }

  /** Index of the last segment that starts at or before `ms`; -1 before the first. */
  segmentAt(ms: number): number {
    let low = 0;
    let high = this.segments.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.segments[middle].start > ms) high = middle;
      else low = middle + 1;
    }
    return low - 1;
  }

  /** The planned value. */
  at(ms: number): Reading {
    for (let s = this.segmentAt(ms); s >= 0; s--) {
      const segment = this.segments[s];
      const wave = this.wave(segment);
      const step = wave.at(ms - segment.start);
      if (step < 0) continue;
      const reading = this.readingIn(segment, step, ms);
      return ms > segment.playedUntil ? { ...reading, known: "unplayed" } : reading;
    }
    return this.beforeFirst();
  }

  /** The last known position, from what was played. */
  positionAt(ms: number): Position {
    let driven: string | null = null;
    let stopped: number | null = null;
    for (let s = this.segmentAt(ms); s >= 0; s--) {
      const segment = this.segments[s];
      if (segment.playedUntil === -Infinity) continue;
      if (ms > segment.playedUntil) stopped ??= segment.playedUntil;
      const until = Math.min(ms, segment.playedUntil);
      const step = this.wave(segment).at(until - segment.start);
      if (step < 0) continue;
      if (segment.lane.control === "position") return { ...this.readingIn(segment, step, until), driven, stopped };
      driven ??= segment.lane.control;
    }
    return { ...this.beforeFirst((segment) => segment.lane.control === "position"), driven, stopped };
  }

  /** The value that the device was last set to, of whatever control; its default before that, or `null`. */
  lastSet(ms: number): number | null {
    for (let s = this.segmentAt(ms); s >= 0; s--) {
      const segment = this.segments[s];
      if (segment.playedUntil === -Infinity) continue;
      const until = Math.min(ms, segment.playedUntil);
      const step = this.wave(segment).at(until - segment.start);
      if (step >= 0) return this.wave(segment).between(step, until - segment.start, this.device.interpolation);
    }
    return this.device.default;
  }

  private readingIn(segment: Segment, step: number, ms: number): Reading {
    const wave = this.wave(segment);
    const known = step + 1 >= wave.count ? "held" : "moving";
    return { value: wave.between(step, ms - segment.start, this.device.interpolation), known, segment, step };
  }

  private beforeFirst(counts: (segment: Segment) => boolean = () => true): Reading {
    const unmoved = { segment: null, step: -1 };
    if (this.device.default !== null) return { value: this.device.default, known: "default", ...unmoved };
    const moves = this.segments.filter((segment) => counts(segment) && this.wave(segment).count > 0);
    const first = moves.find(({ start, playedUntil }) => playedUntil > start) ?? moves[0];
    if (first === undefined) return { value: NaN, known: "unknown", ...unmoved };
    return { value: this.wave(first).value(0), known: "first", ...unmoved };
  }

  /** Smallest and largest planned value in the mission. */
  get extent(): { low: number; high: number } {
    if (this.extentOnce === null) {
      this.extentOnce = { low: Infinity, high: -Infinity };
      for (const segment of this.segments) {
        const wave = this.wave(segment);
        wave.widen(this.extentOnce, 0, wave.count);
      }
    }
    return this.extentOnce;
  }

  /** Time of the next step after (or the last before) `ms`; or `null`. */
  neighbour(ms: number, direction: 1 | -1): number | null {
    const last = this.segmentAt(ms);
    for (let s = Math.max(last, 0); s >= 0 && s < this.segments.length; s += direction) {
      const { start } = this.segments[s];
      const wave = this.wave(this.segments[s]);
      const i = direction > 0 ? wave.at(ms - start) + 1 : wave.from(ms - start) - 1;
      if (i >= 0 && i < wave.count && (start + wave.time(i) - ms) * direction > 0) return start + wave.time(i);
    }
    return null;
  }
}
