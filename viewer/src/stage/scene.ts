// The stage at one instant as lights, solids and lines, in metres. Both renderers draw the same scene.
import { lightsAt, litRobots, type Colour } from "../data/lamps";
import type { Show } from "../data/show";
import type { Bounds, Volume } from "../mission";
import { niceStep } from "../text/time";
import { robotStates } from "../data/robots";
import { colourOf } from "./colours";
import type { Camera } from "./camera";
import { middleAt, poses, type Pose } from "./pose";
import { place, type Frame, type Point } from "./space";

export interface Glow {
  at: Point;
  colour: Colour;
  /** Of the body around the light, in metres. */
  radius: number;
  robot: number;
}

export type Solid = { colour: Colour; hollow: boolean; robot: number } & (
  | { kind: "ball"; at: Point; radius: number }
  | { kind: "box"; frame: Frame; size: Point }
  | { kind: "capsule"; from: Point; to: Point; radius: number }
);

export interface Beam {
  from: Point;
  to: Point;
  /** At the end, in metres. */
  radius: number;
  colour: Colour;
}

/** Consecutive points of a line; `null` separates lines. */
export interface Lines {
  points: (Point | null)[];
  colour: Colour;
  alpha: number;
}

export interface Scene {
  poses: readonly Pose[];
  glows: Glow[];
  solids: Solid[];
  beams: Beam[];
  lines: Lines[];
}

export interface SceneOptions {
  trails: boolean;
  /** The part of the floor in view is drawn. */
  camera: Camera;
  selected: number | null;
}

/** Duration of a trail, in milliseconds, its largest number of parts, and the largest number of points of all trails together. */
const TRAIL_MS = 3000;
const TRAIL_PARTS = 40;
const TRAIL_POINTS = 4000;
/** The trails of more bodies would hide them. */
const TRAILED = 200;

const DARK: Colour = [0.13, 0.14, 0.17];
const GRID: Colour = [0.55, 0.62, 0.75];
const BOUNDS: Colour = [0.45, 0.62, 0.85];
const KEEP_OUT: Colour = [0.95, 0.4, 0.35];

export function sceneAt(show: Show, ms: number, options: SceneOptions): Scene {
  const found = poses(show, ms).filter(({ placed }) => placed);
  const lights = new Map(lightsAt(show, ms).map((light) => [light.robot, light]));
  const lit = litRobots(show);
  const scene: Scene = { poses: found, glows: [], solids: [], beams: [], lines: floor(options.camera) };
  scene.lines.push(...space(show, options.camera));
  const parts = Math.max(6, Math.min(TRAIL_PARTS, Math.floor(TRAIL_POINTS / Math.max(1, found.length))));
  for (const pose of found) {
    const light = lights.get(pose.robot);
    const colour: Colour = lit.has(pose.robot) ? shaded(light?.colour ?? [0, 0, 0]) : colourOf(pose.robot);
    addSolids(scene, pose, colour);
    if (light !== undefined && Math.max(...light.colour) > 0) addLight(scene, pose, light.colour, light.beam);
    if (options.trails && found.length <= TRAILED) {
      const trail = trailOf(show, pose, ms, parts);
      if (trail !== null) scene.lines.push({ points: trail, colour: light === undefined ? colour : brightened(light.colour), alpha: 0.35 });
    }
  }
  return scene;
}

/** A body reflects some of its own light. */
const shaded = (light: Colour): Colour => [0, 1, 2].map((i) => DARK[i] + 0.35 * light[i]) as unknown as Colour;

/** Eyes see small shares of light as more than screens show them. */
export const brightened = (colour: Colour): Colour => colour.map((part) => part ** 0.6) as unknown as Colour;

function addSolids({ solids }: Scene, { robot, body, frame, chain, doubt }: Pose, colour: Colour): void {
  const of = { colour, hollow: doubt !== null, robot };
  if ("box" in body.shape) solids.push({ ...of, kind: "box", frame, size: body.shape.box });
  else if (body.shape.ball > 0) solids.push({ ...of, kind: "ball", at: frame.origin, radius: body.shape.ball });
  for (let i = 0; i + 1 < chain.length; i++)
    solids.push({ ...of, kind: "capsule", from: chain[i], to: chain[i + 1], radius: body.joints[i].radius });
}

/** Length of a beam in metres, and its radius there. */
const BEAM = { length: 12, radius: 0.9 };

function addLight(scene: Scene, pose: Pose, colour: Colour, beam: { pan: number; tilt: number } | null): void {
  const { body, frame, robot } = pose;
  const radius = "ball" in body.shape ? Math.max(body.shape.ball, 0.02) : Math.max(...body.shape.box) / 2;
  const above: Point = "box" in body.shape ? [0, 0, body.shape.box[2] / 2] : [0, 0, 0];
  const at = place(frame, above);
  scene.glows.push({ at, colour, radius, robot });
  if (beam === null) return;
  // At pan 0 and tilt 0, a moving head points upwards; tilt leans it towards the front.
  const [sp, cp, st, ct] = [Math.sin(beam.pan), Math.cos(beam.pan), Math.sin(beam.tilt), Math.cos(beam.tilt)];
  const to = place(frame, [BEAM.length * st * sp, -BEAM.length * st * cp, BEAM.length * ct]);
  scene.beams.push({ from: at, to, radius: BEAM.radius, colour });
}

function trailOf(show: Show, { robot, body }: Pose, ms: number, parts: number): Point[] | null {
  if ([body.x, body.y, body.z].every(({ device }) => device === null)) return null;
  return Array.from({ length: parts + 1 }, (_, i) => middleAt(show, robot, body, ms - (TRAIL_MS * i) / parts));
}

/** Cells of the grid along the view. */
const CELLS = 10;
export const cellOf = (camera: Camera) => niceStep(1, (2 * camera.reach) / CELLS);

function floor(camera: Camera): Lines[] {
  const step = cellOf(camera);
  const reach = Math.ceil((2.4 * camera.reach) / step) * step;
  const [x, y] = camera.target.map((value) => Math.round(value / step) * step);
  const points: (Point | null)[] = [];
  for (let i = -reach / step; i <= reach / step; i++) {
    points.push([x + i * step, y - reach, 0], [x + i * step, y + reach, 0], null);
    points.push([x - reach, y + i * step, 0], [x + reach, y + i * step, 0], null);
  }
  return [{ points, colour: GRID, alpha: 0.13 }];
}

/** The edges of the volumes of the fleet file. Sides without a limit end beyond the view. */
function space({ mission }: Show, camera: Camera): Lines[] {
  const { keep_in, keep_out } = mission.space ?? { keep_in: null, keep_out: [] };
  const lines: Lines[] = keep_out.map(({ volume }) => ({ points: edges(volume, camera), colour: KEEP_OUT, alpha: 0.8 }));
  if (keep_in !== null) lines.push({ points: edges(keep_in, camera), colour: BOUNDS, alpha: 0.6 });
  return lines;
}

/** Edges between two limited sides. Those of a side without a limit would be drawn in the wrong place. */
function edges({ least, most }: Volume, { target, reach }: Camera): (Point | null)[] {
  const limit = (bounds: Bounds, sign: 1 | -1, i: number) => bounds[i] ?? target[i] + sign * 2.4 * reach;
  const corner = (bits: readonly number[]): Point => [0, 1, 2].map((i) => limit(bits[i] === 0 ? least : most, bits[i] === 0 ? -1 : 1, i)) as unknown as Point;
  const limited = (i: number, bit: number) => (bit === 0 ? least : most)[i] !== null;
  const points: (Point | null)[] = [];
  for (const axis of [0, 1, 2]) {
    const [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
    for (const [bitB, bitC] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
      if (!limited(b, bitB) || !limited(c, bitC)) continue;
      const bits = [0, 0, 0];
      [bits[b], bits[c]] = [bitB, bitC];
      const from = corner(bits);
      bits[axis] = 1;
      points.push(from, corner(bits), null);
    }
  }
  return points;
}

/** Robots that failed or were late, for marks on the stage. */
export function markOf(show: Show, robot: number, ms: number): "bad" | "warn" | null {
  const state = robotStates(show)[robot];
  if (state.failure !== null && ms >= (state.failure.at ?? -Infinity)) return "bad";
  return state.late.some(({ from, to }) => ms >= from && ms <= to) ? "warn" : null;
}
