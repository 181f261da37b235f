// Smallest and largest planned value of a device per pixel column, so that a single step is visible at any zoom.
import type { Extent } from "./pyramid";
import type { Segment, Track } from "./track";

export interface View {
  from: number;
  to: number;
}

/** Planned values per column; NaN if nothing is planned. */
export interface Envelope {
  low: Float64Array;
  high: Float64Array;
  /** 1 if nothing in the column was played. */
  unplayed: Uint8Array;
}

export function makeEnvelope(columns: number): Envelope {
  return { low: new Float64Array(columns), high: new Float64Array(columns), unplayed: new Uint8Array(columns) };
}

export function fillEnvelope(envelope: Envelope, track: Track, view: View): void {
  envelope.low.fill(NaN);
  envelope.high.fill(NaN);
  envelope.unplayed.fill(0);
  const first = Math.max(0, track.segmentAt(view.from));
  for (let s = first; s < track.segments.length && track.segments[s].start < view.to; s++) {
    fillSegment(envelope, track, track.segments[s], view);
  }
}

function fillSegment(envelope: Envelope, track: Track, segment: Segment, view: View): void {
  const wave = track.wave(segment);
  if (wave.count === 0) return;
  const columns = envelope.low.length;
  const width = (view.to - view.from) / columns;
  const begin = segment.start + wave.time(0);
  const end = Math.max(segment.end, segment.start + wave.time(wave.count - 1));
  const firstColumn = Math.max(0, Math.floor((begin - view.from) / width));
  const lastColumn = Math.min(columns - 1, Math.floor((end - view.from) / width));
  const extent: Extent = { low: 0, high: 0 };
  let step = wave.from(view.from + firstColumn * width - segment.start);
  for (let x = firstColumn; x <= lastColumn; x++) {
    const from = view.from + x * width - segment.start;
    const next = wave.fromHint(from + width, step);
    extent.low = Infinity;
    extent.high = -Infinity;
    wave.widen(extent, step, next);
    if (step > 0) include(extent, wave.between(step - 1, from, track.device.interpolation));
    if (next > 0) include(extent, wave.between(next - 1, from + width, track.device.interpolation));
    const unplayed = view.from + x * width >= segment.playedUntil;
    envelope.unplayed[x] = unplayed && (Number.isNaN(envelope.low[x]) || envelope.unplayed[x] === 1) ? 1 : 0;
    envelope.low[x] = Number.isNaN(envelope.low[x]) ? extent.low : Math.min(envelope.low[x], extent.low);
    envelope.high[x] = Number.isNaN(envelope.high[x]) ? extent.high : Math.max(envelope.high[x], extent.high);
    step = next;
  }
}

function include(extent: Extent, value: number): void {
  if (value < extent.low) extent.low = value;
  if (value > extent.high) extent.high = value;
}
