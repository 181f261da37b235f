// How close the mission comes to its limits, over time. A click moves to the instant.
import { useEffect, useState } from "preact/hooks";
import { FONT } from "../canvas/palette";
import { useCanvas, type Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import { seekAndShow } from "../state/moves";
import { useSession } from "../state/session";
import { significant } from "../text/amount";
import { visible } from "../text/visible";
import { clock } from "../text/time";
import { Playhead } from "../timeline/Playhead";
import { scaleOf } from "../timeline/scale";
import { compute, isBeyond, worst, type Series } from "./compute";

/** Longest time for which the page computes without a pause, in ms. */
const SLICE_MS = 12;

const known = new WeakMap<Show, Series[]>();

function useMargins(show: Show): Series[] | null {
  const [series, setSeries] = useState<Series[] | null>(known.get(show) ?? null);
  useEffect(() => {
    if (series !== null) return;
    const work = compute(show);
    let timer = 0;
    const run = () => {
      const end = performance.now() + SLICE_MS;
      while (performance.now() < end) {
        const step = work.next();
        if (step.done === true) {
          known.set(show, step.value);
          setSeries(step.value);
          return;
        }
      }
      timer = window.setTimeout(run);
    };
    timer = window.setTimeout(run);
    return () => window.clearTimeout(timer);
  }, [show]);
  return series;
}

export function Margins() {
  const { show } = useSession();
  const series = useMargins(show);
  return (
    <section class="panel margins" aria-label="Margins">
      <div class="bar">
        <h2>Margins</h2>
        <small>{series === null ? "being computed" : "over the mission, each against its limit"}</small>
      </div>
      <div class="charts">
        {series?.map((one) => <Chart key={one.kind} series={one} />)}
        {series?.length === 0 && <p>No place of a robot is known.</p>}
      </div>
      <Budget />
    </section>
  );
}

/** The device that needs the largest share of the steps that it can hold. */
function Budget() {
  const { mission } = useSession().show;
  const used = mission.plans.flatMap(({ budgets }) => budgets ?? []).filter(({ budget }) => budget > 0);
  if (used.length === 0) return null;
  const most = used.reduce((a, b) => (b.steps / b.budget > a.steps / a.budget ? b : a));
  const robot = mission.robots[most.robot];
  return (
    <p class="budget" id="budget">
      Steps: {visible(robot.id)} / {visible(robot.devices[most.device].id)} has {most.steps} steps and holds {most.budget} at a time, the largest share of all devices.
    </p>
  );
}

const TOP = 16;

function Chart({ series }: { series: Series }) {
  const session = useSession();
  const { show } = session;
  const { canvas } = useCanvas([session.view], (sheet) => drawChart(sheet, session.view.value, series));
  const found = worst(series);
  const limit = series.limit === null ? "no limit" : `${series.above ? "at least" : "at most"} ${significant(series.limit)} ${series.unit}`;
  const value = series.exact?.value ?? found?.value ?? NaN;
  const bad = isBeyond(series, value);
  const robots = series.exact !== null ? [series.exact.robot] : found === null ? [] : series.robots[found.index];
  const names = robots.map((robot) => visible(show.mission.robots[robot].id)).join(" – ");
  const seek = (event: PointerEvent) => {
    if (event.buttons === 1 && canvas.current !== null)
      seekAndShow(session, scaleOf(session.view.value, canvas.current.clientWidth).ms(event.offsetX));
  };
  return (
    <div class="chart">
      <div class="chart-title">
        <b>{series.name}</b>{" "}
        {found !== null && (
          <button type="button" class={`link ${bad ? "error-text" : ""}`} onClick={() => seekAndShow(session, series.at[found.index])}>
            {bad && "✕ "}
            {significant(value)} {series.unit}, {names}
            {series.exact === null && `, ${clock(series.at[found.index])}`}
          </button>
        )}{" "}
        <small>{limit}</small>
      </div>
      <div class="fill">
        <canvas ref={canvas} role="img" aria-label={`${series.name} over time; ${limit}`} onPointerDown={seek} onPointerMove={seek} />
        <Playhead of={canvas} left={0} />
      </div>
    </div>
  );
}

function drawChart({ context, palette, width, height }: Sheet, view: { from: number; to: number }, series: Series): void {
  const scale = scaleOf(view, width);
  const { values, at, limit } = series;
  let [low, high] = [Math.min(0, limit ?? 0), limit ?? 0];
  high = Math.max(high, series.exact?.value ?? 0);
  for (const value of values) if (!Number.isNaN(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
  // Distances far above the limit would flatten the part that matters.
  if (series.above && limit !== null && limit > 0) high = Math.min(high, 8 * limit);
  const y = (value: number) => height - 3 - ((Math.min(value, high) - low) / (high - low || 1)) * (height - TOP);
  context.strokeStyle = palette.planned;
  context.lineWidth = 1.5;
  context.beginPath();
  let drawn = false;
  values.forEach((value, i) => {
    if (Number.isNaN(value)) {
      drawn = false;
      return;
    }
    if (drawn) context.lineTo(scale.x(at[i]), y(value));
    else context.moveTo(scale.x(at[i]), y(value));
    drawn = true;
  });
  context.stroke();
  context.lineWidth = 1;
  if (limit === null) return;
  context.strokeStyle = context.fillStyle = palette.bad;
  context.setLineDash([5, 3]);
  context.beginPath();
  context.moveTo(0, y(limit));
  context.lineTo(width, y(limit));
  context.stroke();
  context.setLineDash([]);
  context.font = FONT;
  context.textAlign = "right";
  context.textBaseline = "bottom";
  context.fillText(`limit ${significant(limit)} ${series.unit}`, width - 4, y(limit) - 1);
  context.textAlign = "left";
}
