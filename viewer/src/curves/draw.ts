// Curves of the chosen lanes, one below the other on a common time axis.
import { FONT, MONO, type Palette } from "../canvas/palette";
import { fitText } from "../canvas/text";
import type { Sheet } from "../canvas/useCanvas";
import type { Session } from "../state/session";
import { rounded, withUnit } from "../text/digits";
import { niceStep, niceTime } from "../text/time";
import { axisLabel } from "../timeline/head";
import { scaleOf, ticks } from "../timeline/scale";
import { drawGhosts } from "./ghosts";
import { drawObserved } from "./observed";
import { drawPlanned } from "./planned";
import { makePlot, type Plot } from "./plot";

/** Room for the values on the left and the times below. */
export const MARGIN = { left: 62, bottom: 20 };
const TITLE = 18;
/** Grid lines of the granularity are drawn only if they are at least this many pixels apart. */
const GRAIN = 7;

export interface Slot {
  top: number;
  height: number;
}

/** Position of the plot of each chosen lane. */
export function slots(count: number, height: number): Slot[] {
  const each = (height - MARGIN.bottom) / Math.max(1, count);
  return Array.from({ length: count }, (_, i) => ({ top: i * each, height: each }));
}

export function drawCurves(sheet: Sheet, session: Session): void {
  const { context, palette, width, height } = sheet;
  const scale = scaleOf(session.view.value, width - MARGIN.left);
  context.save();
  context.translate(MARGIN.left, 0);
  const tracks = session.chosen.value;
  slots(tracks.length, height).forEach((slot, i) => {
    const plot = makePlot(session.show, tracks[i], scale, slot.top + TITLE, slot.height - TITLE - 4);
    drawAxes(sheet, plot);
    context.save();
    context.beginPath();
    context.rect(0, slot.top, scale.width, slot.height);
    context.clip();
    drawGhosts(sheet, plot, session.show);
    drawPlanned(sheet, plot);
    drawObserved(sheet, plot, session.show);
    context.restore();
    drawTitle(sheet, plot, slot.top);
  });
  context.strokeStyle = palette.line;
  context.strokeRect(-0.5, -1, scale.width + 2, height - MARGIN.bottom + 1);
  drawTimes(sheet, scale, height);
  context.restore();
}

function drawAxes({ context, palette }: Sheet, plot: Plot): void {
  const { low, high, height, y, scale, track } = plot;
  const perPixel = (high - low) / height;
  const grain = track.device.granularity;
  if (grain !== null && grain > 0 && grain / perPixel >= GRAIN) lines(context, palette.faint, plot, grain);
  const step = niceStep(perPixel, 24);
  context.font = MONO;
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (let i = Math.ceil(low / step); i * step <= high; i++) {
    context.fillStyle = palette.faint;
    context.fillRect(0, Math.round(y(i * step)), scale.width, 1);
    context.fillStyle = palette.dim;
    context.fillText(rounded(i * step, 6), -5, y(i * step));
  }
  context.textAlign = "left";
}

function lines(context: CanvasRenderingContext2D, colour: Palette["faint"], { low, high, y, scale }: Plot, step: number): void {
  context.strokeStyle = colour;
  context.setLineDash([1, 3]);
  context.beginPath();
  for (let i = Math.ceil(low / step); i * step <= high; i++) {
    const at = Math.round(y(i * step)) + 0.5;
    context.moveTo(0, at);
    context.lineTo(scale.width, at);
  }
  context.stroke();
  context.setLineDash([]);
}

function drawTitle({ context, palette }: Sheet, { track, scale }: Plot, top: number): void {
  context.fillStyle = palette.line;
  if (top > 0) context.fillRect(-MARGIN.left, Math.round(top), scale.width + MARGIN.left, 1);
  context.font = FONT;
  context.textBaseline = "middle";
  context.fillStyle = palette.text;
  const error = Math.max(0, ...track.segments.map(({ lane }) => lane.worst_error));
  const band = error > 0 ? `, ± ${withUnit(rounded(error), track.device.unit)}` : "";
  const unit = track.device.unit === "" ? "" : ` (${track.device.unit})`;
  fitText(context, `${track.robot.id} / ${track.name}${unit}${band}`, 6, top + 10, scale.width - 12);
}

function drawTimes({ context, palette }: Sheet, scale: ReturnType<typeof scaleOf>, height: number): void {
  context.font = MONO;
  context.textBaseline = "middle";
  context.fillStyle = palette.dim;
  const step = niceTime(scale.perPixel, 90);
  for (const time of ticks(scale, step)) {
    context.fillRect(Math.round(scale.x(time)), height - MARGIN.bottom, 1, 4);
    if (scale.x(time) + 40 < scale.width) context.fillText(axisLabel(time, step), scale.x(time) + 3, height - MARGIN.bottom + 11);
  }
}
