// The document, indexed: what the panels and canvases ask for, without a look at every act each time.
import type { Cue, Device, DeviceSeries, Mission, Plan, Played, Robot } from "../mission";
import type { Payload } from "./payload";
import { Track, type Segment } from "./track";
import { Waves, type Wave } from "./wave";

/** A cue where it was played: an act that is played twice places its cues twice. */
export interface PlacedCue {
  index: number;
  act: number;
  plan: number;
  cueIndex: number;
  cue: Cue;
  start: number;
  end: number;
}

/** What a robot set or a sensor read. */
export interface Observed {
  source: DeviceSeries;
  wave: Wave;
}

export class Show {
  readonly mission: Mission;
  readonly tracks: Track[] = [];
  /** Tracks of each robot, in the order of its devices. */
  readonly tracksOf: Track[][];
  private readonly trackOfDevice: (Track | undefined)[][];
  readonly cues: PlacedCue[];
  /** Indices into `cues` of what each finding is about. */
  readonly cuesOfFinding: number[][];
  private readonly waves: Waves;
  private readonly clockOf: ReadonlyMap<number, Mission["clocks"][number]>;

  constructor({ mission, columns }: Payload) {
    this.mission = mission;
    this.waves = new Waves(columns);
    this.clockOf = new Map(mission.clocks.map((clock) => [clock.robot, clock]));
    this.tracksOf = mission.robots.map(() => []);
    this.trackOfDevice = mission.robots.map(() => []);
    this.makeTracks();
    this.cues = placeCues(mission);
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

  observed(kind: "set" | "read", track: Track): Observed[] {
    return this.mission[kind]
      .filter((source) => source.robot === track.robotIndex && source.device === track.deviceIndex)
      .map((source) => ({ source, wave: this.wave(source) }));
  }

  /** How far off a time of this robot may be, in ms; 0 where nobody asked its clock. */
  clockUncertainty(robot: number, ms: number): number {
    const clock = this.clockOf.get(robot);
    if (clock === undefined) return 0;
    const wave = this.waves.of(clock.uncertainty);
    if (wave.count === 0) return 0;
    return wave.value(Math.max(0, wave.at(ms)));
  }

  planOf(act: Played): Plan | null {
    return act.plan === null ? null : this.mission.plans[act.plan];
  }

  /** The act that plays at `ms`, or the last before. */
  actAt(ms: number): number {
    const { acts } = this.mission;
    for (let i = acts.length - 1; i > 0; i--) if (acts[i].start <= ms) return i;
    return acts.length > 0 ? 0 : -1;
  }

  /** The cue that a robot plays at `ms`; the latest if several do. */
  cueAt(robot: number, ms: number): PlacedCue | null {
    let found: PlacedCue | null = null;
    for (const placed of this.cues) {
      const plays = placed.start <= ms && ms <= placed.end && placed.cue.robots.includes(robot);
      if (plays && (found === null || placed.start >= found.start)) found = placed;
    }
    return found;
  }

  /** Cues whose lines contain this one; the cue with the fewest lines if several do. */
  cuesAt(source: number, line: number): number[] {
    const holds = this.cues.filter(({ cue }) => cue.source === source && cue.first_line <= line && line <= cue.last_line);
    const fewest = Math.min(...holds.map(({ cue }) => cue.last_line - cue.first_line));
    return holds.filter(({ cue }) => cue.last_line - cue.first_line === fewest).map(({ index }) => index);
  }

  private makeTracks(): void {
    const { robots, set, read } = this.mission;
    const segments = new Map<string, Segment[]>();
    this.mission.acts.forEach((act, index) => addSegments(segments, this.planOf(act), act, index));
    const known = new Set([...segments.keys(), ...[...set, ...read].map((source) => key(source.robot, source.device))]);
    robots.forEach((robot, r) => {
      robot.devices.forEach((device, d) => {
        const moves = known.has(key(r, d)) || placesBody(robot, d);
        if (moves) this.addTrack(robot, r, device, d, segments.get(key(r, d)) ?? []);
      });
    });
  }

  private addTrack(robot: Robot, r: number, device: Device, d: number, segments: Segment[]): void {
    const track = new Track(this.tracks.length, r, robot, d, device, segments, this.waves);
    this.tracks.push(track);
    this.tracksOf[r].push(track);
    this.trackOfDevice[r][d] = track;
  }
}

const key = (robot: number, device: number) => `${robot}/${device}`;

function placesBody(robot: Robot, device: number): boolean {
  const { body } = robot;
  if (body === null) return false;
  return [body.x, body.y, body.z, body.yaw, ...body.joints.map((joint) => joint.value)].some((c) => c.device === device);
}

function addSegments(segments: Map<string, Segment[]>, plan: Plan | null, act: Played, index: number): void {
  const leftOut = new Set(act.robots.filter((robot) => robot.left_out).map((robot) => robot.robot));
  for (const lane of plan?.lanes ?? []) {
    if (leftOut.has(lane.robot)) continue;
    const list = segments.get(key(lane.robot, lane.device)) ?? [];
    segments.set(key(lane.robot, lane.device), list);
    for (const script of lane.scripts) {
      const start = act.start + script.start;
      const before = list[list.length - 1];
      if (before !== undefined) before.end = Math.min(before.end, start);
      list.push({ start, end: act.end, act: index, lane, series: script.steps });
    }
  }
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
      });
    });
  });
  return placed;
}
