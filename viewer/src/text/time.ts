// Formatted times.

/** "1:02.345", "-0:00.389". */
export function clock(ms: number): string {
  const whole = Math.round(Math.abs(ms));
  const minutes = Math.floor(whole / 60_000);
  const seconds = ((whole % 60_000) / 1000).toFixed(3).padStart(6, "0");
  return `${ms < 0 && whole > 0 ? "-" : ""}${minutes}:${seconds}`;
}

/** "250 ms", "1.5 s". */
export function duration(ms: number): string {
  return Math.abs(ms) < 1000 ? `${rounded(ms)} ms` : `${rounded(ms / 1000)} s`;
}

/** With its sign, in ms: "+1.25 ms". */
export function signedMs(ms: number): string {
  return `${ms < 0 ? "" : "+"}${rounded(ms)} ms`;
}

const rounded = (value: number) => String(Number(value.toFixed(3)));

/** Local time of day of an instant on the axis. */
export function timeOfDay(epoch: string, ms: number): string {
  const start = Date.parse(epoch);
  if (Number.isNaN(start)) return "";
  const date = new Date(start + ms);
  const milliseconds = String(date.getMilliseconds()).padStart(3, "0");
  return `${date.toLocaleTimeString(undefined, { hour12: false })}.${milliseconds}`;
}

/** Distance between labels that are at least `room` pixels apart: 1, 2 or 5 times a power of 10. */
export function niceStep(perPixel: number, room: number): number {
  const least = perPixel * room;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * ([1, 2, 5].find((factor) => factor * power >= least) ?? 10);
}

/** Minutes do not divide by ten, so from one second up the time axis has its own steps. */
export function niceTime(perPixel: number, room: number): number {
  const least = perPixel * room;
  const steps = [1000, 2000, 5000, 10_000, 15_000, 30_000, 60_000, 120_000, 300_000, 600_000, 1_800_000, 3_600_000];
  return least < 1000 ? niceStep(perPixel, room) : (steps.find((step) => step >= least) ?? niceStep(perPixel, room));
}
