// Finds the minimum and maximum of any range of numbers without reading all of them: each level summarizes 16 entries of the level below.
import type { Numbers } from "./column";

const FAN = 16;

type Level = { low: Numbers["integers"]; high: Numbers["integers"] };

/** Reused by every query, because a frame makes tens of thousands of queries. */
export interface Extent {
  low: number;
  high: number;
}

export class Pyramid {
  private readonly levels: Level[] = [];

  constructor(integers: Numbers["integers"]) {
    this.levels.push({ low: integers, high: integers });
    while (this.top.low.length > FAN) this.levels.push(coarser(this.top));
  }

  private get top(): Level {
    return this.levels[this.levels.length - 1];
  }

  /** Widens `extent` by the entries from `first` up to, but not including, `end`. */
  widen(extent: Extent, first: number, end: number): void {
    for (const level of this.levels) {
      if (end - first <= 2 * FAN || level === this.top) return scan(level, extent, first, end);
      const full = Math.ceil(first / FAN) * FAN;
      const rest = Math.floor(end / FAN) * FAN;
      scan(level, extent, first, full);
      scan(level, extent, rest, end);
      first = full / FAN;
      end = rest / FAN;
    }
  }
}

function scan({ low, high }: Level, extent: Extent, first: number, end: number): void {
  for (let i = first; i < end; i++) {
    if (low[i] < extent.low) extent.low = low[i];
    if (high[i] > extent.high) extent.high = high[i];
  }
}

function coarser(below: Level): Level {
  const n = Math.ceil(below.low.length / FAN);
  const make = () => (below.low instanceof Int32Array ? new Int32Array(n) : new Float64Array(n));
  const level = { low: make(), high: make() };
  for (let i = 0; i < n; i++) {
    const extent = { low: Infinity, high: -Infinity };
    scan(below, extent, i * FAN, Math.min((i + 1) * FAN, below.low.length));
    level.low[i] = extent.low;
    level.high[i] = extent.high;
  }
  return level;
}
