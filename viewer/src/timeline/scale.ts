// Conversion between milliseconds and pixels.
import type { View } from "../data/envelope";

export interface Scale {
  x: (ms: number) => number;
  ms: (x: number) => number;
  perPixel: number;
  width: number;
  view: View;
}

export function scaleOf(view: View, width: number): Scale {
  const perPixel = (view.to - view.from) / Math.max(1, width);
  return {
    x: (ms) => (ms - view.from) / perPixel,
    ms: (x) => view.from + x * perPixel,
    perPixel,
    width,
    view,
  };
}

/** Times of the marks on the axis that are in view. */
export function ticks(scale: Scale, step: number): number[] {
  const times: number[] = [];
  for (let i = Math.ceil(scale.view.from / step); i * step <= scale.view.to; i++) times.push(i * step);
  return times;
}
