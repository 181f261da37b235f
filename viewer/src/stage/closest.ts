// The two robots that are closest to each other at the playhead, from surface to surface.
import { ballAround, gap, partsOf, type Part } from "./parts";
import type { Pose } from "./pose";
import { distance, type Point } from "./space";

export interface Pair {
  robots: [number, number];
  distance: number;
}

let latest: { poses: readonly Pose[]; pair: Pair | null } | null = null;

/** Cached, because the stage and its text request the same poses. Robots whose position is unknown are ignored. */
export function closestPair(found: readonly Pose[]): Pair | null {
  if (latest?.poses !== found) latest = { poses: found, pair: search(found) };
  return latest.pair;
}

interface Candidate { robot: number; middle: Point; radius: number; pose: Pose; parts: Part[] | null }

/** Sweeps along x, so that only robots that are close to each other are compared. */
function search(found: readonly Pose[]): Pair | null {
  const known = found.filter(({ doubt }) => doubt === null);
  const all: Candidate[] = known.map((pose) => ({ robot: pose.robot, ...ballAround(pose), pose, parts: null }));
  all.sort((a, b) => a.middle[0] - a.radius - (b.middle[0] - b.radius));
  let best: Pair | null = null;
  let active: Candidate[] = [];
  for (const next of all) {
    const limit = best?.distance ?? Infinity;
    const left = next.middle[0] - next.radius;
    active = active.filter((other) => left - (other.middle[0] + other.radius) <= limit);
    for (const other of active) {
      const least = distance(next.middle, other.middle) - next.radius - other.radius;
      if (best !== null && least >= best.distance) continue;
      const between = apart(next, other);
      if (best === null || between < best.distance) best = { robots: order(other.robot, next.robot), distance: between };
    }
    active.push(next);
  }
  return best;
}

const order = (a: number, b: number): [number, number] => (a < b ? [a, b] : [b, a]);

function apart(a: Candidate, b: Candidate): number {
  a.parts ??= partsOf(a.pose);
  b.parts ??= partsOf(b.pose);
  let least = Infinity;
  for (const one of a.parts) for (const other of b.parts) least = Math.min(least, gap(one, other));
  return least;
}
