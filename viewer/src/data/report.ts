// Extracts the report from JSON of any shape. Values of an unexpected shape are treated as unknown.
import type { ActCourse, Report, ReportedAct, ReportedFailure, ReportedRequirement, ReportedRobot } from "../mission";

export function readReport(json: unknown): Report | null {
  if (!isObject(json)) return null;
  return {
    outcome: outcomeOf(json.outcome),
    spread_ms: number(json.spread_ms),
    ...("true_spread_ms" in json && { true_spread_ms: number(json.true_spread_ms) }),
    because: text(json.because),
    requirements: objects(json.requirements).map(requirement),
    course: objects(json.course).map(course),
    acts: objects(json.acts).map(act),
    robots: objects(json.robots)
      .map(robot)
      .filter((row) => row.robot !== ""),
    failures: objects(json.failures).map(failure),
  };
}

function outcomeOf(json: unknown): Report["outcome"] {
  if (typeof json === "string" && json !== "") return json;
  return isObject(json) && Object.keys(json).length > 0 ? json : null;
}

const course = (json: Fields): ActCourse => ({
  act: text(json.act),
  fate: text(json.fate),
  played: number(json.played) ?? 0,
  awaited: text(json.awaited),
  within_ms: number(json.within_ms),
});

const act = (json: Fields): ReportedAct => ({
  act: text(json.act),
  number: number(json.number),
  spread_ms: number(json.spread_ms),
  skew: isObject(json.skew)
    ? { predicted_ms: number(json.skew.predicted_ms), tolerance_ms: number(json.skew.tolerance_ms) }
    : null,
  robots: objects(json.robots).map((row) => ({
    robot: text(row.robot),
    left_out: row.left_out === true,
    devices: objects(row.devices).map((device) => ({
      device: text(device.device),
      state: text(device.state),
      planned_start: instant(device.planned_start),
      start_error_ms: number(device.start_error_ms),
      ...steps(device),
    })),
  })),
});

const robot = (json: Fields): ReportedRobot => ({
  robot: text(json.robot),
  standing: text(json.standing),
  start_error_ms: number(json.start_error_ms),
  ...steps(json),
  stop: isObject(json.stop) ? { state: text(json.stop.state), lease_ends: instant(json.stop.lease_ends) } : null,
  clock: isObject(json.clock)
    ? { offset_ms: number(json.clock.offset_ms), uncertainty_ms: number(json.clock.uncertainty_ms) }
    : null,
});

const steps = (json: Fields) => ({
  steps_done: number(json.steps_done),
  steps_planned: number(json.steps_planned),
  late_steps: number(json.late_steps),
  late_ms_max: number(json.late_ms_max),
});

const requirement = (json: Fields): ReportedRequirement => ({
  requirement: text(json.requirement),
  bound: text(json.bound),
  value: number(json.value),
  unit: text(json.unit),
  found: number(json.found),
  result: text(json.result),
});

const failure = (json: Fields): ReportedFailure => ({
  robot: text(json.robot),
  device: text(json.device),
  failure: text(json.failure),
  text: text(json.text),
  error: isObject(json.error) ? text(json.error.message) : "",
});

type Fields = Record<string, unknown>;

const isObject = (json: unknown): json is Fields => typeof json === "object" && json !== null && !Array.isArray(json);
const objects = (json: unknown): Fields[] => (Array.isArray(json) ? json.filter(isObject) : []);
const text = (json: unknown): string => (typeof json === "string" ? json : "");
const instant = (json: unknown): string | null => (typeof json === "string" ? json : null);
const number = (json: unknown): number | null => (typeof json === "number" && Number.isFinite(json) ? json : null);
