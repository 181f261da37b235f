// What is drawn over the stage: names, marks of failures, the closest pair, the axes and the scale.
import { FONT, MONO } from "../canvas/palette";
import { widthOf } from "../canvas/text";
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import { rounded } from "../text/digits";
import { visible } from "../text/visible";
import type { Camera, Projection, Spot } from "./camera";
import { closestPair, type Pair } from "./closest";
import type { Pose } from "./pose";
import { cellOf, markOf } from "./scene";
import type { Point } from "./space";

export interface OverlayOptions {
  camera: Camera;
  names: boolean;
  /** Axes, scale and the closest pair, for people who measure. */
  measures: boolean;
  selected: number | null;
  /** Robots that pass the filters; `null` for all. */
  shown: ReadonlySet<number> | null;
}

interface Placed {
  pose: Pose;
  spot: Spot;
  /** Half of the drawn size, in pixels. */
  size: number;
}

export function drawOverlay(sheet: Sheet, show: Show, found: readonly Pose[], ms: number, project: Projection, options: OverlayOptions): void {
  const placed = found.flatMap((pose): Placed[] => {
    const spot = project(pose.frame.origin);
    if (spot === null) return [];
    const size = "ball" in pose.body.shape ? pose.body.shape.ball : Math.max(...pose.body.shape.box) / 2;
    return [{ pose, spot, size: Math.max(4, size * spot.scale) }];
  });
  if (options.measures) {
    const closest = closestPair(found);
    if (closest !== null) drawClosest(sheet, closest, placed);
    if (options.camera.map) drawCoordinates(sheet, options.camera, project);
    drawAxes(sheet, options.camera, project);
    drawScale(sheet, options.camera, project);
  }
  for (const { pose, spot, size } of placed) {
    const mark = markOf(show, pose.robot, ms);
    if (mark !== null) drawMark(sheet, spot, size, mark);
    if (pose.robot === options.selected) drawRing(sheet, spot, size + 8, sheet.palette.text);
    if (options.shown !== null && !options.shown.has(pose.robot)) dim(sheet, spot, size);
  }
  drawNames(sheet, show, placed, ms, options);
}

/** The robot that is drawn at a point, or the nearest within a few pixels. */
export function robotAt(found: readonly Pose[], project: Projection, x: number, y: number): number | null {
  let best: { robot: number; away: number } | null = null;
  for (const { robot, frame, chain } of found) {
    for (const point of [frame.origin, ...chain]) {
      const spot = project(point);
      if (spot === null) continue;
      const away = Math.hypot(spot.x - x, spot.y - y);
      if (away < 22 && (best === null || away < best.away)) best = { robot, away };
    }
  }
  return best?.robot ?? null;
}

function drawRing({ context }: Sheet, { x, y }: Spot, size: number, colour: string): void {
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(x, y, size, 0, 2 * Math.PI);
  context.stroke();
  context.lineWidth = 1;
}

/** A ring and a sign, so that the mark does not depend on its colour. */
function drawMark(sheet: Sheet, spot: Spot, size: number, mark: "bad" | "warn"): void {
  const { context, palette } = sheet;
  const colour = mark === "bad" ? palette.bad : palette.warn;
  drawRing(sheet, spot, size + 5, colour);
  context.font = `bold 14px sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillStyle = colour;
  context.fillText(mark === "bad" ? "✕" : "⚠", spot.x, spot.y - size - 14);
  context.textAlign = "left";
}

function dim({ context, palette }: Sheet, { x, y }: Spot, size: number): void {
  context.globalAlpha = 0.7;
  context.fillStyle = palette.ground;
  context.beginPath();
  context.arc(x, y, Math.max(size * 1.2, 14), 0, 2 * Math.PI);
  context.fill();
  context.globalAlpha = 1;
}

interface Box {
  left: number;
  top: number;
  right: number;
  bottom: number;
}
const overlaps = (a: Box, b: Box) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
const HEIGHT = 14;

/** Draws each name on the first free side of its robot. A name that would cover another name or a robot is not drawn. */
function drawNames(sheet: Sheet, show: Show, placed: readonly Placed[], ms: number, { names, selected }: OverlayOptions): void {
  const { context, palette, width, height } = sheet;
  const needed = placed.filter(({ pose }) => names || pose.robot === selected || markOf(show, pose.robot, ms) !== null);
  if (needed.length === 0) return;
  const taken: Box[] = placed.map(({ spot: { x, y }, size }) => {
    const half = Math.min(size, 24);
    return { left: x - half, right: x + half, top: y - half, bottom: y + half };
  });
  context.font = FONT;
  context.textBaseline = "middle";
  // The selected robot comes first.
  for (const { pose, spot, size } of [...needed].sort((a, b) => Number(b.pose.robot === selected) - Number(a.pose.robot === selected))) {
    const text = `${visible(show.mission.robots[pose.robot].id)}${pose.doubt === null ? "" : " ?"}`;
    const long = widthOf(context, text);
    const gap = Math.min(size, 60) + 5;
    const sides: [number, number][] = [
      [spot.x + gap, spot.y],
      [spot.x - gap - long, spot.y],
      [spot.x - long / 2, spot.y - gap - HEIGHT / 2],
      [spot.x - long / 2, spot.y + gap + HEIGHT / 2],
    ];
    for (const [x, y] of sides) {
      const box = { left: x, right: x + long, top: y - HEIGHT / 2, bottom: y + HEIGHT / 2 };
      if (box.left < 0 || box.right > width || box.top < 0 || box.bottom > height || taken.some((other) => overlaps(box, other))) continue;
      taken.push(box);
      context.lineWidth = 3;
      context.strokeStyle = palette.ground;
      context.strokeText(text, x, y);
      context.lineWidth = 1;
      context.fillStyle = palette.text;
      context.fillText(text, x, y);
      break;
    }
  }
}

function drawClosest({ context, palette }: Sheet, { robots }: Pair, placed: readonly Placed[]): void {
  const [from, to] = robots.map((robot) => placed.find(({ pose }) => pose.robot === robot)?.spot);
  if (from === undefined || to === undefined) return;
  context.strokeStyle = palette.warn;
  context.setLineDash([5, 3]);
  context.beginPath();
  context.moveTo(from.x, from.y);
  context.lineTo(to.x, to.y);
  context.stroke();
  context.setLineDash([]);
}

/** Draws the directions of the axes in the corner, because the origin may be out of view. */
function drawAxes({ context, palette, height }: Sheet, { target, reach }: Camera, project: Projection): void {
  const here = project(target);
  if (here === null) return;
  const length = reach * 0.01;
  const axes: [string, Point, string][] = [
    ["x", [length, 0, 0], palette.bad],
    ["y", [0, length, 0], palette.good],
    ["z", [0, 0, length], palette.accent],
  ];
  const foot = { x: 46, y: height - 40 };
  context.font = MONO;
  context.textBaseline = "middle";
  context.lineWidth = 2;
  for (const [name, way, colour] of axes) {
    const tip = project([target[0] + way[0], target[1] + way[1], target[2] + way[2]]);
    if (tip === null) continue;
    const perPixel = 26 / (length * here.scale);
    const end = { x: foot.x + (tip.x - here.x) * perPixel, y: foot.y + (tip.y - here.y) * perPixel };
    if (Math.hypot(end.x - foot.x, end.y - foot.y) < 4) continue;
    context.strokeStyle = context.fillStyle = colour;
    context.beginPath();
    context.moveTo(foot.x, foot.y);
    context.lineTo(end.x, end.y);
    context.stroke();
    context.fillText(name, end.x + (end.x - foot.x) * 0.25 - 3, end.y + (end.y - foot.y) * 0.25);
  }
  context.lineWidth = 1;
}

/** Labels the grid lines along the edges: in perspective, the lines are oblique and labels would be ambiguous. */
function drawCoordinates({ context, palette, width, height }: Sheet, camera: Camera, project: Projection): void {
  const step = cellOf(camera);
  const reach = Math.ceil((2.4 * camera.reach) / step);
  context.font = MONO;
  context.fillStyle = palette.dim;
  const every = (project([step, 0, 0])?.x ?? 0) - (project([0, 0, 0])?.x ?? 0) < 36 ? 2 : 1;
  const [middleX, middleY] = camera.target.map((value) => Math.round(value / step));
  for (let i = -reach; i <= reach; i++) {
    const [x, y] = [(middleX + i) * step, (middleY + i) * step];
    const column = project([x, 0, 0]);
    const row = project([0, y, 0]);
    context.textBaseline = "top";
    if (column !== null && column.x > 30 && column.x < width - 20 && (middleX + i) % every === 0)
      context.fillText(rounded(x, 6), column.x + 3, 3);
    context.textBaseline = "middle";
    if (row !== null && row.y > 20 && row.y < height - 70 && (middleY + i) % every === 0)
      context.fillText(rounded(y, 6), 3, row.y - 6);
  }
}

/** Draws the length of one grid cell in the corner. */
function drawScale({ context, palette, width, height }: Sheet, camera: Camera, project: Projection): void {
  const here = project(camera.target);
  if (here === null) return;
  const step = cellOf(camera);
  const length = here.scale * step;
  const right = width - 10;
  context.strokeStyle = context.fillStyle = palette.dim;
  context.beginPath();
  context.moveTo(right - length, height - 14);
  context.lineTo(right - length, height - 8);
  context.lineTo(right, height - 8);
  context.lineTo(right, height - 14);
  context.stroke();
  context.font = MONO;
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  context.fillText(`${rounded(step, 6)} m`, right - length / 2, height - 13);
  context.textAlign = "left";
}
