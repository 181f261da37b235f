// The part of the timeline that does not scroll with the lanes: the axis, the acts, their phases, and events.
import type { Sheet } from "../canvas/useCanvas";
import { FONT, MONO } from "../canvas/palette";
import { hatch } from "../canvas/hatch";
import { fitText } from "../canvas/text";
import { nameOfAct, playedUntil } from "../data/fate";
import type { Show } from "../data/show";
import { fateText } from "../text/fate";
import { duration, niceTime } from "../text/time";
import { drawEvents } from "./events";
import { drawPhases } from "./phases";
import { ticks, type Scale } from "./scale";

export const BAND = { axis: 24, acts: 24, phases: 24, events: 24 };
export const HEAD_HEIGHT = BAND.axis + BAND.acts + BAND.phases + BAND.events;
export const BAND_TOP = { acts: BAND.axis, phases: BAND.axis + BAND.acts, events: BAND.axis + BAND.acts + BAND.phases };

export function drawHead(sheet: Sheet, scale: Scale, show: Show): void {
  const { context, palette, width } = sheet;
  context.fillStyle = palette.raised;
  context.fillRect(0, 0, width, HEAD_HEIGHT);
  drawAxis(sheet, scale);
  drawActs(sheet, scale, show);
  drawPhases(sheet, scale, show, BAND_TOP.phases, BAND.phases);
  drawEvents(sheet, scale, show, BAND_TOP.events, BAND.events);
  context.strokeStyle = palette.line;
  context.beginPath();
  for (const y of [BAND_TOP.acts, BAND_TOP.phases, BAND_TOP.events, HEAD_HEIGHT]) {
    context.moveTo(0, y - 0.5);
    context.lineTo(width, y - 0.5);
  }
  context.stroke();
}

function drawAxis({ context, palette, width }: Sheet, scale: Scale): void {
  const step = niceTime(scale.perPixel, 80);
  context.font = MONO;
  context.textBaseline = "middle";
  context.fillStyle = palette.dim;
  context.strokeStyle = palette.line;
  context.beginPath();
  for (const time of ticks(scale, step)) {
    const x = Math.round(scale.x(time)) + 0.5;
    context.moveTo(x, BAND.axis - 7);
    context.lineTo(x, BAND.axis);
    if (x + 34 < width) context.fillText(axisLabel(time, step), x + 4, 11);
  }
  for (const time of ticks(scale, step / 5)) {
    const x = Math.round(scale.x(time)) + 0.5;
    context.moveTo(x, BAND.axis - 3);
    context.lineTo(x, BAND.axis);
  }
  context.stroke();
}

export function axisLabel(ms: number, step: number): string {
  if (step < 1000) return duration(Number(ms.toFixed(3)));
  const seconds = Math.round(Math.abs(ms) / 1000);
  const sign = ms < 0 ? "-" : "";
  return seconds < 60 ? `${sign}${seconds} s` : `${sign}${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`;
}

function drawActs({ context, palette, width }: Sheet, scale: Scale, show: Show): void {
  context.font = FONT;
  for (const act of show.mission.acts) {
    const left = Math.max(scale.x(act.start), -2);
    const right = Math.min(scale.x(act.end), width + 2);
    if (right < 0 || left > width) continue;
    context.fillStyle = palette.sunken;
    context.strokeStyle = palette.accent;
    context.beginPath();
    context.roundRect(left + 0.5, BAND_TOP.acts + 3.5, Math.max(2, right - left - 1), BAND.acts - 8, 3);
    context.setLineDash(act.fate === "withdrawn" ? [3, 3] : []);
    context.fill();
    context.stroke();
    context.setLineDash([]);
    const played = Math.max(left, Math.min(right, scale.x(playedUntil(act))));
    hatch(context, palette.line, played, BAND_TOP.acts + 4, right - played, BAND.acts - 9);
    context.fillStyle = palette.text;
    const ended = act.fate === undefined || act.fate === "played" ? "" : `: ${fateText(act)}`;
    const name = `${nameOfAct(act)}${ended}`;
    const waits = show.planOf(act)?.waits ?? "";
    fitText(
      context,
      waits === "" ? name : `${name} (waits: ${waits})`,
      Math.max(left, 0) + 7,
      BAND_TOP.acts + 12,
      right - Math.max(left, 0) - 12,
    );
  }
}
