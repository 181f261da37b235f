// Times and other quantities as people read them: two significant digits and a unit of a suitable size. Tooltips have all digits.

const UNITS = [
  { name: "s", ms: 1000 },
  { name: "ms", ms: 1 },
  { name: "µs", ms: 1e-3 },
  { name: "ns", ms: 1e-6 },
] as const;

type Unit = (typeof UNITS)[number];

/** Below this share of a unit, the next smaller unit is easier to read. */
const SMALLEST_SHARE = 0.1;

/** The unit for a time in milliseconds: up to 2 s in ms, as lateness and spreads are compared in it. */
function unitOf(ms: number): Unit {
  const size = Math.abs(ms);
  if (size >= 2000) return UNITS[0];
  return UNITS.slice(1).find((unit) => size >= SMALLEST_SHARE * unit.ms) ?? UNITS[UNITS.length - 1];
}

/** Two significant digits, or more in front of the point; whole numbers as they are. */
export function significant(value: number): string {
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  if (!Number.isFinite(value)) return "–";
  const decimals = Math.max(0, 1 - Math.floor(Math.log10(size)));
  const text = value.toFixed(Math.min(decimals, 12));
  // 9.96 has one decimal, but is shown as "10".
  return Math.abs(Number(text)) >= 10 && size < 10 ? value.toFixed(0) : text;
}

/** "225 ms", "3.8 µs", "2.5 s", "0 ms". */
export function time(ms: number | null | undefined): string {
  if (ms === null || ms === undefined || Number.isNaN(ms)) return "–";
  if (ms === 0) return "0 ms";
  const unit = unitOf(ms);
  return `${significant(ms / unit.ms)} ${unit.name}`;
}

export const signedTime = (ms: number): string => `${ms > 0 ? "+" : ""}${time(ms)}`;

/** All digits, for a tooltip. */
export const exactly = (ms: number | null | undefined): string | undefined =>
  ms === null || ms === undefined ? undefined : `exactly ${String(ms)} ms`;

/** Characters as wide as a digit, and as a point, in fonts with tabular numbers. */
const DIGIT_SPACE = "\u2007";
const POINT_SPACE = "\u2008";

/** A column in one unit. Its cells are filled with spaces so that their decimal points are below each other if they end at the right. */
export interface Aligned {
  unit: string;
  cells: string[];
}

export function aligned(values: readonly (number | null)[]): Aligned {
  const known = values.filter((value): value is number => value !== null && Number.isFinite(value));
  const unit = unitOf(known.reduce((most, value) => Math.max(most, Math.abs(value)), 0) || 1);
  const cells = values.map((value) => (value === null || !Number.isFinite(value) ? null : significant(value / unit.ms)));
  const longest = Math.max(0, ...cells.map((cell) => decimalsOf(cell)));
  return { unit: unit.name, cells: cells.map((cell) => (cell === null ? "–" : `${cell}${fill(decimalsOf(cell), longest)}`)) };
}

const decimalsOf = (cell: string | null) => (cell === null || !cell.includes(".") ? 0 : cell.length - cell.indexOf(".") - 1);
const fill = (has: number, longest: number) =>
  `${has === 0 && longest > 0 ? POINT_SPACE : ""}${DIGIT_SPACE.repeat(longest - has)}`;

/** "0:09.2" for sentences. */
export function shortClock(ms: number): string {
  const tenths = Math.round(Math.abs(ms) / 100);
  const minutes = Math.floor(tenths / 600);
  const seconds = ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
  return `${ms < 0 && tenths > 0 ? "-" : ""}${minutes}:${seconds}`;
}
