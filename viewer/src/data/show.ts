// An index of the document for panels and canvases, so that they need not search all acts.
import type { Cue, DeviceSeries, Ghost, Mission, Plan, Played, Report, Robot } from "../mission";
import { knownActs, playedUntil } from "./fate";
import type { Payload } from "./payload";
import { readReport } from "./report";
import { Track, type Segment } from "./track";
import { Waves, type Wave } from "./wave";

/** A cue at the time of its act: if an act is played twice, its cues are placed twice. */
export interface PlacedCue {
  index: number;
  act: number;
  plan: number;
  cueIndex: number;
  cue: Cue;
  start: number;
  end: number;
  /** The rest was not played. On the mission's axis. */
  playedUntil: number;
}

/** Values that a robot set or a sensor read. */
export interface Observed {
  source: DeviceSeries;
  wave: Wave;
}

/** Steps of the plan to which this one is compared; their times are relative to `start`. */
export interface GhostWave {
  start: number;
  wave: Wave;
}

export class Show {
  readonly mission: Mission & { report: Report | null };
  readonly tracks: Track[] = [];
  /** Tracks of each robot, in the order of its devices. */
  readonly tracksOf: Track[][];
  /** The track of each device's first value. */
  private readonly trackOfDevice: (Track | undefined)[][];
  /** Robots that were left out of each act. */
  private readonly leftOutOf: ReadonlySet<number>[];
  readonly cues: PlacedCue[];
  /** For each finding, indices into `cues` of the cues that it concerns. */
  readonly cuesOfFinding: number[][];
  private readonly ghostsOfTrack: GhostWave[][] = [];
  private readonly ghostsOfCues = new Map<number, { start: number; end: number }>();
  private readonly waves: Waves;
  private readonly clockOf: ReadonlyMap<number, Mission["clocks"][number]>;
  private readonly reportedUncertainty: ReadonlyMap<string, number>;

  constructor({ mission, columns }: Payload) {
    this.mission = { ...mission, acts: knownActs(mission), report: readReport(mission.report) };
    this.waves = new Waves(columns);
    this.clockOf = new Map(mission.clocks.map((clock) => [clock.robot, clock]));
    this.reportedUncertainty = new Map(
      (this.mission.report?.robots ?? []).flatMap(({ robot, clock }) =>
        clock === null || clock.uncertainty_ms === null ? [] : [[robot, clock.uncertainty_ms]],
      ),
    );
    this.tracksOf = mission.robots.map(() => []);
    this.trackOfDevice = mission.robots.map(() => []);
    this.leftOutOf = this.mission.acts.map(leftOut);
    this.makeTracks();
    this.cues = placeCues(this.mission);
    this.mission.compared?.ghosts.forEach((ghost) => this.placeGhost(ghost));
    this.cuesOfFinding = mission.findings.map((finding) =>
      finding.source === null ? [] : this.cuesAt(finding.source, finding.line),
    );
  }

  track(robot: number, device: number | null): Track | undefined {
    return device === null ? undefined : this.trackOfDevice[robot][device];
  }

  wave(source: DeviceSeries): Wave {
    return this.waves.of(source.series);
  }

  isLeftOut(robot: number, act: number): boolean {
    return this.leftOutOf[act]?.has(robot) ?? false;
  }

  /** Planned start of the robot's first script in an act, which may be long after the act's start. */
  plannedStart(robot: number, act: number): number {
    const played = this.mission.acts[act];
    const lanes = this.planOf(played)?.lanes.filter((lane) => lane.robot === robot) ?? [];
    const starts = lanes.flatMap((lane) => lane.scripts.map((script) => script.start));
    return played.start + (starts.length === 0 ? 0 : Math.min(...starts));
  }

  /** If a step has several values, only the first is recorded. */
  observed(kind: "set" | "read", track: Track): Observed[] {
    if (track.value !== 0) return [];
    return this.mission[kind]
      .filter((source) => source.robot === track.robotIndex && source.device === track.deviceIndex)
      .map((source) => ({ source, wave: this.wave(source) }));
  }

  /** The lane in the plan to which this one is compared, for every time that an act was played. */
  ghostsOf(track: Track): readonly GhostWave[] {
    return this.ghostsOfTrack[track.index] ?? [];
  }

  /** Position of a cue in the plan to which this one is compared, if it differs. */
  ghostOfCue(placed: PlacedCue): { start: number; end: number } | null {
    return this.ghostsOfCues.get(placed.index) ?? null;
  }

  /**
   * Uncertainty of the robot's times, in ms; 0 if its clock was not queried. The mission combines all exchanges, so its report is more
   * accurate than a single exchange.
   */
  clockUncertainty(robot: number, ms: number): number {
    const reported = this.reportedUncertainty.get(this.mission.robots[robot]?.id);
    return reported ?? this.clockAt(robot, ms)?.uncertainty ?? 0;
  }

  /** The last exchange with a robot's clock at or before `ms`, or else the first; `null` if there was none. */
  clockAt(robot: number, ms: number): { offset: number; uncertainty: number } | null {
    const clock = this.clockOf.get(robot);
    if (clock === undefined) return null;
    const [offset, uncertainty] = [this.waves.of(clock.offset), this.waves.of(clock.uncertainty)];
    if (uncertainty.count === 0 || offset.count === 0) return null;
    const i = Math.max(0, uncertainty.at(ms));
    return { offset: offset.value(Math.min(i, offset.count - 1)), uncertainty: uncertainty.value(i) };
  }

  planOf(act: Played): Plan | null {
    return act.plan === null ? null : this.mission.plans[act.plan];
  }

  /** The act that plays at `ms`, or the last act before that. */
  actAt(ms: number): number {
    const { acts } = this.mission;
    for (let i = acts.length - 1; i > 0; i--) if (acts[i].start <= ms) return i;
    return acts.length > 0 ? 0 : -1;
  }

  /** The cue that a robot plays at `ms`; the latest if there are several. */
  cueAt(robot: number, ms: number): PlacedCue | null {
    let found: PlacedCue | null = null;
    for (const placed of this.cues) {
      const plays = placed.start <= ms && ms <= placed.end && placed.cue.robots.includes(robot);
      if (plays && (found === null || placed.start >= found.start)) found = placed;
    }
    return found;
  }

  /** Cues whose lines contain this line. If there are several, those with the fewest lines. */
  cuesAt(source: number, line: number): number[] {
    const holds = this.cues.filter(({ cue }) => cue.source === source && cue.first_line <= line && line <= cue.last_line);
    const fewest = Math.min(...holds.map(({ cue }) => cue.last_line - cue.first_line));
    return holds.filter(({ cue }) => cue.last_line - cue.first_line === fewest).map(({ index }) => index);
  }

  private placeGhost(ghost: Ghost): void {
    this.mission.acts.forEach((act, index) => {
      if (act.plan !== ghost.plan) return;
      for (const lane of ghost.lanes) {
        const track = this.tracksOf[lane.robot]?.find((t) => t.deviceIndex === lane.device && t.value === (lane.value ?? 0));
        if (track === undefined) continue;
        const waves = lane.scripts.map(({ start, steps }) => ({ start: act.start + start, wave: this.waves.of(steps) }));
        (this.ghostsOfTrack[track.index] ??= []).push(...waves);
      }
      const first = this.cues.findIndex((placed) => placed.act === index);
      for (const { cue, start, end } of ghost.cues)
        this.ghostsOfCues.set(first + cue, { start: act.start + start, end: act.start + end });
    });
  }

  private makeTracks(): void {
    const { robots, set, read } = this.mission;
    const planned = new Map<string, Segment[][]>();
    this.mission.acts.forEach((act, index) => addSegments(planned, this.planOf(act), act, index));
    const observed = new Set([...set, ...read].map((source) => key(source.robot, source.device)));
    robots.forEach((robot, r) => {
      robot.devices.forEach((device, d) => {
        const values = planned.get(key(r, d)) ?? [];
        values.forEach(inOrder);
        const tells = observed.has(key(r, d)) || placesBody(robot, d);
        if (values[0] === undefined && tells) values[0] = [];
        // A value may have no lane, so there may be holes.
        values.forEach((segments, value) => {
          const track = new Track(
            { index: this.tracks.length, robotIndex: r, robot, deviceIndex: d, device, value, several: values.length > 1 },
            segments,
            this.waves,
          );
          this.tracks.push(track);
          this.tracksOf[r].push(track);
          if (value === 0) this.trackOfDevice[r][d] = track;
        });
      });
    });
  }
}

const key = (robot: number, device: number) => `${robot}/${device}`;

function placesBody(robot: Robot, device: number): boolean {
  const { body } = robot;
  if (body === null) return false;
  return [body.x, body.y, body.z, body.yaw, ...body.joints.map((joint) => joint.value)].some((c) => c.device === device);
}

const leftOut = (act: Played) => new Set(act.robots.filter((robot) => robot.left_out).map((robot) => robot.robot));

/** Adds the segments of an act to each value of each device. */
function addSegments(planned: Map<string, Segment[][]>, plan: Plan | null, act: Played, index: number): void {
  const without = leftOut(act);
  const until = playedUntil(act);
  for (const lane of plan?.lanes ?? []) {
    if (without.has(lane.robot)) continue;
    const values = planned.get(key(lane.robot, lane.device)) ?? [];
    planned.set(key(lane.robot, lane.device), values);
    const list = (values[lane.value ?? 0] ??= []);
    for (const { start, steps } of lane.scripts)
      list.push({ start: act.start + start, end: act.end, playedUntil: until, act: index, lane, series: steps });
  }
}

/** Sorts the segments of all lanes: a device plays one script at a time. */
function inOrder(segments: Segment[]): void {
  segments.sort((a, b) => a.start - b.start);
  segments.forEach((segment, i) => {
    if (i > 0) segments[i - 1].end = Math.min(segments[i - 1].end, segment.start);
  });
}

function placeCues(mission: Mission): PlacedCue[] {
  const placed: PlacedCue[] = [];
  mission.acts.forEach((act, index) => {
    if (act.plan === null) return;
    const plan = act.plan;
    mission.plans[plan].cues.forEach((cue, cueIndex) => {
      placed.push({
        index: placed.length,
        act: index,
        plan,
        cueIndex,
        cue,
        start: act.start + cue.start,
        end: act.start + cue.end,
        playedUntil: playedUntil(act),
      });
    });
  });
  return placed;
}
