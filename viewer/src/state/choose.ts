// Choosing rows: the focused row, lanes whose curves are drawn, and folding.
import type { Track } from "../data/track";
import { foldOfGroup, groupsOfRows, type Row } from "./rows";
import type { Session } from "./session";

/** With more curves, each would be too low to read. */
const MOST_CURVES = 8;

export function focusRow(session: Session, index: number): void {
  session.focusedRow.value = index;
}

export function moveFocus(session: Session, by: 1 | -1): void {
  const rows = session.rows.value;
  let next = session.focusedRow.value + by;
  while (rows[next]?.kind === "cues") next += by;
  if (rows[next] === undefined) return;
  session.focusedRow.value = next;
  const treeHasFocus = document.activeElement?.getAttribute("role") === "treeitem";
  if (treeHasFocus) requestAnimationFrame(() => document.getElementById(`row-${next}`)?.focus());
}

/** Selects a robot on the stage and its row; `null` selects none. */
export function selectRobot(session: Session, robot: number | null): void {
  session.robot.value = robot;
  const row = session.rows.value.findIndex((candidate) => candidate.kind === "robot" && candidate.robot === robot);
  if (row >= 0) session.focusedRow.value = row;
}

export function choose(session: Session, track: Track): void {
  const chosen = session.chosen.value;
  session.chosen.value = chosen.includes(track)
    ? chosen.filter((other) => other !== track)
    : [...chosen.slice(chosen.length >= MOST_CURVES ? 1 : 0), track];
}

/** Folds or unfolds the row of a robot or a group. */
export function fold(session: Session, row: Row & { kind: "robot" | "group" }): void {
  const folded = new Set(session.folded.value);
  const key = row.kind === "robot" ? row.robot : foldOfGroup(row.group);
  if (!folded.delete(key)) folded.add(key);
  session.folded.value = folded;
}

/** Folds everything; if everything is folded, unfolds the groups; if only the robots are folded, unfolds them. */
export function foldAll(session: Session): void {
  const robots = session.show.mission.robots.map((_, index) => index);
  const groups = [...new Set(groupsOfRows(session.show).values())].map(foldOfGroup);
  const folded = session.folded.value;
  const all = [...robots, ...groups].every((key) => folded.has(key));
  const onlyRobots = robots.every((key) => folded.has(key)) && !groups.some((key) => folded.has(key));
  session.folded.value = new Set(all && groups.length > 0 ? robots : all || onlyRobots ? [] : [...robots, ...groups]);
}
