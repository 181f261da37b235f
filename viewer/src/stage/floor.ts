// The ground: a grid with its scale, and the axes with their names.
import { MONO } from "../canvas/palette";
import type { Sheet } from "../canvas/useCanvas";
import { rounded } from "../text/digits";
import { niceStep } from "../text/time";
import type { Camera, Projection } from "./camera";
import type { Point } from "./space";

const CELLS = 10;

export function drawFloor(sheet: Sheet, camera: Camera, project: Projection): void {
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
  drawAxes(sheet, step, project);
  drawScale(sheet, step, project, centre);
}

function line(context: CanvasRenderingContext2D, project: Projection, from: Point, to: Point): void {
  const start = project(from);
  const end = project(to);
  if (start === null || end === null) return;
  context.moveTo(start.x, start.y);
  context.lineTo(end.x, end.y);
}

function drawAxes({ context, palette }: Sheet, step: number, project: Projection): void {
  const axes: [string, Point, string][] = [["x", [step, 0, 0], palette.bad], ["y", [0, step, 0], palette.good], ["z", [0, 0, step], palette.accent]];
  context.font = MONO;
  context.lineWidth = 2;
  for (const [name, tip, colour] of axes) {
    const end = project(tip);
    const start = project([0, 0, 0]);
    if (end === null || start === null || Math.hypot(end.x - start.x, end.y - start.y) < 3) continue;
    context.strokeStyle = context.fillStyle = colour;
    context.beginPath();
    line(context, project, [0, 0, 0], tip);
    context.stroke();
    context.fillText(name, end.x + 3, end.y);
  }
  context.lineWidth = 1;
}

/** How long one cell is, in the corner, and where its lines are. */
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
