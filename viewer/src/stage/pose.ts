// Position of a robot's body at a time, from its lanes.
import type { Body, Coordinate } from "../mission";
import type { Show } from "../data/show";
import type { Position } from "../data/track";
import { clock } from "../text/time";
import { place, rolled, scaled, shifted, turned, within, type Frame, type Point } from "./space";

export interface Pose {
  robot: number;
  body: Body;
  frame: Frame;
  yaw: number;
  /** Positions of the joints, from the first to the tip. */
  chain: Point[];
  /** Whether the position is at least roughly known: not for a robot that never moved and has no default. */
  placed: boolean;
  /** Why the position of the body is unknown; `null` if it is known. */
  doubt: string | null;
}

let latest: { show: Show; ms: number; poses: readonly Pose[] } | null = null;

/** Cached, because the stage and its text request the same instant. */
export function poses(show: Show, ms: number): readonly Pose[] {
  if (latest?.show !== show || latest.ms !== ms) {
    const found = show.mission.robots.flatMap(({ body }, robot) => (body === null ? [] : [poseOf(show, robot, body, ms)]));
    latest = { show, ms, poses: found };
  }
  return latest.poses;
}

function poseOf(show: Show, robot: number, body: Body, ms: number): Pose {
  const doubts: string[] = [];
  const unplaced: string[] = [];
  const value = (coordinate: Coordinate) => valueOf(show, robot, coordinate, ms, doubts, unplaced);
  const origin: Point = [value(body.x), value(body.y), value(body.z)];
  const yaw = value(body.yaw);
  const frame = within(shifted(origin), turned([0, 0, 1], yaw));
  const chain = chainOf(body, frame, value);
  return { robot, body, frame, yaw, chain, placed: unplaced.length === 0, doubt: doubts[0] ?? null };
}

/** Only the centre of the body, for trails. */
export function middleAt(show: Show, robot: number, body: Body, ms: number): Point {
  const value = (coordinate: Coordinate) => valueOf(show, robot, coordinate, ms, []);
  return [value(body.x), value(body.y), value(body.z)];
}

function chainOf(body: Body, base: Frame, value: (coordinate: Coordinate) => number): Point[] {
  let frame = base;
  return body.joints.map((joint) => {
    frame = within(within(frame, shifted(joint.xyz)), rolled(joint.rpy));
    if (joint.kind === "revolute") frame = within(frame, turned(joint.axis, value(joint.value)));
    if (joint.kind === "prismatic") frame = within(frame, shifted(scaled(joint.axis, value(joint.value))));
    return place(frame, [0, 0, 0]);
  });
}

function valueOf(show: Show, robot: number, { device, scale, offset }: Coordinate, ms: number, doubts: string[], unplaced: string[] = []): number {
  if (device === null) return offset;
  const track = show.track(robot, device);
  const reading = track?.positionAt(ms) ?? null;
  const doubt = doubtOf(reading);
  if (doubt !== null) doubts.push(`${show.mission.robots[robot].devices[device]?.id ?? `device ${device}`} ${doubt}`);
  const value = reading?.value ?? NaN;
  if (Number.isNaN(value)) unplaced.push("");
  return offset + (Number.isNaN(value) ? 0 : scale * value);
}

function doubtOf(reading: Position | null): string | null {
  if (reading === null) return "is not known";
  if (reading.stopped !== null) return `is not known since its act was over at ${clock(reading.stopped)}: shown where it was then`;
  if (reading.driven !== null) return `is driven by ${reading.driven}: shown where it was last known`;
  if (reading.known === "unknown") return "is not known";
  return reading.known === "first" ? "is not known before its first step" : null;
}
