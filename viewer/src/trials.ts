// The document of the page of trials. `scheduler/history/src/page/tried.rs` writes it in the place of a `Mission`; it has no columns. What
// `--format json` of the same command prints is here in the same words, without `each`: a page of 100,000 trials is as small as one
// of a hundred. Times are milliseconds.

/** How often something was seen, with the 95 % interval of its probability. */
export interface Share { count: number; of: number; share: number | null; least: number; largest: number }

export interface Quantiles { count: number; p50_ms: number; p99_ms: number; max_ms: number }

export interface Trials {
  version: 1;
  program: string;
  kind: "trials";
  scenario: string;
  /** Its name; empty: the world of the fleet file. */
  world: string;
  trials: number;
  /** In decimal: more digits than a number of JavaScript holds. */
  seed: string;
  /** The words of the command that plays one of them again, but for `--trial K`. */
  replay: string[];
  starts: Share;
  finishes: Share;
  aborts: Share;
  mixed: Share;
  /** The most frequent first. */
  outcomes: [name: string, share: Share][];
  /** Largest true spread of the starts of a mission, over those in which all robots of an act began. */
  spread: Quantiles | null;
  histogram: Histogram | null;
  acts: TriedAct[];
  lead: { had: Quantiles; enough: Quantiles; undecided: number } | null;
  /** The most frequent first. */
  reasons: Reason[];
  robots: TriedRobot[];
  weakest_robot: string | null;
  weakest_link: string | null;
  requirements: Requirement[];
}

/** Of the spread: `counts[i]` missions from `i * width_ms` up to, and without, `(i + 1) * width_ms`. */
export interface Histogram {
  width_ms: number;
  counts: number[];
  /** Missions beyond the last of these. */
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
  /** The first trial of which it is true, and what was said there. */
  example: number;
  text: string;
}

export interface TriedRobot {
  robot: string;
  fails_first: Share;
  /** From the sending of an act until it had accepted its scripts. */
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
