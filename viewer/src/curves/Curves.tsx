// Curves of the chosen lanes, with the values that robots set and sensors read.
import { useEffect, useState } from "preact/hooks";
import { useCanvas } from "../canvas/useCanvas";
import { Tool } from "../panels/Tool";
import { useCell } from "../state/cell";
import { pan, seek, zoom } from "../state/moves";
import { useSession, type Session } from "../state/session";
import { Playhead } from "../timeline/Playhead";
import { scaleOf } from "../timeline/scale";
import { Tip, type TipContent } from "../timeline/Tip";
import { laneTip } from "../timeline/tipOf";
import { drawCurves, MARGIN, slots } from "./draw";

export function Curves() {
  const session = useSession();
  const chosen = useCell(session.chosen);
  const [tip, setTip] = useState<TipContent | null>(null);
  const { canvas } = useCanvas([session.view, session.chosen], (sheet) => drawCurves(sheet, session));
  const msAt = (element: HTMLElement, x: number) =>
    scaleOf(session.view.value, element.clientWidth - MARGIN.left).ms(x - MARGIN.left);
  useEffect(() => {
    const element = canvas.current;
    if (element === null) return;
    const wheel = (event: WheelEvent) => {
      event.preventDefault();
      const width = session.view.value.to - session.view.value.from;
      if (event.shiftKey) pan(session, ((event.deltaY || event.deltaX) / element.clientWidth) * width);
      else zoom(session, Math.exp(-event.deltaY / 300), msAt(element, event.offsetX));
    };
    element.addEventListener("wheel", wheel, { passive: false });
    return () => element.removeEventListener("wheel", wheel);
  }, []);
  const scrub = (event: PointerEvent) => {
    const element = canvas.current;
    if (element === null) return;
    setTip(tipAt(session, element, event, msAt(element, event.offsetX)));
    if (event.buttons === 1) seek(session, msAt(element, event.offsetX));
  };
  return (
    <section class="panel curves" aria-label="Curves">
      <div class="bar">
        <h2>Curves</h2>
        <span class="legend">
          <span class="planned">planned, with its error</span>
          <span class="unplayed">not played</span>
          <span class="set">set</span>
          <span class="read">read</span>
          {session.show.mission.compared && <span class="ghost">in the other plan</span>}
        </span>
        <span class="gap" />
        <Tool label="Clear all curves" disabled={chosen.length === 0} press={() => (session.chosen.value = [])}>
          Clear
        </Tool>
      </div>
      <div class="fill">
        <canvas
          ref={canvas}
          tabIndex={0}
          role="application"
          aria-roledescription="curves"
          aria-label={`Curves of ${chosen.length} lanes. The panel Values tells their values at the playhead, the panel Deviations where they differ from the plan.`}
          onPointerDown={scrub}
          onPointerMove={scrub}
          onPointerLeave={() => setTip(null)}
        />
        {chosen.length === 0 && <p class="empty">Choose lanes in the timeline (click, or Enter) to see their curves.</p>}
        <Playhead of={canvas} left={MARGIN.left} />
        <Tip content={tip} />
      </div>
    </section>
  );
}

function tipAt(session: Session, element: HTMLElement, event: PointerEvent, ms: number): TipContent | null {
  const tracks = session.chosen.value;
  const index = slots(tracks.length, element.clientHeight).findIndex(
    ({ top, height }) => event.offsetY >= top && event.offsetY < top + height,
  );
  if (index < 0 || event.offsetX < MARGIN.left) return null;
  return { x: event.offsetX, y: event.offsetY, ...laneTip(session.show, tracks[index], ms) };
}
