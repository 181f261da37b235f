// Lanes, acts that were not played, and deviations, from small documents.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Columns } from "./encode.mjs";
import { load } from "./load.mjs";

const { Show } = await load("data/show.ts");
const { deviations } = await load("data/deviations.ts");
const { readReport } = await load("data/report.ts");
const { poses } = await load("stage/pose.ts");
const { tipOf } = await load("timeline/tipOf.ts");
const { phasesOf } = await load("timeline/phases.ts");
const { millisSince } = await load("text/instant.ts");
const { courseText, fateText } = await load("text/fate.ts");

const device = (id, more = {}) => ({ id, unit: "m", interpolation: "hold", granularity: null, min: null, max: null, default: null, sensor: false, ...more });
const fixed = { device: null, scale: 1, offset: 0 };
const body = { x: { device: 0, scale: 1, offset: 0 }, y: fixed, z: fixed, yaw: fixed, shape: { ball: 0.1 }, joints: [] };

/** One robot with one device, with these `lanes` and `set` values. Each entry of `acts` overrides properties of a played act. */
function showOf({ lanes, set = () => [], acts = [{}], ghosts = null, ...more }) {
  const columns = new Columns();
  const mission = {
    epoch: "2026-01-01T00:00:00.394514404Z",
    from: 0,
    to: 9000,
    robots: [{ id: "r", devices: [device("lamp")], body }],
    groups: [],
    sources: [],
    plans: [{ name: "a", duration: 4000, start_tolerance: 5, cues: [{ name: "c", start: 0, end: 4000, slack: 0, robots: [0], relations: [] }], lanes: lanes(columns), closest: null, waits: "" }],
    acts: acts.map((act, number) => ({ name: "a", number, plan: 0, start: 0, end: 4000, robots: [{ robot: 0, left_out: false, started: null, ended: null }], fate: "played", over: null, ...act })),
    events: [],
    findings: [],
    set: set(columns),
    read: [],
    clocks: [],
    report: null,
    compared: ghosts === null ? null : { with: "a.yaml", differences: [], ghosts: ghosts(columns) },
    ...more,
  };
  return new Show({ mission, columns: new Uint8Array(columns.bytes.subarray(0, columns.length)) });
}

const lane = (value, series, start = 0) => ({ robot: 0, device: 0, value, control: value === 0 ? "position" : `position, value ${value + 1}`, worst_error: 0, worst_at: 0, scripts: [{ start, steps: series }] });
const ramp = (columns) => [lane(0, columns.series([0, 1000, 2000, 3000], [0, 1, 2, 3]))];
const found = (show) => deviations(show, show.tracks).listed.map(({ kind, at, by }) => [kind, at, Number(by.toFixed(6))]);

test("each value of a lamp has its own lane, and what was set belongs to the first", () => {
  const show = showOf({
    lanes: (columns) => [0, 1, 2].map((value) => lane(value, columns.series([0, 1000], [value, value + 0.5]))),
    set: (columns) => [{ robot: 0, device: 0, act: 0, series: columns.series([0, 1000], [0, 0.5]) }],
  });
  assert.deepEqual(show.tracks.map(({ name }) => name), ["lamp, value 1", "lamp, value 2", "lamp, value 3"]);
  assert.deepEqual(show.tracks.map((track) => [track.at(500).value, track.at(1500).value]), [[0, 0.5], [1, 1.5], [2, 2.5]]);
  assert.deepEqual(show.tracks.map((track) => track.segments[0].end), [4000, 4000, 4000]);
  assert.deepEqual(show.tracks.map((track) => show.observed("set", track).length), [1, 0, 0]);
  assert.equal(show.track(0, 0), show.tracks[0]);
  assert.deepEqual(found(show), []);
});

test("lanes of one device that take turns are read in order of time", () => {
  const show = showOf({
    lanes: (columns) => [
      { ...lane(0, columns.series([0], [1])), scripts: [0, 2000].map((start) => ({ start, steps: columns.series([0], [start]) })) },
      { ...lane(0, columns.series([0], [7]), 1000), control: "speed" },
    ],
  });
  assert.deepEqual([500, 1500, 2500].map((ms) => show.tracks[0].at(ms).value), [0, 7, 2000]);
});

test("after a stop the plan is told as not played, and the body stays where it was then", () => {
  const show = showOf({ lanes: ramp, acts: [{ fate: "stopped", over: 1500 }] });
  const [track] = show.tracks;
  assert.equal(track.at(1200).known, "moving");
  assert.deepEqual([track.at(2200).known, track.at(2200).value], ["unplayed", 2]);
  const at = (ms) => poses(show, ms)[0];
  assert.deepEqual([1200, 1500].map((ms) => [at(ms).frame.origin[0], at(ms).doubt]), [[1, null], [1, null]]);
  assert.equal(at(3500).frame.origin[0], 1);
  assert.match(at(3500).doubt, /not known since its act was over at 0:01\.500/);
  assert.equal(show.cues[0].playedUntil, 1500);
});

test("nothing of a withdrawn act was played, and the same act is played when it comes again", () => {
  const acts = [{ fate: "withdrawn", over: -20, start: 0, end: 4000 }, { start: 5000, end: 9000 }];
  const show = showOf({ lanes: ramp, acts });
  const [track] = show.tracks;
  assert.equal(track.at(2000).known, "unplayed");
  assert.equal(track.positionAt(2000).known, "first");
  assert.equal(track.positionAt(7500).value, 2);
  assert.equal(track.positionAt(7500).stopped, null);
  assert.deepEqual(phasesOf(show).map(({ name }) => name), ["planned start", "start"]);
});

test("an act whose fate is not told is shown as it was planned", () => {
  const show = showOf({ lanes: ramp, acts: [{ fate: undefined, over: undefined }] });
  assert.equal(show.tracks[0].at(3500).known, "held");
});

test("a robot that sets everything late has late steps, not wrong values", () => {
  const late = [0, 1000, 2000, 3000].map((t) => t + 700);
  for (const act of [0, null]) {
    const show = showOf({ lanes: ramp, set: (columns) => [{ robot: 0, device: 0, act, series: columns.series(late, [0, 1, 2.5, 3]) }] });
    assert.deepEqual(found(show), [["time", 700, 700], ["time", 1700, 700], ["time", 2700, 700], ["time", 3700, 700], ["value", 2700, 0.5]]);
  }
});

test("a step that a robot left out does not shift the others", () => {
  const show = showOf({ lanes: ramp, set: (columns) => [{ robot: 0, device: 0, act: 0, series: columns.series([0, 2010, 3000], [0, 2, 3]) }] });
  assert.deepEqual(found(show), [["time", 2010, 10]]);
});

test("of a stopped act the steps up to the stop are compared, of a withdrawn one none", () => {
  const set = (columns) => [{ robot: 0, device: 0, act: 0, series: columns.series([600, 1600, 1800], [0, 1, 0]) }];
  const of = (act) => found(showOf({ lanes: ramp, set, acts: [act] }));
  assert.deepEqual(of({ fate: "stopped", over: 1700 }), [["time", 600, 600], ["time", 1600, 600]]);
  assert.deepEqual(of({ fate: "withdrawn", over: 1700 }), []);
});

test("values that belong to no act are compared with the act that plays", () => {
  const acts = [{}, { start: 4000, end: 8000 }];
  const times = [0, 1000, 2000, 3000, 3990, 5000, 6000, 7000];
  const show = showOf({ lanes: ramp, acts, set: (columns) => [{ robot: 0, device: 0, act: null, series: columns.series(times, [0, 1, 2, 3, 0, 1, 2, 3]) }] });
  assert.deepEqual(found(show), [["time", 3990, -10]]);
});

test("starts are compared with the script's own start", () => {
  const report = {
    acts: [{ act: "a", number: 0, robots: [{ robot: "r", left_out: false, devices: [{ device: "lamp", planned_start: "2026-01-01T00:00:02.894514404Z", start_error_ms: 0.5 }] }] }],
  };
  const acts = [{ robots: [{ robot: 0, left_out: false, started: 2500.5, ended: null }] }];
  const show = showOf({ lanes: (columns) => [lane(0, columns.series([0], [1]), 2500)], acts, report });
  assert.deepEqual(found(show), [["start", 2500, 0.5]]);
  const row = { kind: "robot", robot: 0, cues: [] };
  const { lines } = tipOf({ show }, { kind: "row", row, index: 0, ms: 2600 }, 0, 0);
  assert.ok(lines.includes("▲ started at 0:02.501, +0.5 ms"), lines.join("\n"));
});

test("a robot that was left out has that in the tip of its bars", () => {
  const acts = [{ robots: [{ robot: 0, left_out: true, started: null, ended: null }] }];
  const show = showOf({ lanes: ramp, acts });
  assert.ok(show.isLeftOut(0, 0));
  const tip = (row) => tipOf({ show }, { kind: "cue", placed: { ...show.cues[0] }, row, ms: 0 }, 0, 0).lines;
  assert.match(tip({ kind: "robot", robot: 0 })[0], /left out of a/);
  assert.doesNotMatch(tip({ kind: "cues" })[0], /left out/);
});

test("instants are read to the nanosecond", () => {
  assert.equal(millisSince("2026-01-01T00:00:00.394514404Z", "2026-01-01T00:00:00.394514405Z"), 0.000001);
  assert.equal(millisSince("2026-01-01T00:00:00.9Z", "2026-01-01T01:00:01+01:00"), 100);
  assert.equal(millisSince("2026-01-01T00:00:00Z", "2025-12-31T23:59:59.999999999Z"), -0.000001);
  for (const text of ["", "yesterday", "2026-13-01T00:00:00Z", "2026-01-01T00:00:00"])
    assert.equal(millisSince("2026-01-01T00:00:00Z", text), null, text);
});

test("a report of any shape is read as far as it fits", () => {
  for (const json of [null, undefined, "report", 7, []]) assert.equal(readReport(json), null);
  const nothing = { because: "", requirements: [], outcome: null, spread_ms: null, course: [], acts: [], robots: [], failures: [] };
  assert.deepEqual(readReport({}), nothing);
  assert.deepEqual(readReport({ outcome: 7, spread_ms: "1", course: 1, acts: ["a", null, 7], robots: [{}, 3], failures: "f" }), nothing);
  const { acts } = readReport({ acts: [{ act: 7, robots: ["r", { devices: [null, { start_error_ms: "x" }] }] }] });
  const steps = { steps_done: null, steps_planned: null, late_steps: null, late_ms_max: null };
  assert.deepEqual(acts[0].robots[0].devices, [{ device: "", state: "", planned_start: null, start_error_ms: null, ...steps }]);
  assert.deepEqual(readReport({ outcome: { failed: { robot: "r" } } }).outcome, { failed: { robot: "r" } });
});

test("fates are told in words", () => {
  assert.equal(fateText({ fate: "stopped", over: 1500 }), "stopped at 0:01.500");
  assert.equal(fateText({ fate: "open", over: null }), "outcome unknown");
  assert.equal(fateText({ fate: "open", over: 13_500 }), "not known from 0:13.500");
  const course = (fate, played, more = {}) => courseText({ act: "a", fate, played, awaited: "", within_ms: null, ...more });
  assert.equal(course("nobody_left", 1), "played once, then skipped: no robot was left to play it");
  assert.equal(course("timed_out", 0, { awaited: "the operator's go", within_ms: 2000 }), "skipped: the operator's go did not occur within 2 s");
  assert.equal(course("", 0), "not known");
});

test("the plan that this one is compared with is behind it wherever the act was played", () => {
  const lane = (columns, value) => ({ robot: 0, device: 0, control: "position", worst_error: 0, worst_at: 0, scripts: [{ start: 500, steps: columns.series([0, 100], [0, value]) }] });
  const show = showOf({
    lanes: (columns) => [lane(columns, 1)],
    acts: [{}, { start: 5000, end: 9000 }],
    ghosts: (columns) => [{ plan: 0, cues: [{ cue: 0, start: 100, end: 3000 }], lanes: [lane(columns, 2)] }],
  });
  const ghosts = show.ghostsOf(show.tracks[0]);
  assert.deepEqual(ghosts.map(({ start, wave }) => [start, wave.value(1)]), [[500, 2], [5500, 2]]);
  assert.deepEqual(show.cues.map((cue) => show.ghostOfCue(cue)), [{ start: 100, end: 3000 }, { start: 5100, end: 8000 }]);
});

test("without another plan there are no ghosts", () => {
  const show = showOf({ lanes: () => [] });
  assert.equal(show.ghostOfCue(show.cues[0]), null);
});

test("more than a dozen robots have one row for each group, until it is unfolded", async () => {
  const { rowsOf, foldOfGroup, NO_FILTER } = await load("state/rows.ts");
  const robots = Array.from({ length: 14 }, (_, i) => ({ id: `r${i}`, devices: [device("x")], body: null }));
  const groups = [
    { name: "all", robots: robots.map((_, i) => i) },
    { name: "odd", robots: [1, 3, 5] },
  ];
  const show = showOf({ lanes: () => [], robots, groups });
  const rows = (folded) => rowsOf(show, NO_FILTER, new Set(folded)).filter(({ kind }) => kind !== "cues");
  const both = [foldOfGroup(0), foldOfGroup(1)];
  assert.deepEqual(rows(both).map(({ kind, group, robots: of }) => [kind, group, of.length]), [["group", 0, 11], ["group", 1, 3]]);
  assert.deepEqual(rows([foldOfGroup(0)]).map((row) => row.kind === "robot" ? row.robot : row.kind), ["group", "group", 1, 3, 5]);
});

test("a search shows the lanes that it finds, even of folded robots and groups", async () => {
  const { rowsOf, foldOfGroup, NO_FILTER } = await load("state/rows.ts");
  const robots = Array.from({ length: 14 }, (_, i) => ({ id: `r${i}`, devices: [device("x"), device("lamp")], body: null }));
  const set = (columns) => [0, 1].map((of) => ({ robot: 3, device: of, act: null, series: columns.series([0], [1]) }));
  const show = showOf({ lanes: () => [], robots, groups: [{ name: "all", robots: robots.map((_, i) => i) }], set });
  const folded = new Set([foldOfGroup(0), 3]);
  const rows = rowsOf(show, { ...NO_FILTER, text: "lamp" }, folded).filter(({ kind }) => kind !== "cues");
  assert.deepEqual(rows.map((row) => (row.kind === "lane" ? row.track.name : row.kind)), ["group", "robot", "lamp"]);
});
