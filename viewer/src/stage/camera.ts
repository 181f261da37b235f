// View of the stage: from above without perspective, or from any direction with perspective.
import type { Point } from "./space";

export interface Camera {
  /** The point at the centre of the view. */
  target: Point;
  /** Half of the visible extent, in metres. */
  reach: number;
  /** Direction of the camera: rotation about the vertical, and elevation above the ground; radians. */
  azimuth: number;
  elevation: number;
  /** Whether the view is a map without perspective, with x to the right and y upwards. */
  map: boolean;
}

/** Views with a name. The audience is at negative y and looks along y. */
export const PRESETS = {
  audience: { name: "Audience", azimuth: 0, elevation: 0.04 },
  front: { name: "Front", azimuth: 0, elevation: 0.35 },
  side: { name: "Side", azimuth: Math.PI / 2, elevation: 0.1 },
  space: { name: "3D", azimuth: -0.6, elevation: 0.5 },
  top: { name: "Top", azimuth: 0, elevation: Math.PI / 2 },
} as const;

export type Preset = keyof typeof PRESETS;
export const isPreset = (text: string): text is Preset => text in PRESETS;

/** A point on the screen. `depth` grows away from the eye; `scale` is pixels per metre there. */
export interface Spot {
  x: number;
  y: number;
  depth: number;
  scale: number;
}

export type Projection = (point: Point) => Spot | null;

/** Distance of the eye from the target, in multiples of `reach`. */
export const EYE = 4;

export const projectionOf = (camera: Camera, width: number, height: number): Projection =>
  (camera.map ? fromAbove : inSpace)(camera, width, height);

function fromAbove({ target, reach }: Camera, width: number, height: number): Projection {
  const scale = Math.min(width, height) / (2 * reach);
  return ([x, y, z]) => ({ x: width / 2 + (x - target[0]) * scale, y: height / 2 - (y - target[1]) * scale, depth: -z, scale });
}

function inSpace({ target, reach, azimuth, elevation }: Camera, width: number, height: number): Projection {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  const focal = (Math.min(width, height) / (2 * reach)) * EYE * reach;
  return (point) => {
    const [x, y, z] = [point[0] - target[0], point[1] - target[1], point[2] - target[2]];
    const right = ca * x + sa * y;
    const away = -sa * x + ca * y;
    const depth = EYE * reach + away * ce - z * se;
    if (depth < 0.05 * reach) return null;
    const up = z * ce + away * se;
    const scale = focal / depth;
    return { x: width / 2 + right * scale, y: height / 2 - up * scale, depth, scale };
  };
}

/** Nearest and farthest drawn depth, in multiples of `reach`. */
const NEAR = 0.05;
const FAR = 60;

/** The same projection as a matrix from metres to clip coordinates, by columns. */
export function matrixOf({ target, reach, azimuth, elevation, map }: Camera, width: number, height: number): number[] {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  const half = Math.min(width, height) / 2;
  const rows: number[][] = map
    ? [
        [(2 * half) / reach / width, 0, 0, 0],
        [0, (2 * half) / reach / height, 0, 0],
        [0, 0, -1 / (FAR * reach), 0],
        [0, 0, 0, 1],
      ]
    : perspective([ca, sa, ce, se], reach, (2 * half * EYE) / width, (2 * half * EYE) / height);
  // Moves the target to the origin.
  const moved = rows.map(([x, y, z, w]) => [x, y, z, w - x * target[0] - y * target[1] - z * target[2]]);
  return [0, 1, 2, 3].flatMap((column) => moved.map((row) => row[column]));
}

function perspective([ca, sa, ce, se]: number[], reach: number, horizontal: number, vertical: number): number[][] {
  const depth = [-sa * ce, ca * ce, -se, EYE * reach];
  const [near, far] = [NEAR * reach, FAR * reach];
  const scale = (far + near) / (far - near);
  const shift = (-2 * far * near) / (far - near);
  return [
    [ca, sa, 0, 0].map((value) => value * horizontal),
    [-sa * se, ca * se, ce, 0].map((value) => value * vertical),
    [...depth.slice(0, 3).map((value) => value * scale), depth[3] * scale + shift],
    depth,
  ];
}

export function orbit(camera: Camera, azimuth: number, elevation: number): Camera {
  return {
    ...camera,
    azimuth: camera.azimuth + azimuth,
    elevation: Math.min(1.55, Math.max(-0.2, camera.elevation + elevation)),
  };
}

/** Moves the target by a fraction of the visible extent. */
export function slide(camera: Camera, right: number, up: number): Camera {
  const turn = camera.map ? 0 : camera.azimuth;
  const [x, y, z] = camera.target;
  const r = right * camera.reach;
  const u = up * camera.reach;
  if (!camera.map) return { ...camera, target: [x + r * Math.cos(turn), y + r * Math.sin(turn), z + u] };
  return { ...camera, target: [x + r, y + u, z] };
}

export const closer = (camera: Camera, factor: number): Camera => ({
  ...camera,
  reach: Math.min(1e5, Math.max(0.01, camera.reach / factor)),
});

/** Share of the picture that is left free around the points. */
const ROOM = 1.15;

/** The camera of a preset that shows all points. `room`: size of what is drawn around each point, in metres. */
export function fitted(points: readonly Point[], preset: Preset, width: number, height: number, room: number): Camera {
  const { azimuth, elevation } = PRESETS[preset];
  const map = preset === "top";
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (const point of points)
    point.forEach((value, i) => {
      low[i] = Math.min(low[i], value - room);
      high[i] = Math.max(high[i], value + room);
    });
  if (low[0] > high[0]) return { target: [0, 0, 0], reach: 1, azimuth, elevation, map };
  const target: Point = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2];
  let camera: Camera = { target, reach: Math.max(0.2, ...high.map((value, i) => value - low[i])), azimuth, elevation, map };
  const half = [width / 2, height / 2];
  // The perspective depends on the reach, so this approaches the result.
  for (let i = 0; i < 4; i++) {
    const project = projectionOf(camera, width, height);
    let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const point of points) {
      const spot = project(point);
      if (spot === null) continue;
      const size = room * spot.scale;
      [left, right] = [Math.min(left, spot.x - size), Math.max(right, spot.x + size)];
      [top, bottom] = [Math.min(top, spot.y - size), Math.max(bottom, spot.y + size)];
    }
    const factor = Math.max((right - left) / 2 / half[0], (bottom - top) / 2 / half[1]) * ROOM;
    if (!(factor > 0)) break;
    const across = ((left + right) / 2 - half[0]) / (Math.min(width, height) / 2);
    const upwards = (half[1] - (top + bottom) / 2) / (Math.min(width, height) / 2);
    camera = { ...slide(camera, across, upwards), reach: Math.max(0.05, camera.reach * factor) };
  }
  return camera;
}
