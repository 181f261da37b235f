// The document of the page of trials. `scheduler/history/src/page/tried.rs` writes it in place of a `Mission`; it has no columns. It
// contains the output of `--format json` of the same command with the same names, but without `each`: a page of 100,000 trials is as
// small as one of a hundred. Times are milliseconds.

/** How often something was observed, with the 95 % interval of its probability. */
export interface Share { count: number; of: number; share: number | null; least: number; largest: number }

export interface Quantiles { count: number; p50_ms: number; p99_ms: number; max_ms: number }

export interface Trials {
  version: 1;
  program: string;
  kind: "trials";
  scenario: string;
  /** Name of the world; empty for the world of the fleet file. */
  world: string;
  trials: number;
  /** In decimal, as a string: it may have more digits than a JavaScript number can hold. */
  seed: string;
  /** Words of the command that replays a trial, without `--trial K`. */
  replay: string[];
  starts: Share;
  finishes: Share;
  aborts: Share;
  mixed: Share;
  /** Most frequent first. */
  outcomes: [name: string, share: Share][];
  /** Largest true spread of the starts of a mission, over the missions in which all robots of an act began. */
  spread: Quantiles | null;
  histogram: Histogram | null;
  acts: TriedAct[];
  lead: { had: Quantiles; enough: Quantiles; undecided: number } | null;
  /** Most frequent first. */
  reasons: Reason[];
  robots: TriedRobot[];
  weakest_robot: string | null;
  weakest_link: string | null;
  requirements: Requirement[];
}

/** Of the spread: `counts[i]` missions from `i * width_ms` up to, but not including, `(i + 1) * width_ms`. */
export interface Histogram {
  width_ms: number;
  counts: number[];
  /** Number of missions above the last interval. */
  beyond: number;
}

export interface TriedAct {
  act: string;
  starts: Share;
  spread: Quantiles | null;
  tolerance_ms: number;
  beyond_tolerance: Share;
}

export interface Reason {
  /** The robot that failed first. */
  robot: string | null;
  kind: string;
  share: Share;
  /** The first trial with this reason, and its message. */
  example: number;
  text: string;
}

export interface TriedRobot {
  robot: string;
  fails_first: Share;
  /** Time from sending an act until the robot had accepted its scripts. */
  accepts_within: Quantiles | null;
  accepts_last: Share;
  reconnects: Share;
}

export interface Requirement {
  requirement: string;
  bound: string;
  value: number;
  unit: string;
  found: number | null;
  result: "met" | "not_met" | "not_known";
  note?: string;
}
