// Cues as bars: the name, the slack as a lighter extension, and a heavy edge with a mark if there is no slack. A cue that was not played
// is an empty bar with a dashed outline.
import { FONT } from "../canvas/palette";
import { hatch } from "../canvas/hatch";
import { fitText } from "../canvas/text";
import type { Sheet } from "../canvas/useCanvas";
import type { PlacedCue } from "../data/show";
import type { Scale } from "./scale";

export interface CueStyle {
  selected: number | null;
  findings: ReadonlyMap<number, string>;
  /** Position of the cue in the plan to which this one is compared. */
  ghost: (placed: PlacedCue) => { start: number; end: number } | null;
  /** Whether the robot of the bar's row was left out. */
  leftOut?: (placed: PlacedCue) => boolean;
}

export function drawCue(sheet: Sheet, scale: Scale, placed: PlacedCue, top: number, height: number, style: CueStyle): void {
  const { context, palette, width } = sheet;
  const ghost = style.ghost(placed);
  if (ghost !== null) drawGhost(sheet, scale.x(ghost.start), scale.x(ghost.end), top, height);
  const left = Math.max(scale.x(placed.start), -4);
  const right = Math.min(scale.x(placed.end), width + 4);
  const slackEnd = Math.min(scale.x(placed.end + placed.cue.slack), width + 4);
  if (slackEnd < -3 || left > width) return;
  const critical = placed.cue.critical;
  const leftOut = style.leftOut?.(placed) ?? false;
  const played = leftOut ? left : Math.max(left, Math.min(right, scale.x(placed.playedUntil)));
  drawSlack(sheet, right, slackEnd, top, height);
  context.strokeStyle = critical ? palette.critical : palette.accent;
  if (played < right) drawUnplayed(sheet, left, played, right, top, height);
  if (played > left) {
    context.fillStyle = palette.cue;
    context.beginPath();
    context.roundRect(left + 0.5, top + 2.5, Math.max(2, played - left - 1), height - 5, 3);
    context.fill();
    context.stroke();
  }
  if (critical) {
    context.fillStyle = palette.critical;
    context.fillRect(left, top + 2, Math.min(3, right - left), height - 4);
  }
  if (placed.index === style.selected) outline(sheet, left, right, top, height);
  drawLabel(sheet, placed, left, right, top + height / 2, style.findings.get(placed.index), markOf(leftOut, played <= left && scale.x(placed.playedUntil) <= left));
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

/** Text before the name, so that the state does not depend on colours and lines. */
function markOf(leftOut: boolean, unplayed: boolean): string {
  return leftOut ? "⊘ left out: " : unplayed ? "⊘ not played: " : "";
}

/** Draws the bar as an empty one, with slanted lines in the part that was not played. */
function drawUnplayed({ context, palette }: Sheet, left: number, from: number, right: number, top: number, height: number): void {
  hatch(context, palette.slack, from, top + 3, right - from, height - 6);
  context.setLineDash([3, 3]);
  context.beginPath();
  context.roundRect(left + 0.5, top + 2.5, Math.max(2, right - left - 1), height - 5, 3);
  context.stroke();
  context.setLineDash([]);
}

function drawSlack({ context, palette }: Sheet, from: number, to: number, top: number, height: number): void {
  if (to - from < 1) return;
  context.fillStyle = palette.slack;
  context.fillRect(from, top + 5, to - from, height - 10);
  context.fillStyle = palette.dim;
  context.fillRect(to - 1, top + 5, 1, height - 10);
}

function outline({ context, palette }: Sheet, left: number, right: number, top: number, height: number): void {
  context.strokeStyle = palette.playhead;
  context.lineWidth = 2;
  context.strokeRect(left - 1, top + 1, Math.max(4, right - left) + 2, height - 2);
  context.lineWidth = 1;
}

function drawLabel(
  { context, palette }: Sheet,
  placed: PlacedCue,
  left: number,
  right: number,
  y: number,
  codes: string | undefined,
  mark: string,
): void {
  context.font = FONT;
  context.textBaseline = "middle";
  let x = Math.max(left, 0) + 7;
  if (codes !== undefined) {
    context.fillStyle = palette.bad;
    warning(context, x + 4, y);
    x += 14;
  }
  context.fillStyle = palette.cueText;
  const critical = placed.cue.critical ? "◆ " : "";
  fitText(context, `${mark}${critical}${codes === undefined ? "" : `${codes} `}${placed.cue.name}`, x, y + 0.5, right - x - 3);
}

function warning(context: CanvasRenderingContext2D, x: number, y: number): void {
  context.beginPath();
  context.moveTo(x, y - 6);
  context.lineTo(x + 6, y + 5);
  context.lineTo(x - 6, y + 5);
  context.fill();
}
