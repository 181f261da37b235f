// The item that is drawn at a point of the timeline.
import type { PlacedCue } from "../data/show";
import type { MissionEvent } from "../mission";
import { lineHeight, type Row } from "../state/rows";
import type { Session } from "../state/session";
import { PIN } from "./cues";
import { BAND_TOP, HEAD_HEIGHT } from "./head";
import { phasesOf, type Phase } from "./phases";
import { scaleOf, type Scale } from "./scale";

export type Hit =
  | { kind: "cue"; placed: PlacedCue; row: Row; ms: number }
  | { kind: "act"; act: number; ms: number }
  | { kind: "row"; row: Row; index: number; ms: number }
  | { kind: "phase"; phase: Phase; ms: number }
  | { kind: "event"; event: MissionEvent; ms: number }
  | { kind: "nothing"; ms: number };

/** Largest distance from a mark that still hits it, in pixels. */
const NEAR = 8;

export function hit(session: Session, width: number, x: number, y: number, scrolled: number): Hit {
  const scale = scaleOf(session.view.value, width);
  const ms = scale.ms(x);
  if (y < HEAD_HEIGHT) return hitHead(session, scale, x, y);
  const at = y - HEAD_HEIGHT + scrolled;
  const index = session.rows.value.findIndex((row) => row.top <= at && at < row.top + row.height);
  const row = session.rows.value[index];
  if (row === undefined) return { kind: "nothing", ms };
  const placed = row.kind === "lane" ? null : cueIn(row, scale, x, at - row.top);
  return placed === null ? { kind: "row", row, index, ms } : { kind: "cue", placed, row, ms };
}

function cueIn(row: Exclude<Row, { kind: "lane" }>, scale: Scale, x: number, y: number): PlacedCue | null {
  const each = row.kind === "cues" ? row.height : lineHeight(row.lines.length);
  const cues = row.kind === "cues" ? row.cues : (row.lines[Math.floor((y - 2) / each)] ?? []);
  const under = cues.filter(
    (placed) =>
      scale.x(placed.start) - PIN <= x && x <= Math.max(scale.x(placed.start) + 4, scale.x(placed.end + placed.cue.slack)) + 1,
  );
  return under.length === 0 ? null : under.reduce((a, b) => (b.start >= a.start ? b : a));
}

function hitHead(session: Session, scale: Scale, x: number, y: number): Hit {
  const ms = scale.ms(x);
  const distance = (mark: { at: number }) => Math.abs(scale.x(mark.at) - x);
  const nearest = <M extends { at: number }>(marks: readonly M[]) =>
    marks.filter((mark) => distance(mark) <= NEAR).sort((a, b) => distance(a) - distance(b))[0];
  if (y >= BAND_TOP.events) {
    const event = nearest(session.show.mission.events);
    if (event !== undefined) return { kind: "event", event, ms };
  } else if (y >= BAND_TOP.phases) {
    const phase = nearest(phasesOf(session.show));
    if (phase !== undefined) return { kind: "phase", phase, ms };
  } else if (y >= BAND_TOP.acts) {
    const { acts } = session.show.mission;
    const act = acts.findIndex(({ start, end }) => start <= ms && ms <= end);
    if (act >= 0) return { kind: "act", act, ms };
  }
  return { kind: "nothing", ms };
}
