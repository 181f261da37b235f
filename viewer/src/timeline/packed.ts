// Rows of cues that do not overlap, and the colour of each cue.
import type { Palette } from "../canvas/palette";
import type { PlacedCue, Show } from "../data/show";

/** Puts each cue in the first row in which it overlaps no other cue; by default, also not the slack of another cue. */
export function rowsOfCues(cues: readonly PlacedCue[], withSlack = true): PlacedCue[][] {
  const rows: PlacedCue[][] = [];
  const ends: number[] = [];
  for (const placed of [...cues].sort((a, b) => a.start - b.start || a.index - b.index)) {
    let row = ends.findIndex((end) => end <= placed.start);
    if (row < 0) row = rows.push([]) - 1;
    rows[row].push(placed);
    ends[row] = Math.max(placed.end + (withSlack ? placed.cue.slack : 0), placed.start + 1);
  }
  return rows;
}

/** Hues of cues, in degrees. Cues with the same name have the same one. */
const HUES = [212, 262, 172, 322, 32, 140, 192, 292, 82, 352];

export function hueOfCue(name: string): number {
  let hash = 0;
  for (const character of name) hash = (hash * 31 + (character.codePointAt(0) ?? 0)) >>> 0;
  return HUES[hash % HUES.length];
}

/** Text has enough contrast on these colours in both themes. */
export function colourOfCue(_: Show, { cue }: PlacedCue, palette: Palette): string {
  return `hsl(${hueOfCue(cue.name)} ${palette.cueTone})`;
}
