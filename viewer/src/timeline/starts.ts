// When a robot actually started and ended each act: a triangle and a square at the bottom of its row.
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import type { Scale } from "./scale";

const SIZE = 5;

export function drawStarts({ context, palette, width }: Sheet, scale: Scale, show: Show, robot: number, foot: number): void {
  context.fillStyle = palette.good;
  for (const act of show.mission.acts) {
    if (scale.x(act.end) < -SIZE || scale.x(act.start) > width + SIZE) continue;
    const part = act.robots.find((candidate) => candidate.robot === robot);
    if (part?.started != null) triangle(context, scale.x(part.started), foot);
    if (part?.ended != null) context.fillRect(scale.x(part.ended) - SIZE / 2, foot - SIZE, SIZE, SIZE);
  }
}

function triangle(context: CanvasRenderingContext2D, x: number, foot: number): void {
  context.beginPath();
  context.moveTo(x, foot - SIZE - 1);
  context.lineTo(x + SIZE - 1, foot);
  context.lineTo(x - SIZE + 1, foot);
  context.fill();
}
