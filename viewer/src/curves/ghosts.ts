// Curves of the plan to which this one is compared, behind the planned curves.
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import type { Wave } from "../data/wave";
import type { Scale } from "../timeline/scale";
import type { Plot } from "./plot";

export function drawGhosts({ context, palette }: Sheet, { track, scale, y }: Plot, show: Show): void {
  context.strokeStyle = palette.dim;
  context.setLineDash([6, 3]);
  for (const { start, wave } of show.ghostsOf(track)) {
    const { first, end } = inView(wave, start, scale);
    // More than a few steps per pixel would cost time and show nothing.
    const stride = Math.max(1, Math.floor((end - first) / (4 * scale.width)));
    context.beginPath();
    for (let i = first; i < end; i += stride) {
      const x = scale.x(start + wave.time(i));
      if (i === first) context.moveTo(x, y(wave.value(i)));
      else if (track.device.interpolation === "hold") context.lineTo(x, y(wave.value(i - stride)));
      context.lineTo(x, y(wave.value(i)));
    }
    context.stroke();
  }
  context.setLineDash([]);
}

/** The steps in view, and one more on each side. */
export function inView(wave: Wave, start: number, { view }: Scale): { first: number; end: number } {
  return { first: Math.max(0, wave.at(view.from - start)), end: Math.min(wave.count, wave.from(view.to - start) + 1) };
}
