// Events as marks on the axis: failures as crosses, the rest as diamonds.
import { FONT } from "../canvas/palette";
import { widthOf } from "../canvas/text";
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import type { MissionEvent } from "../mission";
import { visible } from "../text/visible";
import type { Scale } from "./scale";

const FAILURES = new Set(["failed", "dropped", "link_lost", "ntp_lost", "journal_lost", "stopping", "act_skipped"]);

export function isFailure({ kind }: MissionEvent): boolean {
  return FAILURES.has(kind);
}

export function describeEvent(show: Show, { kind, robot, text }: MissionEvent): string {
  const what = text === "" ? kind.replaceAll("_", " ") : text;
  return robot === null ? what : `${show.mission.robots[robot]?.id ?? `robot ${robot}`}: ${what}`;
}

export function drawEvents(sheet: Sheet, scale: Scale, show: Show, top: number, height: number): void {
  const { context, palette, width } = sheet;
  const middle = top + height / 2;
  const events = show.mission.events.filter(({ at }) => scale.x(at) > -200 && scale.x(at) < width + 10);
  context.font = FONT;
  let drawn = -Infinity;
  events.forEach((event, i) => {
    const x = scale.x(event.at);
    const failure = isFailure(event);
    // Thousands of accepted requests share one pixel, but a failure among them is always drawn.
    if (x - drawn < 2 && !failure) return;
    drawn = x;
    context.fillStyle = context.strokeStyle = failure ? palette.bad : palette.dim;
    if (failure) cross(context, x, middle);
    else diamond(context, x, middle);
    const room = (i + 1 < events.length ? scale.x(events[i + 1].at) : width) - x - 16;
    const text = visible(failure ? describeEvent(show, event) : event.kind.replaceAll("_", " "));
    if (widthOf(context, text) < room) context.fillText(text, x + 8, middle);
  });
}

function cross(context: CanvasRenderingContext2D, x: number, y: number): void {
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(x - 4, y - 4);
  context.lineTo(x + 4, y + 4);
  context.moveTo(x + 4, y - 4);
  context.lineTo(x - 4, y + 4);
  context.stroke();
  context.lineWidth = 1;
}

function diamond(context: CanvasRenderingContext2D, x: number, y: number): void {
  context.beginPath();
  context.moveTo(x, y - 4);
  context.lineTo(x + 4, y);
  context.lineTo(x, y + 4);
  context.lineTo(x - 4, y);
  context.fill();
}
