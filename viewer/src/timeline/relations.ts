// Relations between cues, as arrows from the awaited cue to the start of the waiting cue.
import type { Sheet } from "../canvas/useCanvas";
import type { PlacedCue, Show } from "../data/show";
import type { Row } from "../state/rows";
import type { Scale } from "./scale";

/** "with x" and "start of x" refer to the start of x, everything else to its end. */
function fromStart(text: string): boolean {
  return /\bstart of\b/.test(text) || (/^with\b/.test(text) && !/\bend of\b/.test(text));
}

export function drawRelations(
  sheet: Sheet,
  scale: Scale,
  show: Show,
  rows: readonly Row[],
  offset: number,
  selected: number | null,
): void {
  const middle = new Map<number, number>();
  for (const row of rows)
    if (row.kind === "cues") for (const { index } of row.cues) middle.set(index, row.top + row.height / 2 + offset);
  for (const placed of show.cues) {
    const y = middle.get(placed.index);
    if (y === undefined) continue;
    for (const relation of placed.cue.relations) {
      if (relation.cue === null) continue;
      // Cues of one act are consecutive, so the other cue has the same relative index as in the plan.
      const other = show.cues[placed.index - placed.cueIndex + relation.cue];
      const otherY = other === undefined ? undefined : middle.get(other.index);
      if (other === undefined || otherY === undefined) continue;
      const from = { x: scale.x(anchor(other, relation.text)), y: otherY };
      const to = { x: scale.x(placed.start), y };
      arrow(sheet, from, to, placed.index === selected || other.index === selected);
    }
  }
}

function anchor(other: PlacedCue, text: string): number {
  return fromStart(text) ? other.start : other.end;
}

function arrow(
  { context, palette, width }: Sheet,
  from: { x: number; y: number },
  to: { x: number; y: number },
  strong: boolean,
): void {
  if (Math.max(from.x, to.x) < 0 || Math.min(from.x, to.x) > width) return;
  context.strokeStyle = context.fillStyle = strong ? palette.playhead : palette.dim;
  context.lineWidth = strong ? 2 : 1;
  const bend = Math.max(12, Math.min(60, Math.abs(to.x - from.x) / 2));
  context.beginPath();
  context.moveTo(from.x, from.y);
  if (Math.abs(from.y - to.y) < 1) context.lineTo(to.x - 5, to.y);
  else context.bezierCurveTo(from.x + bend, from.y, to.x - bend, to.y, to.x - 5, to.y);
  context.stroke();
  context.beginPath();
  context.moveTo(to.x, to.y);
  context.lineTo(to.x - 6, to.y - 4);
  context.lineTo(to.x - 6, to.y + 4);
  context.fill();
  context.lineWidth = 1;
}
