// What became of each robot: its steps, its lateness, its failures and its stop, from the report, the events and the recording.
import type { Late, MissionEvent, ReportedAct, ReportedRobot } from "../mission";
import { millisSince } from "../text/instant";
import type { Show } from "./show";

export interface RobotState {
  robot: number;
  id: string;
  stepsDone: number | null;
  stepsPlanned: number | null;
  lateSteps: number;
  /** Largest lateness in ms; `null` if it is not known. */
  lateMost: number | null;
  /** When the robot was late, in order of time; empty if that is not known. */
  late: readonly Late[];
  clock: { offset_ms: number | null; uncertainty_ms: number | null } | null;
  /** The first failure, and when it was noticed. */
  failure: { at: number | null; text: string } | null;
  /** `null` if no stop was sent, or if it is not known. */
  stop: Stop | null;
  leftOut: boolean;
  startError: number | null;
}

/** `until`: when the robot stops by itself if its stop was not confirmed; on the mission's axis. */
export interface Stop { confirmed: boolean; until: number | null; text: string }

const known = new WeakMap<Show, readonly RobotState[]>();

export function robotStates(show: Show): readonly RobotState[] {
  let states = known.get(show);
  if (states === undefined) {
    states = show.mission.robots.map((robot, index) => stateOf(show, index, robot.id));
    known.set(show, states);
  }
  return states;
}

/** Worst first: failures, unconfirmed stops, late steps; then in the order of the fleet. */
export function gravity({ failure, stop, lateSteps }: RobotState): number {
  if (failure !== null) return 3;
  if (stop !== null && !stop.confirmed) return 2;
  return lateSteps > 0 ? 1 : 0;
}

function stateOf(show: Show, robot: number, id: string): RobotState {
  const { report, events, late } = show.mission;
  const reported = report?.robots.find((row) => row.robot === id) ?? null;
  const acts = sumOfActs(report?.acts ?? [], id);
  const own = events.filter((event) => event.robot === robot);
  const steps = reported ?? acts;
  return {
    robot,
    id,
    stepsDone: steps.steps_done,
    stepsPlanned: steps.steps_planned,
    lateSteps: steps.late_steps ?? 0,
    lateMost: steps.late_ms_max,
    late: (late ?? []).filter((part) => part.robot === robot),
    clock: reported?.clock ?? clockOf(show, robot),
    failure: failureOf(show, id, own),
    stop: stopOf(show, reported, own),
    leftOut: reported?.standing === "dropped" || own.some(({ kind }) => kind === "dropped"),
    startError: reported?.start_error_ms ?? acts.start_error_ms,
  };
}

type Sums = Pick<ReportedRobot, "steps_done" | "steps_planned" | "late_steps" | "late_ms_max" | "start_error_ms">;

/** Recordings of older versions, and journals, have results only for each act. */
function sumOfActs(acts: readonly ReportedAct[], id: string): Sums {
  const devices = acts.flatMap(({ robots }) => robots.filter((row) => row.robot === id).flatMap((row) => row.devices));
  const sum = (of: (device: (typeof devices)[number]) => number | null) =>
    devices.length === 0 ? null : devices.reduce((total, device) => total + (of(device) ?? 0), 0);
  const largest = (values: (number | null)[]) =>
    values.reduce((most, value) => (value !== null && (most === null || Math.abs(value) > Math.abs(most)) ? value : most), null);
  return {
    steps_done: sum((device) => device.steps_done),
    steps_planned: sum((device) => device.steps_planned),
    late_steps: sum((device) => device.late_steps),
    late_ms_max: largest(devices.map((device) => device.late_ms_max)),
    start_error_ms: largest(devices.map((device) => device.start_error_ms)),
  };
}

function clockOf(show: Show, robot: number): RobotState["clock"] {
  const clock = show.clockAt(robot, Infinity);
  return clock === null ? null : { offset_ms: clock.offset, uncertainty_ms: clock.uncertainty };
}

const FAILED = ["failed", "link_lost"];

function failureOf(show: Show, id: string, own: readonly MissionEvent[]): RobotState["failure"] {
  // A lost link that comes back is no failure.
  const event = own.find(({ kind }) => kind === "failed");
  if (event !== undefined) {
    const lost = own.find(({ kind, at }) => FAILED.includes(kind) && at <= event.at) ?? event;
    return { at: lost.at, text: event.text };
  }
  const reported = show.mission.report?.failures.find(({ robot }) => robot === id);
  if (reported === undefined) return null;
  return { at: null, text: reported.text || reported.error || reported.failure.replaceAll("_", " ") };
}

const STATES: Record<string, string> = {
  confirmed: "confirmed",
  home: "goes to its default positions",
  taken_over: "not stopped: driven by another mission",
};

function stopOf(show: Show, reported: ReportedRobot | null, own: readonly MissionEvent[]): Stop | null {
  const state = reported?.stop?.state ?? "";
  if (state in STATES) return { confirmed: state !== "taken_over", until: null, text: STATES[state] };
  if (state === "unconfirmed") {
    const until = millisSince(show.mission.epoch, reported?.stop?.lease_ends ?? "");
    return { confirmed: false, until, text: until === null ? "not confirmed; it has no lease" : "not confirmed" };
  }
  if (state === "not_sent" || !show.mission.events.some(({ kind }) => kind === "stopping")) return null;
  const confirmed = own.some(({ kind }) => kind === "at_rest" || kind === "stop_confirmed");
  return { confirmed, until: null, text: confirmed ? "confirmed" : "not confirmed" };
}
