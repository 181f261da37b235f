// Draws scenes without WebGL, the farthest first.
import type { Sheet } from "../canvas/useCanvas";
import type { Projection, Spot } from "./camera";
import { css } from "./colours";
import { brightened, type Scene, type Solid } from "./scene";
import { place, type Point } from "./space";

/** Smallest size of a drawn robot, in pixels. */
const SMALLEST = 3;

export function drawFlat({ context }: Sheet, scene: Scene, project: Projection): void {
  for (const { points, colour, alpha } of scene.lines) {
    context.strokeStyle = css(colour, alpha);
    strokeAll(context, points, project);
  }
  const depth = (solid: Solid) => project(solid.kind === "ball" ? solid.at : solid.kind === "box" ? solid.frame.origin : solid.from)?.depth ?? 0;
  for (const solid of [...scene.solids].sort((a, b) => depth(b) - depth(a))) drawSolid(context, solid, project);
  context.globalCompositeOperation = "lighter";
  for (const { from, to, colour } of scene.beams) {
    context.strokeStyle = css(brightened(colour), 0.3);
    context.lineWidth = 6;
    strokeAll(context, [from, to], project);
    context.lineWidth = 1;
  }
  for (const { at, colour, radius } of scene.glows) {
    const spot = project(at);
    if (spot !== null) drawGlow(context, spot, brightened(colour), radius);
  }
  context.globalCompositeOperation = "source-over";
}

function strokeAll(context: CanvasRenderingContext2D, points: readonly (Point | null)[], project: Projection): void {
  context.beginPath();
  let before: Spot | null = null;
  for (const point of points) {
    const spot = point === null ? null : project(point);
    if (spot !== null && before !== null) {
      context.moveTo(before.x, before.y);
      context.lineTo(spot.x, spot.y);
    }
    before = spot;
  }
  context.stroke();
}

function drawGlow(context: CanvasRenderingContext2D, { x, y, scale }: Spot, colour: readonly [number, number, number], radius: number): void {
  const size = Math.min(75, Math.max(11, radius * scale * 4.5));
  const light = context.createRadialGradient(x, y, 0, x, y, size);
  light.addColorStop(0, css([0.5 + colour[0] / 2, 0.5 + colour[1] / 2, 0.5 + colour[2] / 2]));
  light.addColorStop(0.2, css(colour, 0.9));
  light.addColorStop(0.4, css(colour, 0.3));
  light.addColorStop(1, css(colour, 0));
  context.fillStyle = light;
  context.fillRect(x - size, y - size, 2 * size, 2 * size);
}

function drawSolid(context: CanvasRenderingContext2D, solid: Solid, project: Projection): void {
  context.fillStyle = css(solid.colour, solid.hollow ? 0.25 : 0.9);
  context.strokeStyle = css(solid.colour);
  context.setLineDash(solid.hollow ? [3, 3] : []);
  if (solid.kind === "ball") drawBall(context, solid.at, solid.radius, project);
  else if (solid.kind === "box") drawBox(context, solid, project);
  else drawCapsule(context, solid, project);
  context.setLineDash([]);
}

function drawBall(context: CanvasRenderingContext2D, at: Point, radius: number, project: Projection): void {
  const spot = project(at);
  if (spot === null) return;
  context.beginPath();
  context.arc(spot.x, spot.y, Math.max(SMALLEST, radius * spot.scale), 0, 2 * Math.PI);
  context.fill();
  context.stroke();
}

const CORNERS: Point[] = [
  [-0.5, -0.5, -0.5],
  [0.5, -0.5, -0.5],
  [0.5, 0.5, -0.5],
  [-0.5, 0.5, -0.5],
  [-0.5, -0.5, 0.5],
  [0.5, -0.5, 0.5],
  [0.5, 0.5, 0.5],
  [-0.5, 0.5, 0.5],
];
const FACES = [
  [0, 1, 2, 3],
  [0, 1, 5, 4],
  [1, 2, 6, 5],
  [2, 3, 7, 6],
  [3, 0, 4, 7],
  [4, 5, 6, 7],
];

function drawBox(context: CanvasRenderingContext2D, { frame, size }: Solid & { kind: "box" }, project: Projection): void {
  const corners = CORNERS.map(([x, y, z]) => project(place(frame, [x * size[0], y * size[1], z * size[2]])));
  if (corners.some((corner) => corner === null)) return;
  const spots = corners as Spot[];
  const depth = (face: number[]) => face.reduce((sum, i) => sum + spots[i].depth, 0);
  for (const face of [...FACES].sort((a, b) => depth(b) - depth(a))) {
    context.beginPath();
    face.forEach((i, n) => (n === 0 ? context.moveTo(spots[i].x, spots[i].y) : context.lineTo(spots[i].x, spots[i].y)));
    context.closePath();
    context.fill();
    context.stroke();
  }
}

function drawCapsule(context: CanvasRenderingContext2D, { from, to, radius, colour }: Solid & { kind: "capsule" }, project: Projection): void {
  const [a, b] = [project(from), project(to)];
  if (a === null || b === null) return;
  context.lineCap = "round";
  context.strokeStyle = css(colour, 0.85);
  context.lineWidth = Math.max(2, 2 * radius * a.scale);
  context.beginPath();
  context.moveTo(a.x, a.y);
  context.lineTo(b.x, b.y);
  context.stroke();
  context.lineWidth = 1;
  context.lineCap = "butt";
}
