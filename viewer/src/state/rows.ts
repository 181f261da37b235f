// The rows of the timeline, from top to bottom, after filters and folding.
import type { PlacedCue, Show } from "../data/show";
import { rowsOfCues } from "../timeline/packed";
import type { Track } from "../data/track";

export type Row = { top: number; height: number } & (
  | { kind: "cues"; cues: PlacedCue[] }
  | { kind: "group"; group: number; folded: boolean; robots: readonly number[]; lines: PlacedCue[][] }
  | { kind: "robot"; robot: number; folded: boolean; tracks: readonly Track[]; lines: PlacedCue[][] }
  | { kind: "lane"; track: Track }
);

export interface Filter {
  text: string;
  robot: number | null;
  group: number | null;
  cue: number | null;
}

export const NO_FILTER: Filter = { text: "", robot: null, group: null, cue: null };

const HEIGHT = { cues: 26, robot: 28, folded: 44, lane: 36 };
/** Height of one line of cues in the row of a robot, and of each of several lines. */
export const LINE = { only: 22, several: 15 };
/** More lines of a robot share the last one. */
const LINES = 4;

export const lineHeight = (lines: number) => (lines > 1 ? LINE.several : LINE.only);

/** Height of all lines of cues of a robot. */
const linesHeight = (lines: number) => lineHeight(lines) * Math.max(1, lines);

function linesOf(cues: PlacedCue[]): PlacedCue[][] {
  const lines = rowsOfCues(cues, false);
  return lines.length <= LINES ? lines : [...lines.slice(0, LINES - 1), lines.slice(LINES - 1).flat().sort((a, b) => a.start - b.start)];
}

/** With fewer robots, each has its own row at once. */
const GROUPED = 12;

/** How the set of folded rows names a group: robots are named by their numbers. */
export const foldOfGroup = (group: number) => -1 - group;

/** The group whose row contains each robot: the smallest of its groups. Empty if all robots have their own rows. */
export function groupsOfRows({ mission }: Show): ReadonlyMap<number, number> {
  const found = new Map<number, number>();
  if (mission.robots.length <= GROUPED) return found;
  const order = mission.groups.map((_, index) => index).sort((a, b) => mission.groups[a].robots.length - mission.groups[b].robots.length);
  for (const group of order) for (const robot of mission.groups[group].robots) if (!found.has(robot)) found.set(robot, group);
  return found;
}

export function rowsOf(show: Show, filter: Filter, folded: ReadonlySet<number>): Row[] {
  const rows: Row[] = [];
  let top = 0;
  const add = (row: Row) => {
    row.top = top;
    rows.push(row);
    top += row.height;
  };
  const passing = shownCues(show, filter);
  const passes = new Set(passing);
  for (const cues of rowsOfCues(passing)) add({ kind: "cues", cues, top, height: HEIGHT.cues });
  const cuesOf = show.mission.robots.map((): PlacedCue[] => []);
  for (const placed of show.cues) for (const robot of placed.cue.robots) cuesOf[robot]?.push(placed);
  const addGroup = (group: number, robots: number[]) => {
    const cues = passing.filter(({ cue }) => cue.robots.some((robot) => robots.includes(robot)));
    const lines = linesOf(cues);
    add({ kind: "group", group, folded: folded.has(foldOfGroup(group)) && filter.text === "", robots, lines, top, height: HEIGHT.robot - LINE.only + linesHeight(lines.length) });
  };
  const groupOf = groupsOfRows(show);
  const shown = shownRobots(show, filter);
  // Robots of a group are below its row, in the order of the fleet.
  const first = new Map<number, number>();
  shown.forEach(({ robot }, i) => {
    const group = groupOf.get(robot);
    if (group !== undefined && !first.has(group)) first.set(group, i);
  });
  const place = (robot: number, i: number) => first.get(groupOf.get(robot) ?? -1) ?? i;
  const ordered = shown.map((one, i) => ({ ...one, at: place(one.robot, i) })).sort((a, b) => a.at - b.at);
  let current: number | undefined;
  for (const { robot, tracks } of ordered) {
    const group = groupOf.get(robot);
    if (group !== undefined && group !== current) addGroup(group, ordered.filter((one) => groupOf.get(one.robot) === group).map((one) => one.robot));
    current = group;
    // What was searched for is shown, even in a folded row.
    if (group !== undefined && folded.has(foldOfGroup(group)) && filter.text === "") continue;
    const closed = folded.has(robot) && !(filter.text !== "" && tracks.length < show.tracksOf[robot].length);
    const lines = linesOf(cuesOf[robot].filter((placed) => passes.has(placed)));
    add({
      kind: "robot",
      robot,
      tracks,
      folded: closed,
      lines,
      top,
      height: (closed ? HEIGHT.folded : HEIGHT.robot) - LINE.only + linesHeight(lines.length),
    });
    if (!closed) for (const track of tracks) add({ kind: "lane", track, top, height: HEIGHT.lane });
  }
  return rows;
}

/** `null` if no filter excludes a robot. */
export function filteredRobots(show: Show, filter: Filter): ReadonlySet<number> | null {
  if (filter === NO_FILTER || Object.values(filter).every((part) => part === null || part === "")) return null;
  return new Set(shownRobots(show, filter).map(({ robot }) => robot));
}

function shownCues(show: Show, filter: Filter): PlacedCue[] {
  const robots = chosenRobots(show, filter);
  const text = filter.text.toLowerCase();
  return show.cues.filter(
    ({ cue, index }) =>
      (filter.cue === null || filter.cue === index) &&
      (robots === null || cue.robots.length === 0 || cue.robots.some((robot) => robots.has(robot))) &&
      (text === "" ||
        cue.name.toLowerCase().includes(text) ||
        cue.robots.some((robot) => show.mission.robots[robot]?.id.toLowerCase().includes(text))),
  );
}

function shownRobots(show: Show, filter: Filter): { robot: number; tracks: readonly Track[] }[] {
  const robots = chosenRobots(show, filter);
  const text = filter.text.toLowerCase();
  const named = new Set(
    show.cues.filter(({ cue }) => text !== "" && cue.name.toLowerCase().includes(text)).flatMap(({ cue }) => cue.robots),
  );
  return show.mission.robots.flatMap(({ id }, robot) => {
    if (robots !== null && !robots.has(robot)) return [];
    const all = show.tracksOf[robot];
    if (text === "" || named.has(robot) || id.toLowerCase().includes(text)) return [{ robot, tracks: all }];
    const tracks = all.filter((track) => `${id}/${track.name}`.toLowerCase().includes(text));
    return tracks.length > 0 ? [{ robot, tracks }] : [];
  });
}

/** `null` means all robots. */
function chosenRobots(show: Show, filter: Filter): ReadonlySet<number> | null {
  const choices = [
    filter.robot === null ? null : [filter.robot],
    filter.group === null ? null : show.mission.groups[filter.group].robots,
    filter.cue === null ? null : show.cues[filter.cue].cue.robots,
  ].filter((choice): choice is number[] => choice !== null);
  if (choices.length === 0) return null;
  return new Set(choices.reduce((left, right) => left.filter((robot) => right.includes(robot))));
}
