// The convex parts of a body: points, segments and boxes, each with a radius, and the distance between two of them. The compiler
// measures the same parts.
import type { Pose } from "./pose";
import { distance, place, type Frame, type Point } from "./space";

export type Core = { kind: "segment"; a: Point; b: Point } | { kind: "box"; frame: Frame; half: Point };

/** All points within `radius` of the core. A point is a segment of length 0. */
export interface Part {
  core: Core;
  radius: number;
}

export function partsOf({ body, frame, chain }: Pose): Part[] {
  const parts: Part[] = [];
  if ("box" in body.shape) {
    const [x, y, z] = body.shape.box;
    parts.push({ core: { kind: "box", frame, half: [x / 2, y / 2, z / 2] }, radius: 0 });
  } else if (body.shape.ball > 0 || body.joints.length === 0) {
    parts.push({ core: { kind: "segment", a: frame.origin, b: frame.origin }, radius: body.shape.ball });
  }
  for (let i = 0; i + 1 < chain.length; i++)
    parts.push({ core: { kind: "segment", a: chain[i], b: chain[i + 1] }, radius: body.joints[i].radius });
  return parts;
}

/** A ball that encloses all parts: its middle and radius. */
export function ballAround({ body, frame, chain }: Pose): { middle: Point; radius: number } {
  const own = "box" in body.shape ? Math.hypot(...body.shape.box) / 2 : body.shape.ball;
  const links = chain.map((point, i) => distance(frame.origin, point) + Math.max(body.joints[i].radius, body.joints[i - 1]?.radius ?? 0));
  return { middle: frame.origin, radius: Math.max(own, ...links) };
}

/** Distance between surfaces, in metres; 0 if the parts touch or overlap. */
export function gap(one: Part, other: Part): number {
  return Math.max(0, between(one.core, other.core) - one.radius - other.radius);
}

function between(a: Core, b: Core): number {
  if (a.kind === "segment" && b.kind === "segment") return ofSegments(a.a, a.b, b.a, b.b);
  if (a.kind === "segment") return toBox(a.a, a.b, b as Core & { kind: "box" });
  if (b.kind === "segment") return toBox(b.a, b.b, a);
  return ofBoxes(a, b);
}

const minus = (a: Point, b: Point): Point => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const along = (a: Point, way: Point, share: number): Point => [a[0] + way[0] * share, a[1] + way[1] * share, a[2] + way[2] * share];
const dot = (a: Point, b: Point) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const clamp = (value: number) => Math.min(1, Math.max(0, value));

/** Ericson, Real-Time Collision Detection, 5.1.9. */
function ofSegments(p: Point, q: Point, r: Point, s: Point): number {
  const [d1, d2, apart] = [minus(q, p), minus(s, r), minus(p, r)];
  const [a, e, f] = [dot(d1, d1), dot(d2, d2), dot(d2, apart)];
  if (a === 0 && e === 0) return distance(p, r);
  if (a === 0) return distance(p, along(r, d2, clamp(f / e)));
  const c = dot(d1, apart);
  if (e === 0) return distance(along(p, d1, clamp(-c / a)), r);
  const b = dot(d1, d2);
  const denominator = a * e - b * b;
  let first = denominator > 0 ? clamp((b * f - c * e) / denominator) : 0;
  let second = (b * first + f) / e;
  if (second < 0 || second > 1) {
    second = clamp(second);
    first = clamp((b * second - c) / a);
  }
  return distance(along(p, d1, first), along(r, d2, second));
}

function inBox({ frame, half }: Core & { kind: "box" }, point: Point): Point {
  const local = minus(point, frame.origin);
  const at = [0, 1, 2].map((i) => {
    const axis: Point = [frame.rows[0][i], frame.rows[1][i], frame.rows[2][i]];
    return Math.min(half[i], Math.max(-half[i], dot(local, axis)));
  });
  return place(frame, [at[0], at[1], at[2]]);
}

/** The distance to a convex body is a convex function along a segment. */
function toBox(a: Point, b: Point, box: Core & { kind: "box" }): number {
  const way = minus(b, a);
  const at = (share: number) => {
    const point = along(a, way, share);
    return distance(point, inBox(box, point));
  };
  let [low, high] = [0, 1];
  // The interval shrinks by a third: after 60 steps, the error is far below a micrometre.
  for (let i = 0; i < 60; i++) {
    const third = (high - low) / 3;
    if (at(low + third) < at(high - third)) high -= third;
    else low += third;
  }
  return Math.min(at(0), at(1), at((low + high) / 2));
}

/** Two boxes that turn only about the vertical are closest in a plan view and in height, which are independent of each other. */
function ofBoxes(a: Core & { kind: "box" }, b: Core & { kind: "box" }): number {
  const height = Math.max(0, Math.abs(a.frame.origin[2] - b.frame.origin[2]) - a.half[2] - b.half[2]);
  const edges = (box: Core & { kind: "box" }) => {
    const [x, y] = box.half;
    const corners = [[x, y], [-x, y], [-x, -y], [x, -y]].map(([u, v]): Point => {
      const corner = place(box.frame, [u, v, 0]);
      return [corner[0], corner[1], 0];
    });
    return corners.map((corner, i) => [corner, corners[(i + 1) % 4]] as const);
  };
  const flat = (box: Core & { kind: "box" }) => ({ ...box, frame: { ...box.frame, origin: [box.frame.origin[0], box.frame.origin[1], 0] as Point } });
  const inside = (point: Point, box: Core & { kind: "box" }) => distance(point, inBox(flat(box), point)) === 0;
  const [first, second] = [edges(a), edges(b)];
  if (inside(first[0][0], b) || inside(second[0][0], a)) return height;
  const plan = Math.min(...first.flatMap(([p, q]) => second.map(([r, s]) => ofSegments(p, q, r, s))));
  return Math.hypot(plan, height);
}
