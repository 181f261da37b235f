// The document that the page shows. `scheduler/history/src/page/` writes it; both sides change together, with `version`. A test compares
// the documents of the real program with these types.
//
// The page holds it as base64 of gzip of: the length of the JSON in bytes (unsigned 32 bits, little-endian), the JSON in UTF-8 (a
// `Mission`), then the columns to which the JSON refers. All times are milliseconds by the server's clock.

/** Numbers in the bytes after the JSON. */
export interface Column {
  /** Offset of the first byte from the end of the JSON. */
  at: number;
  /** How many numbers. */
  n: number;
  /**
   * The numbers are integers divided by 10 to this power. Each integer is written as a zigzag LEB128 varint of its difference from the
   * predicted integer. `null`: the numbers are 64-bit floats, little-endian.
   */
  decimals: number | null;
  /** Prediction. 1: the previous integer (0 before the first). 2: the previous integer plus the previous difference. */
  order: 1 | 2;
}

/** Values over time. `t` never decreases; two values at the same time are a jump. */
export interface Series { t: Column; v: Column }

export interface Mission {
  version: 1;
  /** The program and its version. */
  program: string;
  kind: "dry_run" | "recording" | "journal";
  scenario: string;
  /** The instant at 0 ms, RFC 3339: the planned start of the first act. */
  epoch: string;
  /** Time range for which data exists. */
  from: number; to: number;
  /** The time of the last entry of the file. Later parts of the plan may not have been played yet. */
  known_until: number;
  /** Why the file from which the page was made is incomplete, as text; `null` if it is complete. */
  cut_off: string | null;
  /** Output of `--format json` of the same command; `null` if it is not known. May have any shape: `data/report.ts` reads it. */
  report: Report | null;
  /** Source files of the mission, for the lines of cues and findings. */
  sources: { name: string; text: string }[];
  robots: Robot[];
  groups: { name: string; robots: number[] }[];
  /** Requirements of the fleet file on the space of all bodies. */
  space: Space;
  /** Compiled acts; an act that is played twice has only one plan. */
  plans: Plan[];
  /** Acts in the order in which they were played. */
  acts: Played[];
  /** Sorted by time. */
  events: MissionEvent[];
  findings: Finding[];
  /** Values that robots set, by the server's clock; empty if they were not recorded. */
  set: DeviceSeries[];
  /** Values that sensors read. */
  read: DeviceSeries[];
  /** Clock of each robot that was queried: `offset` is robot minus server in ms, `uncertainty` is the error bound of the offset. */
  clocks: { robot: number; offset: Series; uncertainty: Series }[];
  /** Late steps, as robots reported them while they played; empty unless the mission was recorded. */
  late: Late[];
  /** The plan to which this one is compared, on the page of a diff. */
  compared?: Compared | null;
}

/** The older plan of a diff. */
export interface Compared {
  /** Its file. */
  with: string;
  differences: Difference[];
  ghosts: Ghost[];
}

export interface Difference {
  /** Index into `Mission.plans`; `null` if only the other plan has the act, or if the difference does not belong to an act. */
  plan: number | null;
  /** Relative to the act's start. */
  at: number | null;
  robot: number | null; device: number | null;
  subject: string; text: string;
}

/** The other plan's version of an act: cues at other times, and lanes that differ. */
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

/** Metres. `distance`: the least distance between the surfaces of two bodies. */
export interface Space {
  distance: number | null;
  keep_in: Volume | null;
  keep_out: { name: string; volume: Volume }[];
}

/** A box along the axes; `null` on sides without a limit. */
export interface Volume { least: Bounds; most: Bounds }
export type Bounds = [number | null, number | null, number | null];

/** Steps that were due from `from` to `to` and late by at most `most` ms, if the robot reports it. `act`: number of the act. */
export interface Late {
  robot: number; device: number; act: number;
  from: number; to: number;
  steps: number; most: number | null;
}

export interface Device {
  id: string;
  /** Display name of the robot's description; may be empty. */
  name: string;
  /** Unit of positions, as declared by the robot; may be empty. */
  unit: string;
  interpolation: "hold" | "linear";
  granularity: number | null;
  min: number | null; max: number | null;
  /** Position before anything is set, if known. */
  default: number | null;
  sensor: boolean;
}

/** Body of a robot in space. Metres and radians. */
export interface Body {
  x: Coordinate; y: Coordinate; z: Coordinate; yaw: Coordinate;
  shape: { ball: number } | { box: [number, number, number] };
  /** A chain of joints on the body; may be empty. */
  joints: Joint[];
  /** Limits of the fleet file for the middle of the body, in m/s and m/s². */
  speed: number | null; acceleration: number | null;
}

/** `offset + scale * value of the device`, or just `offset` if `device` is `null`. `device` is an index into `Robot.devices`. */
export interface Coordinate { device: number | null; scale: number; offset: number }

/** A joint, in the frame of the previous link. */
export interface Joint {
  name: string;
  kind: "revolute" | "prismatic" | "fixed";
  /** Position and rotation (roll, pitch, yaw about the fixed axes, in this order, as in URDF). */
  xyz: [number, number, number]; rpy: [number, number, number];
  /** Unit vector about which the joint turns or along which it slides. */
  axis: [number, number, number];
  /** Angle or distance. */
  value: Coordinate;
  /** Radius of the capsule from here to the next joint, or to the tip. */
  radius: number;
}

export interface Plan {
  /** Empty if the scenario has no named acts. */
  name: string;
  duration: number;
  start_tolerance: number;
  cues: Cue[];
  lanes: Lane[];
  closest: { robots: [number, number]; at: number; distance: number } | null;
  /** Largest speed in m/s and acceleration in m/s² of each body's middle. */
  bodies: { robot: number; speed: number; acceleration: number }[];
  /** Steps of each device, and the largest number that it can hold. */
  budgets: { robot: number; device: number; steps: number; budget: number }[];
  /** The condition for which the act waits, as text; empty if it does not wait. */
  waits: string;
}

export interface Cue {
  name: string;
  start: number; end: number;
  /** How much later the cue could start without delaying the end of the act. */
  slack: number;
  /** Whether the cue is on the critical path, which determines the end of the act. */
  critical: boolean;
  /** The choreographer's remark. */
  note: string | null;
  robots: number[];
  /** Index into `Mission.sources`, and lines counted from 1. */
  source: number; first_line: number; last_line: number;
  /** Its relations to other cues or to the act, as written: "after intro + 2 s". `cue` is an index into `Plan.cues`. */
  relations: { text: string; cue: number | null }[];
}

/** Movement of one device in an act. */
export interface Lane {
  robot: number;
  /** Index into `Robot.devices`. */
  device: number;
  /** Index into the values of a step, if it has several. */
  value: number;
  control: "position" | "speed" | "acceleration" | string;
  /** Largest difference between the steps and the movement as written, in the device's unit, and when it occurs. */
  worst_error: number; worst_at: number;
  /** Times of the series are relative to the start of the script, which is `start` after the act's start. */
  scripts: { start: number; steps: Series }[];
}

export interface Played {
  /** Display name. */
  name: string;
  /** Number of the act in the mission, counted from 0. */
  number: number;
  /** Index into `Mission.plans`; `null` if the plan is not known. */
  plan: number | null;
  /** Planned start and end on the axis. */
  start: number; end: number;
  /** When its requests were sent, and the ends of its phases, as far as they took place. */
  sent: number | null;
  decided: number | null;
  committed: number | null;
  no_return: number | null;
  /** When pending leases expire if they are not renewed. */
  lease: number | null;
  /**
   * How the act ended. "withdrawn": nothing of it began; "unknown": a robot has not reported its further course; "open": the end of
   * the act is not known.
   */
  fate: Fate;
  /** When it ended, was stopped or was withdrawn, if known. */
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

/** The parts of a report that the page shows, as read by `data/report.ts`. The document contains the rest, too. */
export interface Report {
  /** Why everything was stopped, as text, if the outcome and the failures do not state it. */
  because: string;
  /** Requirements of the scenario, judged by a dry run. */
  requirements: ReportedRequirement[];
  /** `null` if the outcome is not known. */
  outcome: string | Record<string, unknown> | null;
  spread_ms: number | null;
  true_spread_ms?: number | null;
  /** Every act of the scenario, including acts that were never sent. */
  course: ActCourse[];
  acts: ReportedAct[];
  robots: ReportedRobot[];
  failures: ReportedFailure[];
}

/** `fate` refers to the last time the act was played. `awaited` and `within_ms` are set if it is "timed_out". */
export interface ActCourse { act: string; fate: string; played: number; awaited: string; within_ms: number | null }

export interface ReportedAct {
  act: string; number: number | null; spread_ms: number | null;
  /** How far apart the robots could start, as known before the decision, and the tolerance. */
  skew: { predicted_ms: number | null; tolerance_ms: number | null } | null;
  robots: { robot: string; left_out: boolean; devices: ReportedDevice[] }[];
}

/** `found`: the figure that is compared with the bound; `null` if it is unknown. */
export interface ReportedRequirement {
  requirement: string; bound: string;
  value: number | null; unit: string; found: number | null;
  result: string;
}

export interface ReportedDevice {
  device: string; state: string;
  planned_start: string | null; start_error_ms: number | null;
  steps_done: number | null; steps_planned: number | null;
  late_steps: number | null; late_ms_max: number | null;
}

export interface ReportedRobot {
  robot: string; standing: string;
  start_error_ms: number | null;
  steps_done: number | null; steps_planned: number | null; late_steps: number | null; late_ms_max: number | null;
  /** `lease_ends`: RFC 3339; `null` if a script continues without a lease. */
  stop: { state: string; lease_ends: string | null } | null;
  clock: { offset_ms: number | null; uncertainty_ms: number | null } | null;
}

export interface ReportedFailure { robot: string; device: string; failure: string; text: string; error: string }
