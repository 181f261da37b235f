// Text on a canvas, cut to the available width.
import { visible } from "../text/visible";

const widths = new Map<string, number>();
/** Enough for the names of one screen; more would only waste memory. */
const REMEMBERED = 5000;

export function widthOf(context: CanvasRenderingContext2D, text: string): number {
  const key = `${context.font}\n${text}`;
  let width = widths.get(key);
  if (width === undefined) {
    if (widths.size >= REMEMBERED) widths.clear();
    width = context.measureText(text).width;
    widths.set(key, width);
  }
  return width;
}

/** Draws as much of `text` as fits, with an ellipsis if it is cut. Draws nothing if not even that fits. */
export function fitText(context: CanvasRenderingContext2D, text: string, x: number, y: number, room: number): void {
  const shown = cut(context, visible(text), room);
  if (shown !== "") context.fillText(shown, x, y);
}

function cut(context: CanvasRenderingContext2D, text: string, room: number): string {
  if (widthOf(context, text) <= room) return text;
  const characters = [...text];
  const each = widthOf(context, text) / characters.length;
  let length = Math.min(characters.length, Math.floor(room / each));
  while (length > 1 && widthOf(context, `${characters.slice(0, length).join("")}…`) > room) length--;
  return length > 1 ? `${characters.slice(0, length).join("")}…` : "";
}
