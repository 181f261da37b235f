// Robots in space at the playhead.
import { useEffect, useMemo } from "preact/hooks";
import { useCanvas } from "../canvas/useCanvas";
import { Tool } from "../panels/Tool";
import { Cell, useCell } from "../state/cell";
import { useSession } from "../state/session";
import { closer, type Camera } from "./camera";
import { drawStage } from "./draw";
import { StageFacts } from "./StageFacts";
import { listenToTurns } from "./turn";
import { seesAll } from "./whole";

export function Stage() {
  const session = useSession();
  const { show, stageIn3d, trails, labels, playhead } = session;
  const camera = useMemo(() => new Cell<Camera>(seesAll(show)), [show]);
  const { canvas } = useCanvas([playhead, stageIn3d, trails, labels, camera], (sheet) => drawStage(sheet, session, camera.value));
  const in3d = useCell(stageIn3d);
  const withTrails = useCell(trails);
  const withLabels = useCell(labels);
  const look = (next: Camera) => (camera.value = next);
  const reset = () => look(seesAll(show));
  useEffect(() => {
    if (canvas.current === null) return;
    return listenToTurns(canvas.current, { camera: () => camera.value, in3d: () => stageIn3d.value, look, reset });
  }, []);
  return (
    <section class="panel stage" aria-label="Stage">
      <div class="bar">
        <h2>Stage</h2>
        <span class="gap" />
        <Tool label="3D view (V)" pressed={in3d} press={() => (stageIn3d.value = !in3d)}>
          3D
        </Tool>
        <Tool label="Trails" pressed={withTrails} press={() => (trails.value = !withTrails)}>
          Trails
        </Tool>
        <Tool label="Names" pressed={withLabels} press={() => (labels.value = !withLabels)}>
          Names
        </Tool>
        <Tool label="Stage: farther" press={() => look(closer(camera.value, 0.8))}>
          −
        </Tool>
        <Tool label="Stage: closer" press={() => look(closer(camera.value, 1.25))}>
          +
        </Tool>
        <Tool label="Stage: fit" press={reset}>
          Fit
        </Tool>
      </div>
      <div class="fill">
        <canvas
          ref={canvas}
          tabIndex={0}
          role="application"
          aria-roledescription="stage"
          aria-label="Robots in space at the playhead. Arrows turn or move the view, plus and minus zoom, F fits. Below are the closest robots as text."
        />
      </div>
      <StageFacts />
    </section>
  );
}
