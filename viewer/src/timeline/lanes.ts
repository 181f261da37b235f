// Planned movement of devices, one lane each; the devices of a folded robot share one lane. Parts that were not played are dashed.
import { fillEnvelope, makeEnvelope, type Envelope } from "../data/envelope";
import type { Show } from "../data/show";
import type { Track } from "../data/track";
import { inView } from "../curves/ghosts";
import type { Sheet } from "../canvas/useCanvas";
import type { Scale } from "./scale";

/** Number of devices of a folded robot that are drawn. */
const SUMMED_UP = 3;

/** Width of a column in pixels: that of a pixel of the screen, up to half a pixel of the page. */
const columnWidth = () => 1 / Math.min(2, Math.max(1, Math.round(window.devicePixelRatio || 1)));

let envelope: Envelope = makeEnvelope(0);

export function drawLane(sheet: Sheet, scale: Scale, show: Show, track: Track, top: number, height: number, chosen: boolean): void {
  const { context, palette } = sheet;
  drawGhosts(sheet, scale, show, track, top + 4, height - 8);
  context.fillStyle = palette.planned;
  context.globalAlpha = chosen ? 1 : 0.75;
  drawColumns(context, scale, track, top + 4, height - 8, columnWidth());
  context.globalAlpha = 1;
}

export function drawSummary(sheet: Sheet, scale: Scale, tracks: readonly Track[], top: number, height: number): void {
  const { context, palette } = sheet;
  context.fillStyle = palette.planned;
  context.globalAlpha = 0.4;
  for (const track of tracks.slice(0, SUMMED_UP)) drawColumns(context, scale, track, top + 2, height - 4, 1);
  context.globalAlpha = 1;
}

/** The lane in the plan or mission to which this one is compared, behind the lane. */
function drawGhosts({ context, palette }: Sheet, scale: Scale, show: Show, track: Track, top: number, height: number): void {
  const ghosts = show.ghostsOf(track);
  if (ghosts.length === 0) return;
  const extent = { ...track.extent };
  for (const { wave } of ghosts) wave.widen(extent, 0, wave.count);
  const y = (value: number) => top + height - ((value - extent.low) / (extent.high - extent.low || 1)) * height;
  context.strokeStyle = palette.dim;
  context.setLineDash([6, 3]);
  for (const { start, wave } of ghosts) {
    const { first, end } = inView(wave, start, scale);
    const stride = Math.max(1, Math.floor((end - first) / (2 * scale.width)));
    context.beginPath();
    for (let i = first; i < end; i += stride) {
      const x = scale.x(start + wave.time(i));
      if (i > first && track.device.interpolation === "hold") context.lineTo(x, y(wave.value(i - stride)));
      context.lineTo(x, y(wave.value(i)));
    }
    context.stroke();
  }
  context.setLineDash([]);
}

/** Pixels of a dash, and of the gap after it. */
const DASH = 3;
const isGap = (x: number) => x % (2 * DASH) >= DASH;

function drawColumns(
  context: CanvasRenderingContext2D,
  scale: Scale,
  track: Track,
  top: number,
  height: number,
  wide: number,
): void {
  const columns = Math.ceil(scale.width / wide);
  if (envelope.low.length !== columns) envelope = makeEnvelope(columns);
  const view = { from: scale.view.from, to: scale.view.from + columns * wide * scale.perPixel };
  fillEnvelope(envelope, track, view);
  const { low, high } = track.extent;
  const perUnit = high > low ? (height - 1.5) / (high - low) : 0;
  const base = high > low ? top + height : top + height / 2;
  context.beginPath();
  for (let x = 0; x < columns; x++) {
    if (Number.isNaN(envelope.low[x]) || (envelope.unplayed[x] === 1 && isGap(x * wide))) continue;
    const bottom = base - (envelope.low[x] - low) * perUnit;
    const size = (envelope.high[x] - envelope.low[x]) * perUnit + 1.5;
    context.rect(x * wide, bottom - size, wide, size);
  }
  context.fill();
}
