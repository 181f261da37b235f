// The stage at the playhead.
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import type { Session } from "../state/session";
import { colourOf, drawBody, drawLabels } from "./bodies";
import { fromAbove, inSpace, type Camera, type Projection } from "./camera";
import { closestPair, type Pair } from "./closest";
import { drawFloor } from "./floor";
import { middleAt, poses, type Pose } from "./pose";

/** Duration of a trail, in milliseconds, its largest number of parts, and the largest number of points of all trails together. */
const TRAIL_MS = 3000;
const TRAIL_PARTS = 40;
const TRAIL_POINTS = 4000;

export function drawStage(sheet: Sheet, session: Session, camera: Camera): void {
  const { width, height } = sheet;
  const in3d = session.stageIn3d.value;
  const project = (in3d ? inSpace : fromAbove)(camera, width, height);
  const at = session.playhead.value;
  const found = poses(session.show, at);
  const closest = closestPair(found);
  const style = { dark: session.theme.value === "dark", strong: new Set(closest?.robots ?? []) };
  drawFloor(sheet, camera, project, in3d);
  const parts = Math.max(6, Math.min(TRAIL_PARTS, Math.floor(TRAIL_POINTS / found.length)));
  if (session.trails.value) for (const pose of found) drawTrail(sheet, session.show, pose, at, parts, project, style.dark);
  if (in3d) drawPlumbs(sheet, found, project);
  if (closest !== null) drawClosest(sheet, closest, found, project);
  const depth = (pose: Pose) => project(pose.frame.origin)?.depth ?? 0;
  const ordered = [...found].sort((a, b) => depth(b) - depth(a));
  for (const pose of ordered) drawBody(sheet, pose, project, style);
  if (session.labels.value) drawLabels(sheet, session.show, found, project);
}

function drawTrail(
  { context }: Sheet,
  show: Show,
  { robot, body }: Pose,
  at: number,
  parts: number,
  project: Projection,
  dark: boolean,
): void {
  if ([body.x, body.y, body.z].every(({ device }) => device === null)) return;
  context.strokeStyle = colourOf(robot, dark);
  context.globalAlpha = 0.5;
  context.beginPath();
  for (let i = 0; i <= parts; i++) {
    const spot = project(middleAt(show, robot, body, at - (TRAIL_MS * i) / parts));
    if (spot === null) continue;
    if (i === 0) context.moveTo(spot.x, spot.y);
    else context.lineTo(spot.x, spot.y);
  }
  context.stroke();
  context.globalAlpha = 1;
}

/** Draws vertical lines that show where a body is above the ground. */
function drawPlumbs({ context, palette }: Sheet, found: readonly Pose[], project: Projection): void {
  context.strokeStyle = palette.line;
  context.beginPath();
  for (const { frame } of found) {
    const top = project(frame.origin);
    const foot = project([frame.origin[0], frame.origin[1], 0]);
    if (top === null || foot === null) continue;
    context.moveTo(top.x, top.y);
    context.lineTo(foot.x, foot.y);
    context.moveTo(foot.x + 3, foot.y);
    context.arc(foot.x, foot.y, 3, 0, 2 * Math.PI);
  }
  context.stroke();
}

function drawClosest({ context, palette }: Sheet, { robots }: Pair, found: readonly Pose[], project: Projection): void {
  const [from, to] = robots
    .map((robot) => found.find((pose) => pose.robot === robot))
    .map((pose) => (pose === undefined ? null : project(pose.frame.origin)));
  if (from === null || to === null) return;
  context.strokeStyle = palette.warn;
  context.setLineDash([5, 3]);
  context.beginPath();
  context.moveTo(from.x, from.y);
  context.lineTo(to.x, to.y);
  context.stroke();
  context.setLineDash([]);
}
