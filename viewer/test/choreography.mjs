// A mission with every feature of the page: two acts of six drones, an arm with joints and a rover driven by speed.
import { Columns, encode } from "./encode.mjs";
import { readSwap } from "./swap.mjs";

const TEMPO_MS = 4250;
const device = (id, unit, more = {}) => ({
  id,
  name: "",
  unit,
  interpolation: "linear",
  granularity: 0.001,
  min: null,
  max: null,
  default: null,
  sensor: false,
  ...more,
});
const fixed = (offset) => ({ device: null, scale: 1, offset });
const by = (index, scale = 1, offset = 0) => ({ device: index, scale, offset });

const DRONE_DEVICES = [device("x", "m"), device("y", "m"), device("z", "m"), device("yaw", "rad")];
const drone = (id) => ({
  id,
  devices: DRONE_DEVICES,
  body: { x: by(0), y: by(1), z: by(2), yaw: by(3), shape: { ball: 0.07 }, joints: [], speed: 2, acceleration: null },
});

const joint = (name, xyz, axis, value, radius) => ({
  name,
  kind: value.device === null ? "fixed" : "revolute",
  xyz,
  rpy: [0, 0, 0],
  axis,
  value,
  radius,
});
const RADIANS = Math.PI / 180;
const arm = {
  id: "arm-1",
  devices: ["base", "shoulder", "elbow"].map((id) =>
    device(id, "deg", { interpolation: "hold", granularity: 0.1, default: 0, min: -180, max: 180 }),
  ),
  body: {
    x: fixed(-4.3),
    y: fixed(-1),
    z: fixed(0),
    yaw: fixed(0),
    shape: { ball: 0.12 },
    speed: null,
    acceleration: null,
    joints: [
      joint("base", [0, 0, 0.3], [0, 0, 1], by(0, RADIANS), 0.06),
      joint("shoulder", [0, 0, 0.2], [0, 1, 0], by(1, RADIANS), 0.05),
      joint("elbow", [0.6, 0, 0], [0, 1, 0], by(2, RADIANS), 0.04),
      joint("tip", [0.5, 0, 0], [0, 0, 1], fixed(0), 0.02),
    ],
  },
};
const rover = {
  id: "rover-1",
  devices: [device("wheel", "m", { interpolation: "hold", granularity: 0.01 }), device("range", "m", { sensor: true })],
  body: { x: by(0, 1, -2.2), y: fixed(-1), z: fixed(0.1), yaw: fixed(0.5), shape: { box: [0.5, 0.3, 0.2] }, joints: [], speed: null, acceleration: null },
};

const SOURCE_TAIL =
  "  - cue: look around\n    after: drone 1 + 250ms\n    robots: arm-1\n  - cue: bow\n    after: look around\n    robots: arm-1\n  - cue: drive\n    with: look around\n    robots: rover-1\n";

export async function choreography() {
  const swap = await readSwap();
  const columns = new Columns();
  const robots = [...swap.cues.map((cue) => drone(cue.robot)), arm, rover];
  const lines = swap.text.split("\n").length;
  const mission = {
    version: 1,
    program: "downbeat 1.0.0",
    kind: "recording",
    scenario: "swap, with an arm",
    epoch: "2026-01-01T00:00:00.394514404Z",
    cut_off: null,
    from: -389,
    to: 2 * TEMPO_MS + 4000,
    known_until: 2 * TEMPO_MS + 4000,
    robots,
    groups: [
      { name: "drones", robots: [0, 1, 2, 3, 4, 5] },
      { name: "ground", robots: [6, 7] },
    ],
    space: { distance: 0.15, keep_in: { least: [-6, -4, 0], most: [6, 4, null] }, keep_out: [] },
    sources: [{ name: "swap.yaml", text: swap.text + SOURCE_TAIL }],
    plans: [swapPlan(swap, columns), finalePlan(columns, lines)],
    acts: [act("swap", 0, 0, 0, TEMPO_MS), act("finale", 1, 1, TEMPO_MS + 1000, TEMPO_MS + 6750)],
    events: events(),
    findings: [
      {
        code: "DB0052",
        severity: "error",
        message: "`cf2` and `cf4` come within 0.087 m of each other",
        hint: "let `drone 4` start later",
        source: 0,
        line: swap.cues[3].first_line,
        column: 5,
      },
      { code: "DB0031", severity: "warning", message: "the act waits for nothing", hint: null, source: null, line: 0, column: 0 },
    ],
    set: [],
    read: [],
    clocks: [],
    late: [],
    report: report(robots),
  };
  observe(mission, swap, columns);
  return { mission, columns, base64: encode(mission, columns) };
}

function lane(robot, index, control, steps, start = 0) {
  return { robot, device: index, control, value: 0, worst_error: 0.0125, worst_at: 500, scripts: [{ start, steps }] };
}

function swapPlan(swap, columns) {
  return {
    name: "swap",
    duration: TEMPO_MS,
    start_tolerance: 5,
    waits: "",
    bodies: [],
    budgets: [{ robot: 0, device: 0, steps: 18, budget: 100 }],
    closest: { robots: [1, 3], at: 1812.5, distance: 0.0871 },
    cues: swap.cues.map((cue, i) => ({
      name: cue.name,
      start: 0,
      end: TEMPO_MS,
      slack: 0,
      critical: true,
      note: null,
      robots: [i],
      source: 0,
      first_line: cue.first_line,
      last_line: cue.last_line,
      relations: [],
    })),
    lanes: swap.cues.flatMap((cue, robot) =>
      Object.values(cue.tracks).map(({ t, v }, i) => lane(robot, i, "position", columns.series(t, v))),
    ),
  };
}

function finalePlan(columns, lines) {
  const times = Array.from({ length: 200 }, (_, i) => i * 20);
  const swing = (size, period) => times.map((t) => Math.round(10 * size * Math.sin((2 * Math.PI * t) / period)) / 10);
  const cue = (name, start, end, slack, robots, at, relations) => ({
    name,
    start,
    end,
    slack,
    critical: slack === 0,
    note: null,
    robots,
    source: 0,
    first_line: lines + at,
    last_line: lines + at + 2,
    relations,
  });
  return {
    name: "finale",
    duration: 5750,
    start_tolerance: 5,
    waits: "go from the operator",
    bodies: [],
    budgets: [],
    closest: { robots: [6, 7], at: 2000, distance: 1.305 },
    cues: [
      cue("look around", 250, 4250, 0, [6], 0, [{ text: "at: 250ms", cue: null }]),
      cue("bow", 4750, 5750, 0, [6], 3, [{ text: "after look around + 500 ms", cue: 0 }]),
      cue("drive", 250, 3250, 1500, [7], 6, [{ text: "with look around", cue: 0 }]),
    ],
    lanes: [
      lane(6, 0, "position", columns.series(times, swing(120, 4000), { decimals: 1 }), 250),
      lane(6, 1, "position", columns.series(times, swing(35, 2000), { decimals: 1 }), 250),
      lane(6, 2, "position", columns.series([0, 300, 600, 1000], [0, 30, 60, 0], { decimals: 1 }), 4750),
      lane(7, 0, "speed", columns.series([0, 1000, 3000], [0.2, 0.4, 0], { decimals: 2 }), 250),
    ],
  };
}

function act(name, number, plan, start, end) {
  return {
    name,
    number,
    plan,
    start,
    end,
    sent: start - 388.595,
    decided: start - 290,
    lease: start - 148.6,
    committed: start - 110,
    no_return: start - 50,
    fate: "played",
    over: end,
    robots: Array.from({ length: 8 }, (_, robot) => ({ robot, left_out: false, started: start + 0.1, ended: end })),
  };
}

function events() {
  return [
    { at: -388.5, kind: "preparing", robot: null, text: "" },
    ...[0, 1, 2, 3, 4, 5].map((robot) => ({ at: -350 + 9 * robot, kind: "accepted", robot, text: "" })),
    { at: -290, kind: "decided", robot: null, text: "" },
    { at: 3100, kind: "failed", robot: 4, text: "battery below 10 %" },
    { at: 2 * TEMPO_MS + 2500, kind: "done", robot: null, text: "" },
  ];
}

function observe(mission, swap, columns) {
  swap.cues.forEach((cue, robot) => {
    Object.values(cue.tracks).forEach(({ t, v }, index) => {
      const late = t.map((time, i) => time + 0.25 * ((i * 7 + robot * 3) % 5));
      const off = v.map((value, i) => (robot === 2 && index === 0 && i === 9 ? value + 0.125 : value));
      mission.set.push({ robot, device: index, act: 0, series: columns.series(late, off, { timeDecimals: 3 }) });
    });
    mission.clocks.push({
      robot,
      offset: columns.series([-300, 2000], [0.5, 0.75], { decimals: 3 }),
      uncertainty: columns.series([-300, 2000], [12.5, 0.165], { decimals: 3 }),
    });
  });
  const times = Array.from({ length: 40 }, (_, i) => i * 250);
  mission.read.push({
    robot: 7,
    device: 1,
    act: null,
    series: columns.series(
      times,
      times.map((t) => 0.4 + 0.3 * Math.sin(t / 900)),
      { decimals: null },
    ),
  });
}

function report(robots) {
  const devices = (robot, r) =>
    robot.devices
      .filter((d) => !d.sensor)
      .map((d) => ({
        device: d.id,
        planned_start: "2026-01-01T00:00:00.394514404Z",
        state: "ended",
        started_at: null,
        start_error_ms: 0.025 * r,
        steps_done: 18,
        steps_planned: 18,
        late_steps: r === 4 ? 2 : 0,
      }));
  return {
    scenario: "swap, with an arm",
    outcome: "done",
    start: "2026-01-01T00:00:00.394514404Z",
    spread_ms: 0.125,
    true_spread_ms: 0.037117,
    course: [
      { act: "swap", played: 1, fate: "played" },
      { act: "finale", played: 1, fate: "played" },
    ],
    acts: [
      {
        act: "swap",
        number: 0,
        spread_ms: 0.125,
        robots: robots.slice(0, 6).map((robot, r) => ({ robot: robot.id, left_out: false, devices: devices(robot, r) })),
      },
    ],
    robots: robots.map((robot, r) => ({
      robot: robot.id,
      standing: "ended",
      started: 4,
      scripts: 4,
      start_error_ms: 0.025 * r,
      steps_done: 72,
      steps_planned: 72,
      late_steps: r === 4 ? 2 : 0,
      clock: r < 6 ? { offset_ms: 97.592 * r, uncertainty_ms: 0.241297 } : null,
    })),
    failures: [{ robot: "cf5", device: null, failure: "battery", text: "battery below 10 %" }],
  };
}

/** The same mission, stopped in the middle of its first act, without its first robot. The following acts were not played. */
export async function stopped() {
  const { mission, columns } = await choreography();
  const [swap, finale] = mission.acts;
  Object.assign(swap, { fate: "stopped", over: TEMPO_MS / 2, robots: swap.robots.map((part) => ({ ...part, ended: null })) });
  Object.assign(swap.robots[0], { left_out: true, started: null });
  Object.assign(finale, { fate: "withdrawn", over: TEMPO_MS + 850, robots: [], committed: null, no_return: null });
  mission.report.outcome = "stopped";
  mission.report.course = [
    { act: "swap", played: 0, fate: "stopped" },
    { act: "finale", played: 0, fate: "withdrawn" },
    { act: "encore", played: 0, fate: "timed_out", awaited: "the operator's go", within_ms: 60_000 },
    { act: "bows", played: 0, fate: "not_reached" },
  ];
  return { mission, columns, base64: encode(mission, columns) };
}
