// The complete picture of the timeline. Only visible rows are drawn.
import type { Sheet } from "../canvas/useCanvas";
import type { PlacedCue, Show } from "../data/show";
import type { Session } from "../state/session";
import { robotStates, type RobotState } from "../data/robots";
import { lineHeight, type Row } from "../state/rows";
import { niceTime } from "../text/time";
import { drawCues, type CueFindings, type CueStyle } from "./cues";
import { drawHead, HEAD_HEIGHT } from "./head";
import { drawLane, drawSummary } from "./lanes";
import { drawStarts } from "./starts";
import { drawRelations } from "./relations";
import { scaleOf, ticks, type Scale } from "./scale";

export function drawTimeline(sheet: Sheet, session: Session, scrolled: number): void {
  const { width, height } = sheet;
  const scale = scaleOf(session.view.value, width);
  const offset = HEAD_HEIGHT - scrolled;
  const style = { selected: session.cue.value, findings: findingsOfCues(session.show), ghost: (placed: PlacedCue) => session.show.ghostOfCue(placed) };
  const rows = session.rows.value;
  drawGrid(sheet, scale);
  rows.forEach((row, index) => {
    const top = row.top + offset;
    if (top + row.height < HEAD_HEIGHT || top > height) return;
    drawRow(sheet, scale, session, row, top, index, style);
  });
  if (session.relations.value) drawRelations(sheet, scale, session.show, rows, offset, session.cue.value);
  drawRange(sheet, scale, session);
  drawHead(sheet, scale, session.show);
}

function drawRow(sheet: Sheet, scale: Scale, session: Session, row: Row, top: number, index: number, style: CueStyle): void {
  const { context, palette, width } = sheet;
  if (index === session.focusedRow.value && row.kind !== "cues") {
    context.fillStyle = palette.sunken;
    context.fillRect(0, top, width, row.height);
  }
  if (row.kind === "cues") drawCues(sheet, scale, row.cues, top, row.height, style);
  if (row.kind === "lane") drawLane(sheet, scale, session.show, row.track, top, row.height, session.chosen.value.includes(row.track));
  if (row.kind === "group") {
    const each = lineHeight(row.lines.length);
    row.lines.forEach((cues, line) => drawCues(sheet, scale, cues, top + 2 + line * each, each, style));
    const states = robotStates(session.show);
    for (const robot of row.robots) drawState(sheet, scale, states[robot], top, 1 + each * Math.max(1, row.lines.length));
  }
  if (row.kind === "robot") {
    const leftOut = (placed: PlacedCue) => session.show.isLeftOut(row.robot, placed.act);
    const each = lineHeight(row.lines.length);
    row.lines.forEach((cues, line) => drawCues(sheet, scale, cues, top + 2 + line * each, each, { ...style, leftOut }));
    const below = 1 + each * Math.max(1, row.lines.length);
    drawState(sheet, scale, robotStates(session.show)[row.robot], top, below);
    drawStarts(sheet, scale, session.show, row.robot, top + row.height - 1);
    if (row.folded) drawSummary(sheet, scale, row.tracks, top + below, row.height - below);
  }
  context.fillStyle = palette.faint;
  context.fillRect(0, top + row.height - 1, width, 1);
}

function drawGrid({ context, palette, height }: Sheet, scale: Scale): void {
  context.fillStyle = palette.faint;
  for (const time of ticks(scale, niceTime(scale.perPixel, 80))) context.fillRect(Math.round(scale.x(time)), 0, 1, height);
  context.fillStyle = palette.line;
  context.fillRect(Math.round(scale.x(0)), 0, 1, height);
}

function drawRange({ context, palette, height }: Sheet, scale: Scale, session: Session): void {
  const range = session.range.value;
  if (range === null) return;
  const left = scale.x(range.from);
  context.fillStyle = palette.range;
  context.fillRect(left, HEAD_HEIGHT, scale.x(range.to) - left, height);
}

/** When the robot was late, as a band, and when it failed, as a cross. */
function drawState({ context, palette }: Sheet, scale: Scale, { late, failure }: RobotState, top: number, height: number): void {
  for (const { from, to } of late) {
    const left = scale.x(from);
    const width = Math.max(3, scale.x(to) - left);
    context.globalAlpha = 0.3;
    context.fillStyle = palette.warn;
    context.fillRect(left, top + 1, width, height);
    context.globalAlpha = 1;
    context.fillRect(left, top + height - 2, width, 3);
  }
  if (failure === null || failure.at === null) return;
  const x = scale.x(failure.at);
  context.fillStyle = palette.bad;
  context.fillRect(x - 1, top + 1, 2, height);
  context.font = "bold 13px sans-serif";
  context.textBaseline = "middle";
  context.fillText("✕", x + 3, top + height / 2);
}

const codes = new WeakMap<Show, ReadonlyMap<number, CueFindings>>();

/** Codes of the findings for each cue. */
function findingsOfCues(show: Show): ReadonlyMap<number, CueFindings> {
  let found = codes.get(show);
  if (found === undefined) {
    const texts = new Map<number, CueFindings>();
    show.cuesOfFinding.forEach((cues, finding) => {
      const { code, severity } = show.mission.findings[finding];
      for (const cue of cues) {
        const before = texts.get(cue);
        const worse = severity === "error" || before?.severity === "error" ? "error" : "warning";
        texts.set(cue, { codes: before === undefined ? code : `${before.codes} ${code}`, severity: worse });
      }
    });
    found = texts;
    codes.set(show, found);
  }
  return found;
}
