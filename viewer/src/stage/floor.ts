// The ground: a grid with its scale and coordinates, and the directions of the axes.
import { MONO } from "../canvas/palette";
import type { Sheet } from "../canvas/useCanvas";
import { rounded } from "../text/digits";
import { niceStep } from "../text/time";
import type { Camera, Projection } from "./camera";
import type { Point } from "./space";

const CELLS = 10;

export function drawFloor(sheet: Sheet, camera: Camera, project: Projection, inSpace: boolean): void {
  const { context, palette } = sheet;
  const step = niceStep(1, (2 * camera.reach) / CELLS);
  const reach = Math.ceil(((1.6 * camera.reach) / step) * Math.max(1, sheet.width / sheet.height)) * step;
  const centre = camera.target.map((value) => Math.round(value / step) * step);
  context.strokeStyle = palette.faint;
  context.beginPath();
  for (let i = -reach / step; i <= reach / step; i++) {
    line(context, project, [centre[0] + i * step, centre[1] - reach, 0], [centre[0] + i * step, centre[1] + reach, 0]);
    line(context, project, [centre[0] - reach, centre[1] + i * step, 0], [centre[0] + reach, centre[1] + i * step, 0]);
  }
  context.stroke();
  if (!inSpace) drawCoordinates(sheet, step, project, centre, reach);
  drawAxes(sheet, camera, project);
  drawScale(sheet, step, project, centre);
}

function line(context: CanvasRenderingContext2D, project: Projection, from: Point, to: Point): void {
  const start = project(from);
  const end = project(to);
  if (start === null || end === null) return;
  context.moveTo(start.x, start.y);
  context.lineTo(end.x, end.y);
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

/**
 * Labels the grid lines along the edges. Only in the view from above: in perspective, the lines are oblique and labels would be
 * ambiguous.
 */
function drawCoordinates(
  { context, palette, width, height }: Sheet,
  step: number,
  project: Projection,
  centre: number[],
  reach: number,
): void {
  context.font = MONO;
  context.fillStyle = palette.dim;
  const every = (project([step, 0, 0])?.x ?? 0) - (project([0, 0, 0])?.x ?? 0) < 36 ? 2 : 1;
  for (let i = -reach / step; i <= reach / step; i++) {
    const [x, y] = [centre[0] + i * step, centre[1] + i * step];
    const column = project([x, 0, 0]);
    const row = project([0, y, 0]);
    context.textBaseline = "top";
    if (column !== null && column.x > 30 && column.x < width - 20 && Math.round(x / step) % every === 0)
      context.fillText(rounded(x, 6), column.x + 3, 3);
    context.textBaseline = "middle";
    if (row !== null && row.y > 20 && row.y < height - 70 && Math.round(y / step) % every === 0)
      context.fillText(rounded(y, 6), 3, row.y - 6);
  }
}

/** Draws the length of one grid cell in the corner, and the coordinates of the lines. */
function drawScale({ context, palette, width, height }: Sheet, step: number, project: Projection, centre: number[]): void {
  const here = project([centre[0], centre[1], 0]);
  if (here === null) return;
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
