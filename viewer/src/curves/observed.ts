// Values that robots set, as squares, and values that sensors read, as triangles. A line through a mark shows the uncertainty of its
// time.
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import type { Wave } from "../data/wave";
import type { Plot } from "./plot";

/** Pixels that each mark needs to be drawn at full size. */
const ROOM_OF_MARK = 9;
/** Pixels below which values that were set are not drawn. */
const LEAST_ROOM = 6;

export function drawObserved(sheet: Sheet, plot: Plot, show: Show): void {
  for (const kind of ["set", "read"] as const) {
    for (const { wave } of show.observed(kind, plot.track)) drawMarks(sheet, plot, show, wave, kind);
  }
}

function drawMarks({ context, palette }: Sheet, plot: Plot, show: Show, wave: Wave, kind: "set" | "read"): void {
  const { scale, y } = plot;
  const first = wave.from(scale.view.from);
  const end = wave.from(scale.view.to);
  // Marks without room would hide the line; the deviations are listed.
  const room = end > first ? (scale.x(wave.time(end - 1)) - scale.x(wave.time(first))) / (end - first) : 0;
  if (kind === "set" && end - first > 1 && room < LEAST_ROOM) return;
  const size = (end - first) * ROOM_OF_MARK < scale.width ? 3.5 : 1.5;
  let before = { x: -10, y: -10 };
  context.strokeStyle = kind === "set" ? palette.set : palette.read;
  context.lineWidth = 1.25;
  context.beginPath();
  for (let i = first; i < end; i++) {
    const at = { x: scale.x(wave.time(i)), y: y(wave.value(i)) };
    // Marks on top of each other would cost time and show nothing.
    if (Math.abs(at.x - before.x) < 1 && Math.abs(at.y - before.y) < 1) continue;
    before = at;
    if (kind === "set") context.rect(at.x - size, at.y - size, 2 * size, 2 * size);
    else triangle(context, at.x, at.y, size * 1.3);
    const off = show.clockUncertainty(plot.track.robotIndex, wave.time(i)) / scale.perPixel;
    if (off > 4) errorBar(context, at.x, at.y, off);
  }
  context.stroke();
  context.lineWidth = 1;
}

function triangle(context: CanvasRenderingContext2D, x: number, y: number, size: number): void {
  context.moveTo(x, y - size);
  context.lineTo(x + size, y + size * 0.7);
  context.lineTo(x - size, y + size * 0.7);
  context.closePath();
}

function errorBar(context: CanvasRenderingContext2D, x: number, y: number, off: number): void {
  context.moveTo(x - off, y);
  context.lineTo(x + off, y);
  for (const end of [x - off, x + off]) {
    context.moveTo(end, y - 3);
    context.lineTo(end, y + 3);
  }
}
