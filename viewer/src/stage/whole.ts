// Every position of a body during the mission, and the cameras that show all of them.
import type { Show } from "../data/show";
import { fixturesOf } from "../data/lamps";
import { fitted, type Camera, type Preset } from "./camera";
import { poses } from "./pose";
import type { Point } from "./space";

/** Number of sampled instants. Between them, a body does not move far beyond these positions. */
const INSTANTS = 40;
/** The most positions that are sampled. */
const POSITIONS = 20_000;

interface Extent {
  points: Point[];
  /** The largest radius of a body. */
  room: number;
}

const known = new WeakMap<Show, Extent>();

function extentOf(show: Show): Extent {
  let extent = known.get(show);
  if (extent === undefined) {
    extent = sample(show);
    known.set(show, extent);
  }
  return extent;
}

function sample(show: Show): Extent {
  const { robots, to } = show.mission;
  const extent: Extent = { points: [], room: 0 };
  const instants = Math.max(4, Math.min(INSTANTS, Math.floor(POSITIONS / Math.max(1, robots.length))));
  const from = Math.max(show.mission.from, 0);
  for (let i = 0; i <= instants; i++) {
    for (const { frame, chain, body, placed } of poses(show, from + ((to - from) * i) / instants)) {
      if (!placed) continue;
      const size = "ball" in body.shape ? body.shape.ball : Math.max(...body.shape.box) / 2;
      extent.room = Math.max(extent.room, size);
      extent.points.push(frame.origin, ...chain);
    }
  }
  return extent;
}

let latest: { show: Show; key: string; camera: Camera } | null = null;

/** Cached, because every frame requests the same camera. */
export function seesAll(show: Show, preset: Preset, width: number, height: number): Camera {
  const key = `${preset} ${width} ${height}`;
  if (latest?.show !== show || latest.key !== key) {
    const { points, room } = extentOf(show);
    latest = { show, key, camera: fitted(points, preset, Math.max(1, width), Math.max(1, height), room) };
  }
  return latest.camera;
}

/** Lights in the air are seen from the audience; everything else obliquely from above. */
export function firstPreset(show: Show): Preset {
  const { points } = extentOf(show);
  const heights = points.map(([, , z]) => z);
  const rises = heights.reduce((most, z) => Math.max(most, z), 0) > 2;
  return rises && fixturesOf(show).length > 0 ? "audience" : "space";
}
