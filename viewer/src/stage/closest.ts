// The two robots that are closest to each other at the playhead.
import type { Pose } from "./pose";
import { distance } from "./space";

export interface Pair {
  robots: [number, number];
  distance: number;
  betweenCentres: boolean;
  certain: boolean;
}

let latest: { poses: readonly Pose[]; pair: Pair | null } | null = null;

/** Cached, because the stage and its text request the same poses. */
export function closestPair(found: readonly Pose[]): Pair | null {
  if (latest?.poses !== found) latest = { poses: found, pair: search(found) };
  return latest.pair;
}

function search(found: readonly Pose[]): Pair | null {
  let best: Pair | null = null;
  const radii = found.map(radiusOf);
  for (let i = 0; i < found.length; i++) {
    for (let j = i + 1; j < found.length; j++) {
      const betweenCentres = radii[i] === null || radii[j] === null;
      const between =
        distance(found[i].frame.origin, found[j].frame.origin) - (betweenCentres ? 0 : (radii[i] ?? 0) + (radii[j] ?? 0));
      if (best !== null && between >= best.distance) continue;
      const certain = found[i].doubt === null && found[j].doubt === null;
      best = { robots: [found[i].robot, found[j].robot], distance: between, betweenCentres, certain };
    }
  }
  return best;
}

/** `null` if the body is not a ball, or has a chain of joints. */
function radiusOf({ body }: Pose): number | null {
  return "ball" in body.shape && body.joints.length === 0 ? body.shape.ball : null;
}
