// The two robots that are closest to each other now.
import type { Pose } from "./pose";
import { distance } from "./space";

export interface Pair { robots: [number, number]; distance: number; betweenCentres: boolean }

export function closestPair(found: readonly Pose[]): Pair | null {
  let best: Pair | null = null;
  for (let i = 0; i < found.length; i++) {
    for (let j = i + 1; j < found.length; j++) {
      const pair = measure(found[i], found[j]);
      if (best === null || pair.distance < best.distance) best = pair;
    }
  }
  return best;
}

function measure(a: Pose, b: Pose): Pair {
  const between = distance(a.frame.origin, b.frame.origin);
  const radii = [a, b].map(({ body }) => ("ball" in body.shape && body.joints.length === 0 ? body.shape.ball : null));
  const balls = radii[0] !== null && radii[1] !== null;
  return { robots: [a.robot, b.robot], distance: balls ? between - (radii[0] ?? 0) - (radii[1] ?? 0) : between, betweenCentres: !balls };
}
