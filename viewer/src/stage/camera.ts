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
}

/** A point on the screen. `depth` grows away from the eye; `scale` is pixels per metre there. */
export interface Spot {
  x: number;
  y: number;
  depth: number;
  scale: number;
}

export type Projection = (point: Point) => Spot | null;

/** Distance of the eye from the target, in multiples of `reach`. */
const EYE = 4;

export function fromAbove({ target, reach }: Camera, width: number, height: number): Projection {
  const scale = Math.min(width, height) / (2 * reach);
  return ([x, y, z]) => ({ x: width / 2 + (x - target[0]) * scale, y: height / 2 - (y - target[1]) * scale, depth: -z, scale });
}

export function inSpace({ target, reach, azimuth, elevation }: Camera, width: number, height: number): Projection {
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

export function orbit(camera: Camera, azimuth: number, elevation: number): Camera {
  return {
    ...camera,
    azimuth: camera.azimuth + azimuth,
    elevation: Math.min(1.55, Math.max(-0.2, camera.elevation + elevation)),
  };
}

/** Moves the target by a fraction of the visible extent. */
export function slide(camera: Camera, right: number, up: number, in3d: boolean): Camera {
  const turn = in3d ? camera.azimuth : 0;
  const [x, y, z] = camera.target;
  const r = right * camera.reach;
  const u = up * camera.reach;
  if (in3d) return { ...camera, target: [x + r * Math.cos(turn), y + r * Math.sin(turn), z + u] };
  return { ...camera, target: [x + r, y + u, z] };
}

export const closer = (camera: Camera, factor: number): Camera => ({
  ...camera,
  reach: Math.min(1e5, Math.max(0.01, camera.reach / factor)),
});
