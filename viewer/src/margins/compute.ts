// How close the mission comes to its limits: distances, speeds, accelerations and the bounds of the space, over time.
import { playedUntil } from "../data/fate";
import type { Show } from "../data/show";
import { partsOf, type Core } from "../stage/parts";
import { closestPair } from "../stage/closest";
import { poses, type Pose } from "../stage/pose";
import { distance, type Point } from "../stage/space";

export type Kind = "distance" | "speed" | "acceleration" | "bounds";

export interface Series {
  kind: Kind;
  name: string;
  unit: string;
  /** The limit, and whether values have to stay above it. `null`: no limit is known. */
  limit: number | null;
  above: boolean;
  /** In order of time: when the worst value of each column occurs. */
  at: Float64Array;
  /** NaN if it is not known. */
  values: Float64Array;
  /** Robots at the worst value of each instant. */
  robots: number[][];
  /** The worst value of the whole plan as the compiler computed it; `null` if it is not known. */
  exact: { value: number; robot: number } | null;
}

/** Number of drawn instants. Each has the worst value of several sampled ones. */
const COLUMNS = 300;
/** Number of sampled places of bodies, and the smallest time between two samples. */
const [PLACES, APART_MS] = [200_000, 50];
/** Time over which speeds are measured: steps that follow each other in less time would look like jumps. */
const OVER_MS = 100;

/** Computes the series little by little: each call of `next` takes some milliseconds. */
export function* compute(show: Show): Generator<void, Series[]> {
  const { from, to } = show.mission;
  const begin = Math.max(from, 0);
  const each = Math.max(1, Math.min(Math.ceil((to - begin) / COLUMNS / APART_MS), Math.floor(PLACES / COLUMNS / Math.max(1, show.mission.robots.length))));
  const at = Float64Array.from({ length: COLUMNS }, (_, i) => begin + ((to - begin) * i) / COLUMNS);
  const make = (kind: Kind, name: string, unit: string, limit: number | null, above: boolean): Series => ({
    kind, name, unit, limit, above, at: at.slice(), values: new Float64Array(at.length).fill(NaN), robots: Array.from(at, () => []), exact: null,
  });
  const { robots, space } = show.mission;
  const least = (values: (number | null | undefined)[]) => values.reduce<number | null>((low, value) => (value != null && (low === null || value < low) ? value : low), null);
  const series = {
    distance: make("distance", "closest distance", "m", space?.distance ?? null, true),
    speed: make("speed", "highest speed", "m/s", least(robots.map(({ body }) => body?.speed)), false),
    acceleration: make("acceleration", "highest acceleration", "m/s²", least(robots.map(({ body }) => body?.acceleration)), false),
    bounds: make("bounds", "distance to the bounds", "m", 0, true),
  };
  const step = (to - begin) / COLUMNS / each;
  for (let i = 0; i < at.length; i++) {
    for (let k = 0; k < each; k++) {
      measure(show, i, at[i] + k * step, series);
      yield;
    }
  }
  addExact(show, series.distance);
  series.speed.exact = largestUse(show, "speed");
  series.acceleration.exact = largestUse(show, "acceleration");
  const known = Object.values(series).filter(({ values }) => values.some((value) => !Number.isNaN(value)));
  return known;
}

/** The closest approaches that the compiler found, which may be between two instants. */
function addExact(show: Show, { at, values, robots }: Series): void {
  for (const act of show.mission.acts) {
    const closest = show.planOf(act)?.closest ?? null;
    if (closest === null || act.start + closest.at > playedUntil(act)) continue;
    const ms = act.start + closest.at;
    const next = at.findIndex((instant) => instant >= ms);
    const i = next > 0 && ms - at[next - 1] < at[next] - ms ? next - 1 : next;
    if (i < 0 || values[i] <= closest.distance) continue;
    at[i] = ms;
    values[i] = closest.distance;
    robots[i] = closest.robots;
  }
}

function largestUse({ mission }: Show, kind: "speed" | "acceleration"): Series["exact"] {
  const played = new Set(mission.acts.map(({ plan }) => plan));
  const used = mission.plans.filter((_, plan) => played.has(plan)).flatMap(({ bodies }) => bodies ?? []);
  if (used.length === 0) return null;
  const most = used.reduce((a, b) => (b[kind] > a[kind] ? b : a));
  return { value: most[kind], robot: most.robot };
}

function measure(show: Show, i: number, ms: number, series: Record<Kind, Series>): void {
  const before = middles(poses(show, ms - OVER_MS));
  const after = middles(poses(show, ms + OVER_MS));
  const found = poses(show, ms);
  const pair = closestPair(found);
  if (pair !== null) put(series.distance, i, ms, pair.distance, pair.robots);
  for (const pose of found) {
    const [a, b] = [before.get(pose.robot), after.get(pose.robot)];
    if (pose.doubt === null && a !== undefined && b !== undefined) {
      const here = pose.frame.origin;
      put(series.speed, i, ms, distance(a, b) / (2 * OVER_MS * 1e-3), [pose.robot]);
      const bend: Point = [0, 1, 2].map((axis) => a[axis] - 2 * here[axis] + b[axis]) as unknown as Point;
      put(series.acceleration, i, ms, Math.hypot(...bend) / (OVER_MS * 1e-3) ** 2, [pose.robot]);
    }
    const room = roomOf(show, pose);
    if (room !== null && pose.doubt === null) put(series.bounds, i, ms, room, [pose.robot]);
  }
}

const middles = (found: readonly Pose[]) => new Map(found.filter(({ doubt }) => doubt === null).map((pose) => [pose.robot, pose.frame.origin]));

/** Keeps the worst value of a column, and its instant. */
function put(series: Series, i: number, ms: number, value: number, robots: number[]): void {
  const before = series.values[i];
  if (!Number.isNaN(before) && (series.above ? value >= before : value <= before)) return;
  series.values[i] = value;
  series.at[i] = ms;
  series.robots[i] = robots;
}

/** Distance of the body to the nearest side of the volume in which it has to stay; negative outside. */
function roomOf({ mission }: Show, pose: Pose): number | null {
  const keep = mission.space?.keep_in ?? null;
  if (keep === null) return null;
  let room = Infinity;
  for (const { core, radius } of partsOf(pose)) {
    const [low, high] = hull(core);
    for (const axis of [0, 1, 2]) {
      const [least, most] = [keep.least[axis], keep.most[axis]];
      if (least !== null) room = Math.min(room, low[axis] - radius - least);
      if (most !== null) room = Math.min(room, most - high[axis] - radius);
    }
  }
  return room === Infinity ? null : room;
}

function hull(core: Core): [Point, Point] {
  if (core.kind === "segment") {
    const pick = (of: (a: number, b: number) => number): Point => [0, 1, 2].map((i) => of(core.a[i], core.b[i])) as unknown as Point;
    return [pick(Math.min), pick(Math.max)];
  }
  const { frame, half } = core;
  const reach = [0, 1, 2].map((i) => frame.rows[i].reduce((sum, part, j) => sum + Math.abs(part) * half[j], 0));
  const at = (sign: number): Point => [0, 1, 2].map((i) => frame.origin[i] + sign * reach[i]) as unknown as Point;
  return [at(-1), at(1)];
}

/** The worst value of a series and its index; `null` if none is known. */
export function worst({ values, above }: Series): { value: number; index: number } | null {
  let found: { value: number; index: number } | null = null;
  values.forEach((value, index) => {
    if (Number.isNaN(value)) return;
    if (found === null || (above ? value < found.value : value > found.value)) found = { value, index };
  });
  return found;
}

export const isBeyond = ({ limit, above }: Series, value: number) => limit !== null && (above ? value < limit - 5e-4 : value > limit * 1.001);

