// The planned movement: its error band, the line as the device moves between steps, and the steps if there is room.
import type { Sheet } from "../canvas/useCanvas";
import type { Segment, Track } from "../data/track";
import { stepsInView, type Plot } from "./plot";

/** Pixels that each step needs to be drawn as a point. */
const ROOM_OF_POINT = 7;
/** Pixels around the plot into which points and lines may extend. */
const ROOM_AROUND = 4;

export function drawPlanned(sheet: Sheet, plot: Plot): void {
  drawBand(sheet, plot);
  const steps = stepsInView(plot);
  if (steps > plot.scale.width) {
    drawColumns(sheet, plot);
    return;
  }
  for (const segment of plot.track.segments) {
    if (segment.start <= plot.scale.view.to) drawParts(sheet, plot, segment, steps * ROOM_OF_POINT < plot.scale.width);
  }
}

function drawBand({ context, palette }: Sheet, { track, scale, envelope, y }: Plot): void {
  context.fillStyle = palette.band;
  context.beginPath();
  for (let x = 0; x < envelope.low.length; x++) {
    const error = envelope.unplayed[x] === 1 ? 0 : errorAt(track, scale.ms(x));
    if (!(error > 0) || Number.isNaN(envelope.low[x])) continue;
    const top = y(envelope.high[x] + error);
    context.rect(x, top, 1, y(envelope.low[x] - error) - top);
  }
  context.fill();
}

function errorAt(track: Track, ms: number): number {
  return track.segments[Math.max(0, track.segmentAt(ms))]?.lane.worst_error ?? 0;
}

function drawColumns({ context, palette }: Sheet, { envelope, y }: Plot): void {
  context.fillStyle = palette.planned;
  context.beginPath();
  for (let x = 0; x < envelope.low.length; x++) {
    if (Number.isNaN(envelope.low[x]) || (envelope.unplayed[x] === 1 && x % 8 >= 4)) continue;
    const top = y(envelope.high[x]) - 0.75;
    context.rect(x, top, 1, y(envelope.low[x]) - top + 0.75);
  }
  context.fill();
}

/** After the last step, the device keeps its value until its next script. */
function drawHeld(context: CanvasRenderingContext2D, { track, scale }: Plot, segment: Segment, y: number, from: number): void {
  const next = track.segments[track.segments.indexOf(segment) + 1];
  context.setLineDash([2, 4]);
  context.beginPath();
  context.moveTo(Math.max(from, 0), y);
  context.lineTo(Math.min(next === undefined ? scale.width : scale.x(next.start), scale.width), y);
  context.stroke();
  context.setLineDash([]);
}

/** Draws the played part, and the rest fainter and dashed. */
function drawParts(sheet: Sheet, plot: Plot, segment: Segment, points: boolean): void {
  const { context } = sheet;
  const { scale, top, height } = plot;
  const until = Math.max(0, Math.min(scale.width, scale.x(segment.playedUntil)));
  for (const unplayed of [false, true]) {
    const [from, to] = unplayed ? [until, scale.width] : [0, until];
    if (to <= from) continue;
    context.save();
    context.beginPath();
    context.rect(from, top - ROOM_AROUND, to - from, height + 2 * ROOM_AROUND);
    context.clip();
    context.globalAlpha = unplayed ? 0.55 : 1;
    drawSegment(sheet, plot, segment, points && !unplayed, unplayed ? [4, 4] : []);
    context.restore();
  }
}

function drawSegment({ context, palette }: Sheet, plot: Plot, segment: Segment, points: boolean, dashes: number[]): void {
  const { track, scale, y } = plot;
  const wave = track.wave(segment);
  const first = Math.max(0, wave.at(scale.view.from - segment.start));
  const end = Math.min(wave.count, wave.from(scale.view.to - segment.start) + 1);
  if (end <= first) return;
  const x = (i: number) => scale.x(segment.start + wave.time(i));
  context.strokeStyle = context.fillStyle = palette.planned;
  context.lineWidth = 1.5;
  context.setLineDash(dashes);
  context.beginPath();
  context.moveTo(x(first), y(wave.value(first)));
  for (let i = first + 1; i < end; i++) {
    if (track.device.interpolation === "hold") context.lineTo(x(i), y(wave.value(i - 1)));
    context.lineTo(x(i), y(wave.value(i)));
  }
  context.stroke();
  context.setLineDash([]);
  context.lineWidth = 1;
  if (end === wave.count) drawHeld(context, plot, segment, y(wave.value(end - 1)), x(end - 1));
  if (!points) return;
  context.beginPath();
  for (let i = first; i < end; i++) {
    context.moveTo(x(i) + 2.5, y(wave.value(i)));
    context.arc(x(i), y(wave.value(i)), 2.5, 0, 2 * Math.PI);
  }
  context.fill();
}
