// The page states what became of the mission: the verdict, each robot, and numbers with their accuracy.
import assert from "node:assert/strict";
import { test } from "node:test";
import { choreography, stopped } from "./choreography.mjs";
import { load } from "./load.mjs";

const { Show } = await load("data/show.ts");
const { robotStates } = await load("data/robots.ts");
const { verdict } = await load("data/verdict.ts");
const { deviations } = await load("data/deviations.ts");
const { aligned, shortClock, signedTime, time } = await load("text/amount.ts");
const { lightsAt } = await load("data/lamps.ts");

/** The show of the test mission after `change`. */
async function showOf(change = () => {}, make = choreography) {
  const { mission, columns } = await make();
  change(mission);
  return new Show({ mission, columns: new Uint8Array(columns.bytes.subarray(0, columns.length)) });
}

/** As recordings of earlier versions: results only for each act. */
function ofActs(mission, devices) {
  mission.report.robots = [];
  mission.report.failures = [];
  mission.findings = [];
  mission.events = [];
  for (const robot of mission.report.acts[0].robots) for (const device of robot.devices) device.late_steps = 0;
  mission.report.acts[0].robots[1].devices = devices;
}

test("times have two significant digits and a unit of their size", () => {
  const cases = [[0.003769, "3.8 µs"], [0.206, "0.21 ms"], [224.6, "225 ms"], [1686.474891, "1686 ms"], [2500, "2.5 s"], [5, "5 ms"], [0, "0 ms"], [9.96, "10 ms"], [null, "–"], [0.00002, "20 ns"]];
  for (const [ms, text] of cases) assert.equal(time(ms), text);
  assert.equal(signedTime(-0.25), "-0.25 ms");
  assert.deepEqual([9234, -250, 63_900].map(shortClock), ["0:09.2", "-0:00.3", "1:03.9"]);
});

test("the decimal points of a column are below each other", () => {
  const { unit, cells } = aligned([0.53, 12, null, 1.5]);
  assert.equal(unit, "ms");
  const end = (cell) => cell.length - (cell.search(/[.\u2008]/) + 1);
  assert.deepEqual([0, 1, 3].map((i) => end(cells[i])), [2, 2, 2]);
  assert.equal(cells[2], "–");
});

test("a robot that was late is named with its lateness and the time", async () => {
  const late = { device: "x", state: "ended", steps_done: 18, steps_planned: 18, late_steps: 3, late_ms_max: 224.6 };
  const show = await showOf((mission) => {
    ofActs(mission, [late]);
    mission.report.outcome = { steps_late: { late_ms: 224.6, tolerance_ms: 10 } };
    mission.late = [{ robot: 1, device: 0, act: 0, from: 9100, to: 9350, steps: 3, most: 224.6 }];
  });
  const { lateSteps, lateMost, stepsDone } = robotStates(show)[1];
  assert.deepEqual([lateSteps, lateMost, stepsDone], [3, 224.6, 18]);
  assert.deepEqual(verdict(show), { grade: "warn", text: "Played. cf2 was up to 225 ms late at 0:09.1.", at: 9100 });
});

test("an unconfirmed stop is in the verdict, with the end of the lease", async () => {
  const show = await showOf((mission) => {
    ofActs(mission, []);
    mission.report.outcome = "failed";
    mission.events = [
      { at: 13_500, kind: "link_lost", robot: 1, text: "its link was lost" },
      { at: 14_000, kind: "failed", robot: 1, text: "link down" },
      { at: 14_000, kind: "stopping", robot: null, text: "" },
      { at: 14_100, kind: "at_rest", robot: 0, text: "" },
    ];
    mission.report.robots = [{ robot: "cf2", standing: "dropped", stop: { state: "unconfirmed", lease_ends: "2026-01-01T00:00:20.394514404Z" } }];
  });
  const { text, grade, at } = verdict(show);
  assert.equal(grade, "bad");
  assert.equal(at, 13_500);
  assert.match(text, /^Failed at 0:13\.5: cf2: link down; /);
  assert.match(text, /the stops of cf2, .* and 4 more are not confirmed\.$/);
  assert.deepEqual(robotStates(show)[0].stop, { confirmed: true, until: null, text: "confirmed" });
  assert.equal(robotStates(show)[1].stop.until, 20_000);
});

test("a recording that ends early says so, and what follows is not shown as played", async () => {
  const show = await showOf((mission) => {
    ofActs(mission, []);
    mission.report.outcome = null;
    mission.known_until = 2000;
    mission.cut_off = "after 12 messages";
    mission.acts[0] = { ...mission.acts[0], fate: "open", over: null };
  });
  assert.match(verdict(show).text, /^The recording ends at 0:02\.0, before the mission does\./);
  assert.equal(show.cues[0].playedUntil, 2000);
  assert.equal(show.tracks[0].at(3000).known, "unplayed");
});

test("starts are stated with the accuracy of the clocks and the tolerance", async () => {
  const show = await showOf((mission) => {
    mission.report.failures = [];
    mission.events = [];
    mission.findings = [];
    delete mission.report.true_spread_ms;
    mission.report.spread_ms = 0.003769;
    mission.report.robots.forEach((robot) => (robot.late_steps = 0));
    mission.report.acts[0].skew = { predicted_ms: 7.8, tolerance_ms: 10 };
  });
  const text = "Played as planned: 8 robots started within 3.8 µs by their own clocks, which are known to ±0.24 ms; 10 ms allowed.";
  assert.deepEqual(verdict(show), { grade: "good", text, at: null });
});

test("deviations below the uncertainty of the clock are not listed", async () => {
  const show = await showOf();
  // Values are set up to 1 ms late, by clocks that are known to 0.24 ms.
  const { listed, uncertain } = deviations(show, show.tracks);
  const times = listed.filter(({ kind }) => kind === "time");
  assert.ok(times.length > 0 && times.every(({ by }) => Math.abs(by) > 0.241297), JSON.stringify(times[0]));
  assert.ok(uncertain > 0);
});

test("lamps shine in their colours, dark until their first value", async () => {
  const { mission, columns } = await choreography();
  const lamp = { id: "lamp", name: "", unit: "", interpolation: "hold", granularity: 1, min: 0, max: 255, default: null, sensor: false };
  mission.robots[0] = { ...mission.robots[0], devices: [...mission.robots[0].devices, lamp] };
  const values = [[255, 0], [0, 255], [0, 51]];
  values.forEach((list, value) =>
    mission.plans[0].lanes.push({ robot: 0, device: 4, control: "custom_1", value, worst_error: 0, worst_at: 0, scripts: [{ start: 0, steps: columns.series([500, 1000], list) }] }),
  );
  const show = new Show({ mission, columns: new Uint8Array(columns.bytes.subarray(0, columns.length)) });
  const colour = (ms) => lightsAt(show, ms)[0].colour;
  assert.deepEqual([100, 600, 1200].map(colour), [[0, 0, 0], [1, 0, 0], [0, 1, 0.2]]);
});

test("a stopped mission is no success", async () => {
  const show = await showOf(() => {}, stopped);
  assert.equal(verdict(show).grade, "bad");
  assert.match(verdict(show).text, /^Stopped at 0:03\.1: cf5: battery below 10 %/);
});
