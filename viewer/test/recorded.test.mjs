// Pages of real recordings of `meeting.yaml` on three robot processes: one was frozen for 0.15 s (`late`), one was killed (`killed`), and
// one recording was copied while the mission ran (`running`). Each file is the data of a page.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import { load } from "./load.mjs";

const { Show } = await load("data/show.ts");
const { readPayload } = await load("data/payload.ts");
const { robotStates } = await load("data/robots.ts");
const { verdict } = await load("data/verdict.ts");
const { poses } = await load("stage/pose.ts");
const { closestPair } = await load("stage/closest.ts");
const { lightsAt } = await load("data/lamps.ts");

async function shown(name) {
  const text = await readFile(new URL(`recorded/${name}.b64`, import.meta.url), "utf8");
  return new Show(await readPayload(text));
}
const stateOf = (show, id) => robotStates(show).find((state) => state.id === id);

test("a robot that was frozen is late on the page, by how much and when", async () => {
  const show = await shown("late");
  assert.deepEqual(verdict(show), { grade: "warn", text: "Played. arm-2 was up to 164 ms late between 0:05.0 and 0:17.0.", at: 5000 });
  const { lateSteps, stepsDone, stepsPlanned, clock } = stateOf(show, "arm-2");
  assert.deepEqual([lateSteps, stepsDone, stepsPlanned], [2, 211, 211]);
  // The page and the terminal state the same uncertainty.
  assert.equal(clock.uncertainty_ms, show.mission.report.robots.find(({ robot }) => robot === "arm-2").clock.uncertainty_ms);
  assert.equal(show.clockUncertainty(1, 9000), clock.uncertainty_ms);
});

test("a robot that was killed is named, with the end of the lease until which its stop is not confirmed", async () => {
  const show = await shown("killed");
  const { grade, text } = verdict(show);
  assert.equal(grade, "bad");
  assert.match(text, /^Failed at 0:14\.1: arm-2: link down: .*; the stop of arm-2 is not confirmed until \d\d:37:\d\d \(0:19\.1\)\.$/);
  assert.deepEqual(["arm-1", "arm-2", "rover-1"].map((id) => stateOf(show, id).stop.confirmed), [true, false, true]);
  assert.deepEqual(["arm-1", "arm-2", "rover-1"].map((id) => stateOf(show, id).stepsDone), [121, 27, 44]);
  const turn = show.cues.find(({ cue }) => cue.name === "turn");
  assert.ok(turn.playedUntil < turn.start);
});

test("what a running mission has not played yet is not shown as played", async () => {
  const show = await shown("running");
  assert.match(verdict(show).text, /^The recording ends at 0:10\.9, before the mission does\./);
  const turn = show.cues.find(({ cue }) => cue.name === "turn");
  assert.ok(turn.playedUntil < turn.start);
  assert.equal(show.track(0, 3).at(12_000).known, "unplayed");
});

test("the closest robots now are those of the act at its closest instant", async () => {
  const show = await shown("late");
  const { closest } = show.planOf(show.mission.acts[0]);
  const now = closestPair(poses(show, show.mission.acts[0].start + closest.at));
  assert.deepEqual(now.robots, closest.robots);
  assert.ok(Math.abs(now.distance - closest.distance) < 0.002, `${now.distance} is not ${closest.distance}`);
});

test("the lamp of the rover shines as the scenario says", async () => {
  const show = await shown("late");
  const colour = (ms) => lightsAt(show, ms).find(({ robot }) => robot === 2).colour.map((part) => Math.round(255 * part));
  assert.deepEqual(colour(1000), [0, 80, 255]);
  assert.deepEqual(colour(9000), [255, 160, 0]);
});
