// Position of a device, in words.
import type { Reading, Track } from "../data/track";
import { digits, rounded, withUnit } from "./digits";

const WHY: Record<Reading["known"], string> = {
  moving: "",
  held: "",
  unplayed: " (planned, not played)",
  default: " (default)",
  first: " (not known; its first step)",
  unknown: "not known",
};

export function describeReading(track: Track, reading: Reading): string {
  const step = stepOf(track, reading);
  return `${valueOf(track, reading)}${WHY[reading.known]}${step === "" ? "" : `, ${step}`}`;
}

export function valueOf(track: Track, reading: Reading): string {
  if (reading.known === "unknown") return "";
  return withUnit(exactly(track, reading) ? digits(reading.value) : rounded(reading.value), unitOf(track, reading));
}

export function stepOf(track: Track, { segment, step }: Reading): string {
  return segment === null ? "" : `step ${step + 1} of ${track.wave(segment).count}`;
}

/** Whether the value is that of a step, as in the document. A value between two steps is calculated. */
function exactly(track: Track, { segment, step, value }: Reading): boolean {
  return segment === null || value === track.wave(segment).value(step);
}

function unitOf(track: Track, { segment }: Reading): string {
  const { unit } = track.device;
  const control = segment?.lane.control ?? "position";
  // For a second or third value, the name of the control ends with its number.
  if (control.startsWith("speed")) return unit === "" ? "" : `${unit}/s`;
  if (control.startsWith("acceleration")) return unit === "" ? "" : `${unit}/s²`;
  return unit;
}
