// Robots on the stage: balls, boxes turned by their yaw, chains of joints. Hollow and dashed if the position is unknown.
import { FONT } from "../canvas/palette";
import { widthOf } from "../canvas/text";
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import { visible } from "../text/visible";
import type { Projection, Spot } from "./camera";
import type { Pose } from "./pose";
import { place, type Point } from "./space";

/** Smallest size of a drawn robot, in pixels. */
const SMALLEST = 4;
/** Hues of the robots, in degrees. Robots may share a hue; the label identifies a robot. */
const HUES = [212, 28, 150, 275, 335, 95, 190, 55];

export interface BodyStyle {
  dark: boolean;
  strong: ReadonlySet<number>;
}

export function colourOf(robot: number, dark: boolean): string {
  return `hsl(${HUES[robot % HUES.length]} 65% ${dark ? 68 : 40}%)`;
}

export function drawBody(sheet: Sheet, pose: Pose, project: Projection, style: BodyStyle): void {
  const { context, palette } = sheet;
  const colour = colourOf(pose.robot, style.dark);
  context.setLineDash(pose.doubt === null ? [] : [3, 3]);
  context.strokeStyle = colour;
  context.fillStyle = pose.doubt === null ? colour : palette.ground;
  context.lineWidth = style.strong.has(pose.robot) ? 3 : 1.5;
  if ("ball" in pose.body.shape) drawBall(context, pose, pose.body.shape.ball, project);
  else drawBox(context, pose, pose.body.shape.box, project);
  drawChain(context, pose, project, colour);
  context.setLineDash([]);
  context.lineWidth = 1;
}

function drawBall(context: CanvasRenderingContext2D, pose: Pose, radius: number, project: Projection): void {
  const spot = project(pose.frame.origin);
  if (spot === null) return;
  const size = Math.max(SMALLEST, radius * spot.scale);
  context.beginPath();
  context.arc(spot.x, spot.y, size, 0, 2 * Math.PI);
  paint(context, 0.8);
  const ahead = project(place(pose.frame, [Math.max(radius, size / spot.scale) * 1.6, 0, 0]));
  if (ahead === null || pose.body.yaw.device === null) return;
  context.beginPath();
  context.moveTo(spot.x, spot.y);
  context.lineTo(ahead.x, ahead.y);
  context.stroke();
}

const CORNERS: Point[] = [
  [-1, -1, -1],
  [1, -1, -1],
  [1, 1, -1],
  [-1, 1, -1],
  [-1, -1, 1],
  [1, -1, 1],
  [1, 1, 1],
  [-1, 1, 1],
];
const SIDES = [
  [0, 1, 2, 3],
  [0, 1, 5, 4],
  [1, 2, 6, 5],
  [2, 3, 7, 6],
  [3, 0, 4, 7],
  [4, 5, 6, 7],
];

function drawBox(
  context: CanvasRenderingContext2D,
  pose: Pose,
  [length, width, height]: readonly number[],
  project: Projection,
): void {
  const corners = CORNERS.map(([x, y, z]) => project(place(pose.frame, [(x * length) / 2, (y * width) / 2, (z * height) / 2])));
  if (corners.some((corner) => corner === null)) return;
  const spots = corners as Spot[];
  const depth = (side: number[]) => side.reduce((sum, i) => sum + spots[i].depth, 0);
  for (const side of [...SIDES].sort((a, b) => depth(b) - depth(a))) {
    context.beginPath();
    side.forEach((i, n) => (n === 0 ? context.moveTo(spots[i].x, spots[i].y) : context.lineTo(spots[i].x, spots[i].y)));
    context.closePath();
    paint(context, 0.45);
  }
}

/** Fills lightly, so that objects behind remain visible, inside a solid outline. */
function paint(context: CanvasRenderingContext2D, alpha: number): void {
  context.globalAlpha = alpha;
  context.fill();
  context.globalAlpha = 1;
  context.stroke();
}

function drawChain(context: CanvasRenderingContext2D, pose: Pose, project: Projection, colour: string): void {
  context.lineCap = "round";
  context.strokeStyle = colour;
  context.globalAlpha = pose.doubt === null ? 0.85 : 0.4;
  const points = [pose.frame.origin, ...pose.chain];
  for (let i = 0; i + 1 < points.length; i++) {
    const from = project(points[i]);
    const to = project(points[i + 1]);
    if (from === null || to === null) continue;
    // The part from the body to the first joint has no radius of its own.
    const radius = i === 0 ? 0 : pose.body.joints[i - 1].radius;
    context.lineWidth = Math.max(2, 2 * radius * from.scale);
    context.beginPath();
    context.moveTo(from.x, from.y);
    context.lineTo(to.x, to.y);
    context.stroke();
  }
  context.globalAlpha = 1;
  context.lineCap = "butt";
}

/** Draws names that do not overlap. Of overlapping names, only the first is drawn. */
export function drawLabels({ context, palette }: Sheet, show: Show, found: readonly Pose[], project: Projection): void {
  const taken: { x: number; y: number; width: number }[] = [];
  context.font = FONT;
  context.textBaseline = "middle";
  for (const pose of found) {
    const spot = project(pose.frame.origin);
    if (spot === null) continue;
    const text = `${visible(show.mission.robots[pose.robot].id)}${pose.doubt === null ? "" : " ?"}`;
    const size = "ball" in pose.body.shape ? pose.body.shape.ball : pose.body.shape.box[0] / 2;
    const place = { x: spot.x + Math.max(SMALLEST, size * spot.scale) + 6, y: spot.y, width: widthOf(context, text) };
    if (
      taken.some(
        (other) => Math.abs(other.y - place.y) < 12 && place.x < other.x + other.width && other.x < place.x + place.width,
      )
    )
      continue;
    taken.push(place);
    context.lineWidth = 3;
    context.strokeStyle = palette.ground;
    context.strokeText(text, place.x, place.y);
    context.lineWidth = 1;
    context.fillStyle = palette.text;
    context.fillText(text, place.x, place.y);
  }
}
