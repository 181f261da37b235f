// A canvas with the size of its box and the resolution of the screen, redrawn when one of its cells changes.
import { useEffect, useRef, type MutableRef } from "preact/hooks";
import type { Cell } from "../state/cell";
import { useSession } from "../state/session";
import { redraw } from "./frames";
import { palette, type Palette } from "./palette";

export interface Sheet {
  context: CanvasRenderingContext2D;
  width: number;
  height: number;
  palette: Palette;
}

export interface DrawnCanvas {
  canvas: MutableRef<HTMLCanvasElement | null>;
  invalidate: () => void;
}

interface CanvasOptions {
  /** Whether the canvas is transparent, because another one below it shows the picture. It is opaque by default. */
  clear?: () => boolean;
}

export function useCanvas(
  cells: readonly Pick<Cell<unknown>, "subscribe">[],
  draw: (sheet: Sheet) => void,
  { clear }: CanvasOptions = {},
): DrawnCanvas {
  const { theme } = useSession();
  const canvas = useRef<HTMLCanvasElement>(null);
  const latest = useRef(draw);
  latest.current = draw;
  const invalidate = useRef(() => {});
  useEffect(() => {
    const element = canvas.current;
    const context = element?.getContext("2d", { alpha: clear !== undefined }) ?? null;
    if (element === null || context === null) return;
    const paint = () => {
      const colours = palette(theme.value, element);
      const { width, height } = fitToBox(element, context);
      context.fillStyle = colours.ground;
      if (clear?.() === true) context.clearRect(0, 0, width, height);
      else context.fillRect(0, 0, width, height);
      latest.current({ context, width, height, palette: colours });
    };
    invalidate.current = () => redraw(paint);
    const resized = new ResizeObserver(invalidate.current);
    resized.observe(element);
    const stops = [theme, ...cells].map((cell) => cell.subscribe(invalidate.current));
    invalidate.current();
    return () => {
      resized.disconnect();
      stops.forEach((stop) => stop());
      invalidate.current = () => {};
    };
  }, []);
  useEffect(() => invalidate.current());
  return { canvas, invalidate: () => invalidate.current() };
}

function fitToBox(canvas: HTMLCanvasElement, context: CanvasRenderingContext2D): { width: number; height: number } {
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const sharpness = Math.min(window.devicePixelRatio || 1, 2);
  const device = [Math.round(width * sharpness), Math.round(height * sharpness)];
  if (canvas.width !== device[0] || canvas.height !== device[1]) [canvas.width, canvas.height] = device;
  context.setTransform(sharpness, 0, 0, sharpness, 0, 0);
  return { width, height };
}
