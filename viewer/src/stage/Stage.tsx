// Robots and their lights in space at the playhead. WebGL draws them if the browser has it; a second canvas draws names and marks.
import { useEffect, useMemo, useRef } from "preact/hooks";
import { useCanvas } from "../canvas/useCanvas";
import { litRobots } from "../data/lamps";
import { Tool } from "../panels/Tool";
import { Cell, useCell } from "../state/cell";
import { selectRobot } from "../state/choose";
import { useSession } from "../state/session";
import { closer, PRESETS, projectionOf, type Camera, type Preset } from "./camera";
import { drawFlat } from "./flat";
import { Painter } from "./gl";
import { drawOverlay, robotAt } from "./overlay";
import { poses } from "./pose";
import { sceneAt } from "./scene";
import { StageFacts } from "./StageFacts";
import { listenToTurns } from "./turn";
import { seesAll } from "./whole";

/** With more robots, names would hide the picture of a show. */
const NAMED = 12;

export function Stage({ hero = false }: { hero?: boolean }) {
  const session = useSession();
  const { show, preset, trails, labels, playhead, robot } = session;
  const painted = useRef<HTMLCanvasElement>(null);
  const painter = useRef<Painter | null>(null);
  /** `null`: the camera of the preset, which depends on the size of the canvas. */
  const moved = useMemo(() => new Cell<Camera | null>(null), [show]);
  const size = useRef({ width: 1, height: 1 });
  const camera = () => moved.value ?? seesAll(show, preset.value, size.current.width, size.current.height);
  const { canvas } = useCanvas(
    [playhead, preset, trails, labels, moved, robot, session.shownRobots],
    (sheet) => {
      const { width, height, palette } = sheet;
      size.current = { width, height };
      const ms = playhead.value;
      const view = camera();
      const project = projectionOf(view, width, height);
      const scene = sceneAt(show, ms, { trails: trails.value, camera: view, selected: robot.value });
      if (painter.current === null) drawFlat(sheet, scene, project);
      else painter.current.draw(scene, view, width, height, palette.ground);
      const names = labels.value && (!hero || scene.poses.length <= NAMED);
      const options = { camera: view, names, measures: !hero, selected: robot.value, shown: session.shownRobots.value };
      drawOverlay(sheet, show, scene.poses, ms, project, options);
    },
    { clear: () => painter.current !== null },
  );
  const withTrails = useCell(trails);
  const withLabels = useCell(labels);
  const current = useCell(preset);
  const look = (next: Camera) => (moved.value = next);
  const choose = (next: Preset) => {
    moved.value = null;
    preset.value = next;
  };
  useEffect(() => {
    if (painted.current !== null) painter.current = Painter.on(painted.current, show.mission.robots.length);
    if (canvas.current === null) return;
    const stops = [
      preset.subscribe(() => (moved.value = null)),
      listenToTurns(canvas.current, {
        camera,
        look,
        reset: () => (moved.value = null),
        click: (x, y) => {
          const { width, height } = size.current;
          selectRobot(session, robotAt(poses(show, playhead.value), projectionOf(camera(), width, height), x, y));
        },
      }),
    ];
    return () => stops.forEach((stop) => stop());
  }, []);
  const lights = litRobots(show).size;
  return (
    <section class="panel stage" aria-label="Stage" data-theme="dark">
      <div class="bar">
        {!hero && <h2>Stage</h2>}
        {!hero && <span class="gap" />}
        <span class="presets" role="group" aria-label="Views">
          {Object.entries(PRESETS).map(([key, { name }]) => (
            <Tool key={key} label={`View: ${name.toLowerCase()} (V: next)`} pressed={key === current} press={() => choose(key as Preset)}>
              {name}
            </Tool>
          ))}
        </span>
        {hero && <span class="gap" />}
        <Tool label="Trails" pressed={withTrails} press={() => (trails.value = !withTrails)}>
          Trails
        </Tool>
        <Tool label="Names" pressed={withLabels} press={() => (labels.value = !withLabels)}>
          Names
        </Tool>
        <Tool label="Stage: farther" press={() => look(closer(camera(), 0.8))}>
          −
        </Tool>
        <Tool label="Stage: closer" press={() => look(closer(camera(), 1.25))}>
          +
        </Tool>
        <Tool label="Stage: fit" press={() => (moved.value = null)}>
          Fit
        </Tool>
      </div>
      <div class="fill">
        <canvas ref={painted} class="painted" aria-hidden="true" />
        <canvas
          ref={canvas}
          tabIndex={0}
          role="application"
          aria-roledescription="stage"
          aria-label={`Robots in space at the playhead${lights > 0 ? `, ${lights} with lights` : ""}. Arrows turn or move the view, plus and minus zoom, F fits. Below are the closest robots as text.`}
        />
      </div>
      {!hero && <StageFacts />}
    </section>
  );
}
