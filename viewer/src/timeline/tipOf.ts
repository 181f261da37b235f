// The text of the tooltip.
import type { PlacedCue, Show } from "../data/show";
import { nameOfAct } from "../data/fate";
import type { Track } from "../data/track";
import type { Row } from "../state/rows";
import type { Session } from "../state/session";
import { fateText, notPlayed } from "../text/fate";
import { describeReading } from "../text/reading";
import { clock, duration, signedMs } from "../text/time";
import { describeEvent } from "./events";
import type { Hit } from "./hit";
import type { TipContent } from "./Tip";

export function tipOf(session: Session, found: Hit, x: number, y: number): TipContent | null {
  const { show } = session;
  const place = { x, y };
  if (found.kind === "cue") return { ...place, title: found.placed.cue.name, lines: cueLines(show, found.placed, found.row) };
  if (found.kind === "act") return { ...place, ...actTip(show, found.act) };
  if (found.kind === "phase")
    return { ...place, title: found.phase.name, lines: [clock(found.phase.at), show.mission.acts[found.phase.act].name] };
  if (found.kind === "event")
    return {
      ...place,
      title: found.event.kind.replaceAll("_", " "),
      lines: [clock(found.event.at), describeEvent(show, found.event)],
    };
  if (found.kind === "row" && found.row.kind === "lane") return { ...place, ...laneTip(show, found.row.track, found.ms) };
  if (found.kind === "row" && found.row.kind === "robot") return { ...place, ...robotTip(show, found.row.robot, found.ms) };
  return null;
}

function actTip(show: Show, index: number): { title: string; lines: string[] } {
  const act = show.mission.acts[index];
  const waits = show.planOf(act)?.waits ?? "";
  const lines = [
    `${clock(act.start)} to ${clock(act.end)} (${duration(act.end - act.start)})${act.fate === "withdrawn" ? ", as planned" : ""}`,
    act.fate === undefined ? "" : fateText(act),
    notPlayed(act, act.start, act.end),
    waits === "" ? "" : `waits: ${waits}`,
  ];
  return { title: nameOfAct(act), lines: lines.filter((line) => line !== "") };
}

/** How the robot followed the plan of the act at this time. */
function robotTip(show: Show, robot: number, ms: number): { title: string; lines: string[] } {
  const index = show.actAt(ms);
  const act = show.mission.acts[index];
  const part = act?.robots.find((candidate) => candidate.robot === robot);
  const lines = [clock(ms)];
  if (part?.left_out === true) lines.push(`left out of ${nameOfAct(act)}`);
  if (part !== undefined && part.started !== null)
    lines.push(`▲ started at ${clock(part.started)}, ${signedMs(part.started - show.plannedStart(robot, index))}`);
  if (part !== undefined && part.ended !== null) lines.push(`■ ended at ${clock(part.ended)}, ${signedMs(part.ended - act.end)}`);
  return { title: show.mission.robots[robot].id, lines };
}

export function laneTip(show: Show, track: Track, ms: number): { title: string; lines: string[] } {
  const cue = show.cueAt(track.robotIndex, ms);
  const lines = [describeReading(track, track.at(ms)), clock(ms)];
  if (cue !== null) lines.push(`cue ${cue.cue.name}, ${lineOf(show, cue)}`);
  return { title: `${track.robot.id} / ${track.device.id}`, lines };
}

function cueLines(show: Show, placed: PlacedCue, row: Row): string[] {
  const { cue } = placed;
  const findings = show.mission.findings.filter((_, i) => show.cuesOfFinding[i].includes(placed.index));
  const act = show.mission.acts[placed.act];
  const unplayed = notPlayed(act, placed.start, placed.end);
  const leftOut = row.kind === "robot" && show.isLeftOut(row.robot, placed.act);
  return [
    ...(leftOut ? [`⊘ the robot was left out of ${nameOfAct(act)}`] : []),
    ...(unplayed === "" ? [] : [`⊘ ${unplayed}`, `${nameOfAct(act)}: ${fateText(act)}`]),
    `${clock(placed.start)} to ${clock(placed.end)} (${duration(placed.end - placed.start)})`,
    cue.critical ? "◆ critical: it determines when the act ends" : `slack ${duration(cue.slack)}`,
    ...cue.relations.map((relation) => relation.text),
    ...findings.map((finding) => `${finding.code}: ${finding.message}`),
    lineOf(show, placed),
  ];
}

export function lineOf(show: Show, { cue }: PlacedCue): string {
  return `${show.mission.sources[cue.source]?.name ?? "source"}:${cue.first_line}`;
}
