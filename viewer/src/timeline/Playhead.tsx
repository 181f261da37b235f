// The line of the playhead: an element above the canvas, because it moves on every frame while the picture below does not.
import { useEffect, useRef, type MutableRef } from "preact/hooks";
import type { View } from "../data/envelope";
import { redraw } from "../canvas/frames";
import { useSession } from "../state/session";
import { scaleOf } from "./scale";

interface PlayheadProps {
  of: MutableRef<HTMLCanvasElement | null>;
  /** Where its time axis begins, in pixels of the canvas. */
  left: number;
  /** The part of the mission that the canvas shows, if it does not follow the timeline. */
  view?: View;
}

export function Playhead({ of, left, view: fixed }: PlayheadProps) {
  const { playhead, view } = useSession();
  const line = useRef<HTMLDivElement>(null);
  useEffect(() => {
    const canvas = of.current;
    if (canvas === null) return;
    const move = () => {
      if (line.current === null) return;
      const width = canvas.clientWidth - left;
      const x = scaleOf(fixed ?? view.value, width).x(playhead.value);
      line.current.hidden = x < 0 || x > width;
      line.current.style.transform = `translateX(${canvas.offsetLeft + left + x}px)`;
    };
    const later = () => redraw(move);
    const resized = new ResizeObserver(later);
    resized.observe(canvas);
    const stops = [playhead, view].map((cell) => cell.subscribe(later));
    return () => {
      resized.disconnect();
      stops.forEach((stop) => stop());
    };
  }, []);
  return <div ref={line} class="playhead" />;
}
