// Position and range of values of one curve.
import { fillEnvelope, makeEnvelope, type Envelope } from "../data/envelope";
import type { Show } from "../data/show";
import type { Track } from "../data/track";
import { inView } from "./ghosts";
import type { Scale } from "../timeline/scale";

export interface Plot {
  track: Track;
  scale: Scale;
  envelope: Envelope;
  top: number;
  height: number;
  low: number;
  high: number;
  y: (value: number) => number;
}

export function makePlot(show: Show, track: Track, scale: Scale, top: number, height: number): Plot {
  const columns = Math.max(1, Math.round(scale.width));
  const envelope = makeEnvelope(columns);
  fillEnvelope(envelope, track, scale.view);
  const { low, high } = extentOf(show, track, scale, envelope);
  return { track, scale, envelope, top, height, low, high, y: (value) => top + height - ((value - low) / (high - low)) * height };
}

function extentOf(show: Show, track: Track, scale: Scale, envelope: Envelope): { low: number; high: number } {
  const extent = { low: Infinity, high: -Infinity };
  for (let x = 0; x < envelope.low.length; x++) {
    if (envelope.low[x] < extent.low) extent.low = envelope.low[x];
    if (envelope.high[x] > extent.high) extent.high = envelope.high[x];
  }
  for (const { wave } of [...show.observed("set", track), ...show.observed("read", track)]) {
    wave.widen(extent, Math.max(0, wave.at(scale.view.from)), wave.from(scale.view.to));
  }
  for (const { start, wave } of show.ghostsOf(track)) {
    const { first, end } = inView(wave, start, scale);
    if (first < end) wave.widen(extent, first, end);
  }
  if (extent.low > extent.high) Object.assign(extent, track.extent.low <= track.extent.high ? track.extent : { low: 0, high: 1 });
  const error = Math.max(0, ...track.segments.map(({ lane }) => lane.worst_error));
  const room =
    (extent.high - extent.low) * 0.08 + error ||
    Math.max(Math.abs(extent.high) * 0.05, (track.device.granularity ?? 0) * 4, 1e-6);
  return { low: extent.low - room, high: extent.high + room };
}

/** Number of planned steps in view. */
export function stepsInView({ track, scale }: Plot): number {
  let steps = 0;
  for (const segment of track.segments) {
    if (segment.start > scale.view.to) break;
    const wave = track.wave(segment);
    steps += wave.from(scale.view.to - segment.start) - wave.from(scale.view.from - segment.start);
  }
  return steps;
}
