// One series in memory: values over time, with a pyramid of their extents.
import type { Column, Series } from "../mission";
import { decode, type Numbers } from "./column";
import { Pyramid, type Extent } from "./pyramid";

export class Wave {
  private readonly pyramid: Pyramid;

  constructor(
    private readonly t: Numbers,
    private readonly v: Numbers,
  ) {
    this.pyramid = new Pyramid(v.integers);
  }

  get count(): number {
    return this.t.integers.length;
  }

  time(i: number): number {
    return this.t.integers[i] / this.t.divisor;
  }

  value(i: number): number {
    return this.v.integers[i] / this.v.divisor;
  }

  /** Index of the last value at or before `ms`; -1 before the first. */
  at(ms: number): number {
    return this.firstWhere((time) => time > ms) - 1;
  }

  /** Index of the first value at or after `ms`; `count` after the last. */
  from(ms: number): number {
    return this.firstWhere((time) => time >= ms);
  }

  /** As `from`, but not before `hint`. Fast if the result is close to it. */
  fromHint(ms: number, hint: number): number {
    const { integers, divisor } = this.t;
    let step = 1;
    let low = hint;
    while (low + step < integers.length && integers[low + step] / divisor < ms) {
      low += step;
      step *= 2;
    }
    let high = Math.min(low + step, integers.length);
    while (low < high) {
      const middle = (low + high) >> 1;
      if (integers[middle] / divisor < ms) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Value at `ms`, interpolated as the device moves between steps; NaN before the first. */
  valueAt(ms: number, interpolation: "hold" | "linear"): number {
    const i = this.at(ms);
    if (i < 0) return NaN;
    return this.between(i, ms, interpolation);
  }

  /** Value at `ms`, if `i` is the last step at or before it. */
  between(i: number, ms: number, interpolation: "hold" | "linear"): number {
    const value = this.value(i);
    if (interpolation === "hold" || i + 1 >= this.count) return value;
    const time = this.time(i);
    const way = this.time(i + 1) - time;
    return way > 0 && ms > time ? value + ((this.value(i + 1) - value) * (ms - time)) / way : value;
  }

  /** Widens `extent` by the values with indices from `first` up to, but not including, `end`. */
  widen(extent: Extent, first: number, end: number): void {
    if (end <= first) return;
    const integers = { low: Infinity, high: -Infinity };
    this.pyramid.widen(integers, first, end);
    extent.low = Math.min(extent.low, integers.low / this.v.divisor);
    extent.high = Math.max(extent.high, integers.high / this.v.divisor);
  }

  private firstWhere(holds: (time: number) => boolean): number {
    let low = 0;
    let high = this.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (holds(this.time(middle))) high = middle;
      else low = middle + 1;
    }
    return low;
  }
}

/** Decodes each column only once, on first use: robots in unison share their columns. */
export class Waves {
  private readonly decoded = new Map<string, Numbers>();
  private readonly waves = new Map<Series, Wave>();
  private readonly alike = new Map<string, Wave>();

  constructor(private readonly columns: Uint8Array) {}

  of(series: Series): Wave {
    let wave = this.waves.get(series);
    if (wave === undefined) {
      wave = remembered(
        this.alike,
        `${nameOf(series.t)} ${nameOf(series.v)}`,
        () => new Wave(this.numbers(series.t), this.numbers(series.v)),
      );
      this.waves.set(series, wave);
    }
    return wave;
  }

  private numbers(column: Column): Numbers {
    return remembered(this.decoded, nameOf(column), () => decode(this.columns, column));
  }
}

const nameOf = ({ at, n, decimals, order }: Column) => `${at}/${n}/${decimals}/${order}`;

function remembered<T>(known: Map<string, T>, name: string, make: () => T): T {
  const value = known.get(name) ?? make();
  known.set(name, value);
  return value;
}
