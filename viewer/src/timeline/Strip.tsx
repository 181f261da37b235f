// The whole mission as a strip below the picture: acts, cues, failures, and what was not played. A click or a drag moves the playhead.
import { useRef } from "preact/hooks";
import { FONT } from "../canvas/palette";
import { hatch } from "../canvas/hatch";
import { fitText } from "../canvas/text";
import { useCanvas, type Sheet } from "../canvas/useCanvas";
import { nameOfAct, playedUntil } from "../data/fate";
import { robotStates } from "../data/robots";
import type { PlacedCue, Show } from "../data/show";
import { useCell } from "../state/cell";
import { seek, selectCue } from "../state/moves";
import { useSession } from "../state/session";
import { clock, niceTime } from "../text/time";
import { isFailure } from "./events";
import { axisLabel } from "./head";
import { colourOfCue, rowsOfCues } from "./packed";
import { Playhead } from "./Playhead";
import { scaleOf, ticks, type Scale } from "./scale";

const AXIS = 18;
const ACTS = 18;
/** Rows of cues; more cues share the last one. */
const ROWS = 3;
/** Largest height of a row, in pixels. */
const HIGHEST = 28;

export function Strip() {
  const session = useSession();
  const { show } = session;
  const drawn = useRef(show);
  const { canvas } = useCanvas([session.cue], (sheet) => drawStrip(sheet, session.whole, show, session.cue.value));
  const playhead = useCell(session.playhead);
  const scrub = (event: PointerEvent) => {
    const element = canvas.current;
    if (element === null || event.buttons !== 1) return;
    const scale = scaleOf(session.whole, element.clientWidth);
    seek(session, scale.ms(event.offsetX));
    if (event.type === "pointerdown") selectAt(event, scale);
  };
  const selectAt = (event: PointerEvent, scale: Scale) => {
    const found = cueAt(drawn.current, scale, event.offsetX, event.offsetY, canvas.current?.clientHeight ?? 0);
    if (found !== null) selectCue(session, found.index);
  };
  const { from, to } = session.show.mission;
  return (
    <section class="panel strip" aria-label="Course of the mission">
      <div class="fill">
        <canvas
          ref={canvas}
          tabIndex={0}
          role="slider"
          aria-label="Playhead"
          aria-valuemin={Math.round(from)}
          aria-valuemax={Math.round(to)}
          aria-valuenow={Math.round(playhead)}
          aria-valuetext={clock(playhead)}
          onPointerDown={(event) => {
            event.currentTarget.setPointerCapture(event.pointerId);
            scrub(event);
          }}
          onPointerMove={scrub}
        />
        <Playhead of={canvas} left={0} view={session.whole} />
      </div>
    </section>
  );
}

interface Band {
  top: number;
  height: number;
}

function bands(height: number, rows: number): Band[] {
  const top = AXIS + ACTS;
  const each = Math.max(6, Math.min(HIGHEST, (height - top - 2) / Math.max(1, rows)));
  return Array.from({ length: rows }, (_, i) => ({ top: top + i * each, height: each - 2 }));
}

const rowsOf = (show: Show) => {
  const rows = rowsOfCues(show.cues);
  return rows.length <= ROWS ? rows : [...rows.slice(0, ROWS - 1), rows.slice(ROWS - 1).flat()];
};

function drawStrip(sheet: Sheet, view: { from: number; to: number }, show: Show, selected: number | null): void {
  const { context, palette, width, height } = sheet;
  const scale = scaleOf(view, width);
  const rows = rowsOf(show);
  const step = niceTime(scale.perPixel, 70);
  context.font = FONT;
  context.textBaseline = "middle";
  for (const time of ticks(scale, step)) {
    const x = Math.round(scale.x(time));
    context.fillStyle = palette.faint;
    context.fillRect(x, AXIS, 1, height);
    context.fillStyle = palette.dim;
    if (x + 40 < width) context.fillText(axisLabel(time, step), x + 3, AXIS / 2);
  }
  for (const act of show.mission.acts) {
    const [left, right] = [scale.x(act.start), scale.x(act.end)];
    context.fillStyle = palette.sunken;
    context.fillRect(left, AXIS + 1, right - left - 1, ACTS - 3);
    const played = Math.max(left, Math.min(right, scale.x(playedUntil(act))));
    hatch(context, palette.line, played, AXIS + 1, right - played, ACTS - 3);
    context.fillStyle = palette.text;
    fitText(context, nameOfAct(act), Math.max(left, 0) + 5, AXIS + ACTS / 2, right - left - 8);
  }
  bands(height, rows.length).forEach(({ top, height: high }, i) => {
    for (const placed of rows[i]) drawBar(sheet, scale, show, placed, top, high, placed.index === selected);
  });
  drawMarks(sheet, scale, show);
}

function drawBar({ context, palette }: Sheet, scale: Scale, show: Show, placed: PlacedCue, top: number, high: number, selected: boolean): void {
  const left = scale.x(placed.start);
  const width = Math.max(3, scale.x(placed.end) - left - 1);
  const played = Math.max(0, Math.min(width, scale.x(placed.playedUntil) - left));
  context.fillStyle = colourOfCue(show, placed, palette);
  context.fillRect(left, top, played, high);
  hatch(context, palette.dim, left + played, top, width - played, high);
  if (selected) {
    context.strokeStyle = palette.text;
    context.strokeRect(left - 0.5, top - 0.5, width + 1, high + 1);
  }
  context.fillStyle = palette.text;
  if (high >= 11) fitText(context, placed.cue.name, left + 4, top + high / 2, width - 7);
}

/** Failures as crosses, late steps as a band, both along the axis. */
function drawMarks({ context, palette }: Sheet, scale: Scale, show: Show): void {
  context.fillStyle = palette.warn;
  for (const { late } of robotStates(show))
    for (const { from, to } of late) context.fillRect(scale.x(from), AXIS - 4, Math.max(4, scale.x(to) - scale.x(from)), 4);
  context.fillStyle = palette.bad;
  context.font = "bold 13px sans-serif";
  for (const event of show.mission.events) if (isFailure(event)) context.fillText("✕", scale.x(event.at) - 5, AXIS + ACTS / 2);
}

function cueAt(show: Show, scale: Scale, x: number, y: number, height: number): PlacedCue | null {
  const rows = rowsOf(show);
  const row = bands(height, rows.length).findIndex(({ top, height: high }) => y >= top && y <= top + high);
  if (row < 0) return null;
  return rows[row].find((placed) => scale.x(placed.start) - 2 <= x && x <= Math.max(scale.x(placed.end), scale.x(placed.start) + 4)) ?? null;
}
