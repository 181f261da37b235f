// Cues as bars: the name, the slack as a lighter extension behind all bars, and a heavy edge with a mark if there is no slack. A cue
// without duration is a pin. A cue that was not played is an empty bar with a dashed outline.
import { FONT } from "../canvas/palette";
import { hatch } from "../canvas/hatch";
import { fitText, widthOf } from "../canvas/text";
import type { Sheet } from "../canvas/useCanvas";
import type { PlacedCue } from "../data/show";
import { visible } from "../text/visible";
import { hueOfCue } from "./packed";
import type { Scale } from "./scale";

export interface CueStyle {
  selected: number | null;
  findings: ReadonlyMap<number, CueFindings>;
  /** Position of the cue in the plan to which this one is compared. */
  ghost: (placed: PlacedCue) => { start: number; end: number } | null;
  /** Whether the robot of the bar's row was left out. */
  leftOut?: (placed: PlacedCue) => boolean;
}

/** Codes of the findings of a cue, and the worst severity. */
export interface CueFindings {
  codes: string;
  severity: "error" | "warning";
}

/** A narrower bar is a pin, so that it can be seen. */
export const PIN = 5;
/** Pixels that a pin needs. */
const ROOM_OF_PIN = 12;

/** Draws cues that do not overlap, in order of time. */
export function drawCues(sheet: Sheet, scale: Scale, cues: readonly PlacedCue[], top: number, height: number, style: CueStyle): void {
  const { width } = sheet;
  const shown = cues.filter(({ start, end, cue }) => scale.x(end + cue.slack) >= -200 && scale.x(start) <= width + 4);
  for (const placed of shown) drawSlack(sheet, scale.x(placed.end), Math.min(scale.x(placed.end + placed.cue.slack), width + 4), top, height);
  let before = -Infinity;
  shown.forEach((placed, i) => {
    const begin = scale.x(placed.start);
    const next = i + 1 < shown.length ? scale.x(shown[i + 1].start) : width;
    const dense = scale.x(placed.end) - begin < PIN && Math.min(begin - before, next - begin) < ROOM_OF_PIN;
    before = begin;
    if (dense && placed.index !== style.selected) drawTick(sheet, placed, begin, top, height);
    else drawCue(sheet, scale, placed, next, top, height, style);
  });
}

/** Cues without room for a pin show how densely they follow each other. */
function drawTick({ context, palette }: Sheet, { cue }: PlacedCue, x: number, top: number, height: number): void {
  context.fillStyle = `hsl(${hueOfCue(cue.name)} ${palette.cueTone})`;
  context.fillRect(x, top + 3, 2, height - 6);
}

function drawCue(sheet: Sheet, scale: Scale, placed: PlacedCue, next: number, top: number, height: number, style: CueStyle): void {
  const { context, palette, width } = sheet;
  const ghost = style.ghost(placed);
  if (ghost !== null) drawGhost(sheet, scale.x(ghost.start), scale.x(ghost.end), top, height);
  const begin = scale.x(placed.start);
  const left = Math.max(begin, -4);
  const right = Math.min(scale.x(placed.end), width + 4);
  const critical = placed.cue.critical;
  const leftOut = style.leftOut?.(placed) ?? false;
  const unplayed = leftOut || scale.x(placed.playedUntil) <= begin;
  const mark = leftOut ? "⊘ left out: " : unplayed ? "⊘ not played: " : "";
  if (right - begin < PIN) {
    drawPin(sheet, placed, begin, top, height, unplayed);
  } else {
    const played = unplayed ? left : Math.max(left, Math.min(right, scale.x(placed.playedUntil)));
    context.strokeStyle = palette.control;
    if (played < right) drawUnplayed(sheet, left, played, right, top, height);
    if (played > left) {
      context.fillStyle = `hsl(${hueOfCue(placed.cue.name)} ${palette.cueTone})`;
      context.beginPath();
      context.roundRect(left + 0.5, top + 1.5, Math.max(2, played - left - 1), height - 3, 3);
      context.fill();
      context.stroke();
    }
    if (critical) {
      context.fillStyle = palette.critical;
      context.fillRect(left, top + 1, 3, height - 2);
    }
  }
  if (placed.index === style.selected) outline(sheet, left, right, top, height);
  drawLabel(sheet, placed, { left, right, next, top, height }, style.findings.get(placed.index), mark);
}

/** The start of a cue that has no duration, or is too short to be a bar. */
function drawPin({ context, palette }: Sheet, { cue }: PlacedCue, x: number, top: number, height: number, unplayed: boolean): void {
  const middle = top + height / 2;
  const size = Math.min(5, height / 2 - 1);
  context.fillStyle = unplayed ? palette.ground : `hsl(${hueOfCue(cue.name)} ${palette.cueTone})`;
  context.strokeStyle = cue.critical ? palette.critical : palette.text;
  context.beginPath();
  context.moveTo(x, middle - size);
  context.lineTo(x + size, middle);
  context.lineTo(x, middle + size);
  context.lineTo(x - size, middle);
  context.closePath();
  context.fill();
  context.stroke();
}

/** An empty bar. It is distinguished by its dashes, not by a colour. */
function drawGhost({ context, palette, width }: Sheet, from: number, to: number, top: number, height: number): void {
  if (to < -4 || from > width + 4) return;
  const left = Math.max(from, -4);
  context.strokeStyle = palette.dim;
  context.setLineDash([6, 3]);
  context.beginPath();
  context.roundRect(left + 0.5, top + 1.5, Math.max(2, Math.min(to, width + 4) - left - 1), height - 3, 3);
  context.stroke();
  context.setLineDash([]);
}

/** Draws the bar as an empty one, with slanted lines in the part that was not played. */
function drawUnplayed({ context, palette }: Sheet, left: number, from: number, right: number, top: number, height: number): void {
  hatch(context, palette.slack, from, top + 3, right - from, height - 6);
  context.setLineDash([3, 3]);
  context.beginPath();
  context.roundRect(left + 0.5, top + 1.5, Math.max(2, right - left - 1), height - 3, 3);
  context.stroke();
  context.setLineDash([]);
}

function drawSlack({ context, palette }: Sheet, from: number, to: number, top: number, height: number): void {
  if (to - from < 1) return;
  const inset = Math.min(5, height / 4);
  context.fillStyle = palette.slack;
  context.fillRect(from, top + inset, to - from, height - 2 * inset);
  context.fillStyle = palette.dim;
  context.fillRect(to - 1, top + inset, 1, height - 2 * inset);
}

function outline({ context, palette }: Sheet, left: number, right: number, top: number, height: number): void {
  context.strokeStyle = palette.accent;
  context.lineWidth = 2.5;
  context.strokeRect(left - 1.5, top, Math.max(4, right - left) + 3, height);
  context.lineWidth = 1;
}

interface Room {
  left: number;
  right: number;
  /** Where the next cue of the row begins. */
  next: number;
  top: number;
  height: number;
}

/** The name in the bar or, if that is too narrow and there is room, next to it. */
function drawLabel(sheet: Sheet, placed: PlacedCue, room: Room, findings: CueFindings | undefined, mark: string): void {
  const { context, palette } = sheet;
  if (room.height < 11) return;
  context.font = FONT;
  context.textBaseline = "middle";
  const y = room.top + room.height / 2;
  const sign = findings === undefined ? 0 : 14;
  const critical = placed.cue.critical ? "◆ " : "";
  const codes = findings === undefined ? "" : `  ${findings.codes}`;
  const name = `${mark}${critical}${placed.cue.name}`;
  const inside = Math.max(room.left, 0) + 7;
  const fits = widthOf(context, visible(name)) + sign <= room.right - inside - 3;
  const beside = room.right + 8 + widthOf(context, visible(name)) + sign <= room.next;
  const x = fits || !beside ? inside : Math.max(room.right, room.left + PIN) + 5;
  const width = (fits || !beside ? room.right - 3 : room.next) - x;
  if (width < sign) return;
  if (findings !== undefined) warning(context, x + 4, y, findings.severity === "error" ? palette.bad : palette.warn);
  context.fillStyle = fits || !beside ? palette.cueText : palette.text;
  fitText(context, `${name}${codes}`, x + sign, y + 0.5, width - sign);
}

function warning(context: CanvasRenderingContext2D, x: number, y: number, colour: string): void {
  context.fillStyle = colour;
  context.beginPath();
  context.moveTo(x, y - 6);
  context.lineTo(x + 6, y + 5);
  context.lineTo(x - 6, y + 5);
  context.fill();
}
