// The timeline: row names on the left, and a canvas that follows their scrolling.
import { useEffect, useRef, useState } from "preact/hooks";
import { useCanvas } from "../canvas/useCanvas";
import { useCell } from "../state/cell";
import { seek, selectCue, show, showRange } from "../state/moves";
import { useSession, type Session } from "../state/session";
import { drawTimeline } from "./draw";
import { hit, type Hit } from "./hit";
import { listen } from "./pointer";
import { Playhead } from "./Playhead";
import { Tip, type TipContent } from "./Tip";
import { tipOf } from "./tipOf";
import { Tree } from "./Tree";
import { Toolbar } from "./Toolbar";

export function Timeline() {
  const session = useSession();
  const scroller = useRef<HTMLDivElement>(null);
  const [tip, setTip] = useState<TipContent | null>(null);
  const { canvas, invalidate } = useCanvas(
    [session.view, session.rows, session.range, session.cue, session.relations, session.focusedRow, session.chosen],
    (sheet) => drawTimeline(sheet, session, scroller.current?.scrollTop ?? 0),
  );
  useEffect(() => {
    const element = canvas.current;
    if (element === null) return;
    const find = (x: number, y: number) => hit(session, element.clientWidth, x, y, scroller.current?.scrollTop ?? 0);
    return listen({
      canvas: element,
      session,
      scroller: () => scroller.current,
      click: (x, y) => clicked(session, find(x, y)),
      hover: (x, y) => setTip(tipOf(session, find(x, y), x + element.offsetLeft, y)),
      leave: () => setTip(null),
    });
  }, []);
  const zoomToCue = (event: MouseEvent) => {
    const found = hit(session, canvas.current?.clientWidth ?? 1, event.offsetX, event.offsetY, scroller.current?.scrollTop ?? 0);
    if (found.kind === "cue") showRange(session, { from: found.placed.start, to: found.placed.end });
  };
  return (
    <section class="panel timeline" aria-label="Timeline">
      <Toolbar />
      <div class="timeline-body">
        <Tree scroller={scroller} scrolled={invalidate} />
        <canvas
          ref={canvas}
          class="timeline-canvas"
          tabIndex={0}
          role="application"
          aria-roledescription="timeline"
          aria-label="Timeline of acts, cues and devices. Left and right seek, plus and minus zoom. The panel Values tells the same as text."
          onDblClick={zoomToCue}
          onKeyDown={(event) => scrollRows(event, scroller.current)}
        />
        <Playhead of={canvas} left={0} />
        <Tip content={tip} />
      </div>
      <Overview />
    </section>
  );
}

function clicked(session: Session, found: Hit): void {
  if (found.kind === "cue") selectCue(session, found.placed.index);
  else if (found.kind === "phase") seek(session, found.phase.at);
  else if (found.kind === "event") seek(session, found.event.at);
  else seek(session, found.ms);
  if (found.kind === "row") session.focusedRow.value = found.index;
}

function scrollRows(event: KeyboardEvent, scroller: HTMLElement | null): void {
  const ways: Record<string, number> = { PageUp: -0.8, PageDown: 0.8 };
  const way = ways[event.key];
  if (way === undefined || scroller === null) return;
  event.preventDefault();
  scroller.scrollTop += way * scroller.clientHeight;
}

/** Slider that shows and moves the visible part of the mission, for touch and mouse. */
function Overview() {
  const session = useSession();
  const view = useCell(session.view);
  const { from, to } = session.whole;
  const share = (view.to - view.from) / (to - from);
  return (
    <label class="overview">
      <span class="hidden">Part of the mission in view</span>
      <input
        type="range"
        min={0}
        max={1000}
        step={1}
        disabled={share >= 1}
        value={share >= 1 ? 0 : Math.round((1000 * (view.from - from)) / (to - from - (view.to - view.from)))}
        aria-valuetext={`${Math.round(share * 100)} % of the mission in view`}
        onInput={(event) => {
          const start = from + (Number(event.currentTarget.value) / 1000) * (to - from) * (1 - share);
          show(session, { from: start, to: start + (view.to - view.from) });
        }}
      />
    </label>
  );
}
