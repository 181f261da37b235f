// Missions of any size: each robot has four devices, three of which position its body.
import { Columns, encode } from "./encode.mjs";

const INTERVAL_MS = 20;
const DEVICES = ["x", "y", "z", "lamp"];

/** `steps` are per robot, distributed over its devices. `spike`: one step of the first device has an extreme value. `lamps`: the last device is
 * a lamp of three colours. */
export function large({ robots, steps, spike = null, lamps = false }) {
  const columns = new Columns();
  const count = Math.round(steps / DEVICES.length);
  const duration = count * INTERVAL_MS;
  const times = Array.from({ length: count }, (_, i) => i * INTERVAL_MS);
  const random = mulberry(1);
  const lanes = [];
  for (let robot = 0; robot < robots; robot++) {
    DEVICES.forEach((_, device) => {
      const [size, period, phase] = [1 + random(), 4000 + 9000 * random(), 7 * random()];
      const noise = () => Math.round(6 * random() - 3) / 1000;
      const values = times.map((t, i) =>
        spike === i && robot === 0 && device === 0
          ? 40
          : size * Math.sin(phase + (2 * Math.PI * t) / period) + (robot % 10) + noise(),
      );
      const lane = { robot, device, control: "position", value: 0, worst_error: 0.002, worst_at: 0 };
      if (lamps && DEVICES[device] === "lamp") {
        // Red, green and blue, which change twice a second.
        for (const value of [0, 1, 2]) {
          const changes = Array.from({ length: Math.ceil(duration / 500) }, (_, i) => 500 * i);
          const steps = columns.series(changes, changes.map((_, i) => 85 * ((i + robot + value) % 4)));
          lanes.push({ ...lane, value, scripts: [{ start: 0, steps }] });
        }
        return;
      }
      lanes.push({ ...lane, scripts: [{ start: 0, steps: columns.series(times, values) }] });
    });
  }
  const mission = {
    version: 1,
    program: "downbeat 1.0.0",
    kind: "dry_run",
    scenario: "large",
    epoch: "2026-01-01T00:00:00Z",
    from: -400,
    to: duration,
    cut_off: null,
    report: null,
    sources: [],
    groups: [],
    findings: [],
    events: [],
    set: [],
    read: [],
    clocks: [],
    robots: Array.from({ length: robots }, (_, i) => robotOf(i)),
    plans: [{ name: "", duration, start_tolerance: 5, cues: cuesOf(robots, duration), lanes, closest: null, waits: "" }],
    acts: [
      {
        name: "large",
        number: 0,
        plan: 0,
        start: 0,
        end: duration,
        sent: -400,
        decided: -300,
        committed: -120,
        no_return: -60,
        lease: -160,
        fate: "played",
        over: duration,
        robots: [],
      },
    ],
  };
  return { mission, steps: count * DEVICES.length * robots, base64: encode(mission, columns) };
}

function robotOf(i) {
  const by = (device) => ({ device, scale: 1, offset: 0 });
  return {
    id: `robot-${i + 1}`,
    devices: DEVICES.map((id) => ({
      id,
      unit: "m",
      interpolation: "linear",
      granularity: 0.001,
      min: null,
      max: null,
      default: null,
      sensor: false,
    })),
    body: { x: by(0), y: by(1), z: by(2), yaw: { device: null, scale: 1, offset: 0 }, shape: { ball: 0.05 }, joints: [] },
  };
}

function cuesOf(robots, duration) {
  return Array.from({ length: 20 }, (_, i) => ({
    name: `cue ${i + 1}`,
    start: (i * duration) / 20,
    end: ((i + 0.9) * duration) / 20,
    slack: i % 3 === 0 ? 0 : 500,
    critical: i % 3 === 0,
    robots: Array.from({ length: robots }, (_, robot) => robot),
    source: 0,
    first_line: 1,
    last_line: 1,
    relations: i === 0 ? [] : [{ text: `after cue ${i}`, cue: i - 1 }],
  }));
}

function mulberry(seed) {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}
