// Points and frames in space. A frame is a rotation, by rows, and an origin.

export type Point = readonly [number, number, number];
export interface Frame {
  rows: readonly [Point, Point, Point];
  origin: Point;
}

export const WORLD: Frame = {
  rows: [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ],
  origin: [0, 0, 0],
};

const dot = (a: Point, b: Point) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const column = (rows: Frame["rows"], i: 0 | 1 | 2): Point => [rows[0][i], rows[1][i], rows[2][i]];

export function place(frame: Frame, point: Point): Point {
  const [x, y, z] = frame.rows.map((row) => dot(row, point));
  return [x + frame.origin[0], y + frame.origin[1], z + frame.origin[2]];
}

/** Converts `inner`, which is relative to `outer`, to the frame of `outer`. */
export function within(outer: Frame, inner: Frame): Frame {
  const columns = [column(inner.rows, 0), column(inner.rows, 1), column(inner.rows, 2)];
  const row = (left: Point): Point => [dot(left, columns[0]), dot(left, columns[1]), dot(left, columns[2])];
  return { rows: [row(outer.rows[0]), row(outer.rows[1]), row(outer.rows[2])], origin: place(outer, inner.origin) };
}

export const shifted = (origin: Point): Frame => ({ rows: WORLD.rows, origin });

/** Rotation about a unit vector (Rodrigues). */
export function turned([x, y, z]: Point, angle: number): Frame {
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  const d = 1 - c;
  return {
    rows: [
      [c + x * x * d, x * y * d - z * s, x * z * d + y * s],
      [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
      [z * x * d - y * s, z * y * d + x * s, c + z * z * d],
    ],
    origin: [0, 0, 0],
  };
}

/** Roll, pitch and yaw about the fixed axes, in this order, as in URDF. */
export function rolled([roll, pitch, yaw]: Point): Frame {
  return within(turned([0, 0, 1], yaw), within(turned([0, 1, 0], pitch), turned([1, 0, 0], roll)));
}

export const scaled = ([x, y, z]: Point, by: number): Point => [x * by, y * by, z * by];
export const distance = (a: Point, b: Point) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
