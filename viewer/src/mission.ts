// The document that the page shows. `scheduler/history/src/page/` writes it; both sides change together, with `version`. A test
// compares the documents of the real program with these types.
//
// The page holds it as base64 of gzip of: the length of the JSON in bytes (unsigned 32 bits, little-endian), the JSON in UTF-8
// (a `Mission`), then the columns that the JSON points into. All times are milliseconds by the server's clock.

/** Numbers, in the bytes behind the JSON. */
export interface Column {
  /** Offset of the first byte, from the first byte behind the JSON. */
  at: number;
  /** How many numbers. */
  n: number;
  /**
   * The numbers are integers divided by 10 to the power of this, each integer written as a zigzag LEB128 varint of its difference
   * from what was expected. `null`: the numbers are 64-bit floats, little-endian.
   */
  decimals: number | null;
  /** What was expected: 1: the integer before (0 before the first). 2: the integer before plus the difference before that. */
  order: 1 | 2;
}

/** Values over time. `t` never goes back; two values at one time are a jump. */
export interface Series { t: Column; v: Column }

export interface Mission {
  version: 1;
  /** The program and its version. */
  program: string;
  kind: "dry_run" | "recording" | "journal";
  scenario: string;
  /** The instant at 0 ms, RFC 3339: the planned start of the first act. */
  epoch: string;
  /** From when to when something is known. */
  from: number; to: number;
  /** Why the file behind the page is not whole, for people; `null`: it is whole. */
  cut_off: string | null;
  /** What `--format json` of the same command prints; `null` where it is not known. `data/report.ts` reads it: it may have any shape. */
  report: Report | null;
  /** Files that the mission was made of, for the lines of cues and findings. */
  sources: { name: string; text: string }[];
  robots: Robot[];
  groups: { name: string; robots: number[] }[];
  /** Compiled acts; an act that is played twice has one plan. */
  plans: Plan[];
  /** Acts as they were played, in order. */
  acts: Played[];
  /** What happened, in order of time. */
  events: MissionEvent[];
  findings: Finding[];
  /** What robots set, by the server's clock; empty where nothing tells. */
  set: DeviceSeries[];
  /** What sensors read. */
  read: DeviceSeries[];
  /** Clock of each robot that was asked: `offset` is robot minus server in ms, `uncertainty` how far off that may be. */
  clocks: { robot: number; offset: Series; uncertainty: Series }[];
  /** What it is compared with, on the page of a diff. */
  compared?: Compared | null;
}

/** Another plan, of which this one is a change. */
export interface Compared {
  /** Its file. */
  with: string;
  differences: Difference[];
  ghosts: Ghost[];
}

export interface Difference {
  /** Index into `Mission.plans`; `null` if only the other has the act, or for what is about no act. */
  plan: number | null;
  /** From the act's start. */
  at: number | null;
  robot: number | null; device: number | null;
  subject: string; text: string;
}

/** What the other plan has in the act of this plan: cues that are elsewhere there, and lanes that differ. */
export interface Ghost {
  plan: number;
  /** `cue`: index into `Plan.cues`. */
  cues: { cue: number; start: number; end: number }[];
  lanes: Lane[];
}

export interface Robot {
  id: string;
  devices: Device[];
  body: Body | null;
}

export interface Device {
  id: string;
  /** Of positions, as the robot declares it; may be empty. */
  unit: string;
  interpolation: "hold" | "linear";
  granularity: number | null;
  min: number | null; max: number | null;
  /** Where it is before anything is set, if that is known. */
  default: number | null;
  sensor: boolean;
}

/** What a robot is in space. Metres and radians. */
export interface Body {
  x: Coordinate; y: Coordinate; z: Coordinate; yaw: Coordinate;
  shape: { ball: number } | { box: [number, number, number] };
  /** A chain of joints on the body; empty without one. */
  joints: Joint[];
}

/** `offset + scale * value of the device`, or always `offset` where `device` is `null`. `device` is an index into `Robot.devices`. */
export interface Coordinate { device: number | null; scale: number; offset: number }

/** A joint, in the frame of the link before it. */
export interface Joint {
  name: string;
  kind: "revolute" | "prismatic" | "fixed";
  /** Where it is, and its rotation (roll, pitch, yaw about the fixed axes, in this order, as in URDF). */
  xyz: [number, number, number]; rpy: [number, number, number];
  /** Unit vector about which it turns or along which it slides. */
  axis: [number, number, number];
  /** Angle or way. */
  value: Coordinate;
  /** Radius of the capsule from here to the next joint, or to the tip. */
  radius: number;
}

export interface Plan {
  /** Empty for a scenario without acts of its own. */
  name: string;
  duration: number;
  start_tolerance: number;
  cues: Cue[];
  lanes: Lane[];
  closest: { robots: [number, number]; at: number; distance: number } | null;
  /** What the act waits for, for people; empty: for nothing. */
  waits: string;
}

export interface Cue {
  name: string;
  start: number; end: number;
  /** How much later it could start without the act ending later. */
  slack: number;
  /** It is on the way that determines when the act ends. */
  critical: boolean;
  robots: number[];
  /** Index into `Mission.sources`, and lines counted from 1. */
  source: number; first_line: number; last_line: number;
  /** Its relations to other cues or to the act, as written: "after intro + 2 s". `cue` is an index into `Plan.cues`. */
  relations: { text: string; cue: number | null }[];
}

/** What one device does in an act. */
export interface Lane {
  robot: number;
  /** Index into `Robot.devices`. */
  device: number;
  /** Which of several values of a step, counted from 0. */
  value: number;
  control: "position" | "speed" | "acceleration" | string;
  /** Largest difference between the steps and the movement as written, in the device's unit, and when that is. */
  worst_error: number; worst_at: number;
  /** Times of the series are from the start of the script, which is `start` after the act's. */
  scripts: { start: number; steps: Series }[];
}

export interface Played {
  /** As people know it. */
  name: string;
  /** Which of the mission's acts, counted from 0. */
  number: number;
  /** Index into `Mission.plans`; `null` if the plan is not known. */
  plan: number | null;
  /** Planned start and end on the axis. */
  start: number; end: number;
  /** When its requests were sent, and the limits of its phases, if they took place. */
  sent: number | null;
  decided: number | null;
  committed: number | null;
  no_return: number | null;
  /** When pending leases end if they are not renewed. */
  lease: number | null;
  /**
   * What became of it. "withdrawn": nothing of it began; "unknown": a robot has not said how it went on; "open": its end is not
   * known.
   */
  fate: Fate;
  /** When it ended, was stopped or was withdrawn, if that is known. */
  over: number | null;
  robots: { robot: number; left_out: boolean; started: number | null; ended: number | null }[];
}

export type Fate = "played" | "stopped" | "withdrawn" | "unknown" | "open";

export interface MissionEvent {
  at: number;
  /** As on the topic /mission/progress of a recording: "preparing", "accepted", "decided", "failed", ... */
  kind: string;
  robot: number | null;
  text: string;
}

export interface Finding {
  code: string; severity: "error" | "warning";
  message: string; hint: string | null;
  source: number | null; line: number; column: number;
}

export interface DeviceSeries { robot: number; device: number; act: number | null; series: Series }

/** The parts of a report that the page shows, as `data/report.ts` reads them; the rest is in the document, too. */
export interface Report {
  /** `null`: its end is not known. */
  outcome: string | Record<string, unknown> | null;
  spread_ms: number | null;
  true_spread_ms?: number | null;
  /** Every act of the scenario, also those that were never sent. */
  course: ActCourse[];
  acts: ReportedAct[];
  robots: ReportedRobot[];
  failures: ReportedFailure[];
}

/** `fate`: of the last time; `awaited` and `within_ms` where it is "timed_out". */
export interface ActCourse { act: string; fate: string; played: number; awaited: string; within_ms: number | null }

export interface ReportedAct {
  act: string; number: number | null; spread_ms: number | null;
  robots: { robot: string; left_out: boolean; devices: { device: string; planned_start: string | null; start_error_ms: number | null }[] }[];
}

export interface ReportedRobot {
  robot: string; standing: string;
  start_error_ms: number | null;
  steps_done: number | null; steps_planned: number | null; late_steps: number | null;
  clock: { offset_ms: number | null; uncertainty_ms: number | null } | null;
}

export interface ReportedFailure { robot: string; device: string; failure: string; text: string; error: string }
