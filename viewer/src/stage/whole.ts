// A camera with every position of a body during the mission in view.
import type { Show } from "../data/show";
import type { Camera } from "./camera";
import { poses } from "./pose";
import type { Point } from "./space";

/** Number of sampled instants. Between them, a body does not move far beyond these positions. */
const INSTANTS = 40;

export function seesAll(show: Show): Camera {
  const { from, to } = show.mission;
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i <= INSTANTS; i++) {
    for (const { frame, chain, body } of poses(show, from + ((to - from) * i) / INSTANTS)) {
      const size = "ball" in body.shape ? body.shape.ball : Math.max(...body.shape.box) / 2;
      for (const point of [frame.origin, ...chain]) widen(low, high, point, size);
    }
  }
  if (low[0] > high[0]) return { target: [0, 0, 0], reach: 1, azimuth: -0.6, elevation: 0.5 };
  const target: Point = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2];
  const reach = Math.max(high[0] - low[0], high[1] - low[1], high[2] - low[2], 0.2) / 2;
  return { target, reach: reach * 1.2, azimuth: -0.6, elevation: 0.5 };
}

function widen(low: number[], high: number[], point: Point, size: number): void {
  point.forEach((value, i) => {
    low[i] = Math.min(low[i], value - size);
    high[i] = Math.max(high[i], value + size);
  });
}
