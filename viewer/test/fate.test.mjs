// Pages of missions that did not go as planned, or about which data is missing.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { launch, shown } from "./browser.mjs";
import { choreography, stopped } from "./choreography.mjs";
import { encode, pageWith } from "./encode.mjs";

let browser;
before(async () => (browser = await launch()));
after(() => browser.close());

async function open({ mission, columns }) {
  const opened = await browser.open(await pageWith(encode(mission, columns)));
  await shown(opened.page);
  return opened;
}

test("a stopped act, a withdrawn one and those that were never sent are told as such", async () => {
  const { page, complaints, close } = await open(await stopped());
  const rows = await page.locator("#acts tbody tr").allInnerTexts();
  assert.deepEqual(rows.map((row) => row.split("\t").slice(0, 2).join(": ")), [
    "swap: stopped at 0:02.125",
    "finale: withdrawn before anything moved, at 0:05.100",
    "encore: skipped: the operator's go did not occur within 60 s",
    "bows: not reached",
  ]);
  await page.keyboard.press("3");
  assert.match(await page.locator("#cues tbody tr").first().innerText(), /⊘ planned, not played from 0:02\.125/);
  assert.match(await page.locator("#cues tbody tr").last().innerText(), /⊘ planned, not played\b(?! from)/);
  await page.keyboard.press("6");
  assert.match(await page.locator("#events").innerText(), /finale: planned start/);
  await page.keyboard.press("End");
  await page.keyboard.press("2");
  assert.match(await page.locator("#values").innerText(), /not played/);
  assert.match(await page.locator(".stage-facts span[title]").getAttribute("title"), /cf2: x is not known since its act was over/);
  assert.deepEqual(complaints, []);
  await close();
});

test("a scenario without acts is one row, as its report names it once by the scenario and once by nothing", async () => {
  const { mission, columns } = await choreography();
  mission.acts = [{ ...mission.acts[0], name: mission.scenario }];
  mission.report.acts[0].act = mission.scenario;
  mission.report.course = [{ act: "", played: 1, fate: "played" }];
  const { page, complaints, close } = await open({ mission, columns });
  const rows = await page.locator("#acts tbody tr").allInnerTexts();
  assert.deepEqual(rows.map((row) => row.split("\t").slice(0, 2).join(": ")), [`${mission.scenario}: played`]);
  const devices = mission.robots.flatMap((robot) => robot.devices).length;
  assert.match(await page.locator("#facts").innerText(), new RegExp(`with a body, ${devices} devices`));
  assert.deepEqual(complaints, []);
  await close();
});

test("the bars of an act, and of a robot that was left out, tell it to the pointer", async () => {
  const { page, complaints, close } = await open(await stopped());
  const box = await page.locator(".timeline-canvas").boundingBox();
  const tipAt = async (x, y) => {
    await page.mouse.move(box.x + x, box.y + y);
    return page.locator(".timeline .tip").innerText();
  };
  assert.match(await tipAt(box.width * 0.2, 36), /swap[\s\S]*stopped at 0:02\.125\s+planned, not played from 0:02\.125/);
  const row = await page.locator(".row-robot").nth(0).boundingBox();
  assert.match(await tipAt(box.width * 0.2, row.y - box.y + 10), /⊘ the robot was left out of swap/);
  assert.deepEqual(complaints, []);
  await close();
});

test("a mission whose end is unknown, out of a file that is not whole, says both", async () => {
  const { mission, columns } = await choreography();
  mission.cut_off = "the last line ends too early";
  mission.report.outcome = null;
  mission.report.robots = null;
  mission.acts[1] = { ...mission.acts[1], fate: "open", over: null };
  mission.report.failures = [
    { robot: "cf5", device: null, failure: "battery", text: "battery below 10 %" },
    { robot: "cf6", device: "x", failure: "refused", error: { code: 3, message: "too far" } },
    { robot: "cf1", failure: "link_lost" },
  ];
  const { page, complaints, close } = await open({ mission, columns });
  assert.match(await page.locator("#verdict").innerText(), /^⚠ The recording ends at 0:12\.5, before the mission does\. cf5: battery below 10 %\.$/);
  assert.equal(await page.locator(".cut-off").innerText(), "⚠ incomplete: the last line ends too early");
  assert.match(await page.locator("#outcome").innerText(), /outcome\s+outcome unknown/);
  assert.equal(await page.locator("#robots tbody tr").count(), 8);
  assert.match(await page.locator("#acts").innerText(), /finale\s+outcome unknown/);
  const failures = await page.locator("li.error-text").allInnerTexts();
  assert.deepEqual(failures, ["✕ 0:03.1 cf5 battery below 10 %", "✕ cf6 / x too far", "✕ cf1 link lost"]);
  assert.deepEqual(complaints, []);
  await close();
});

test("a report of another shape, and a document without the newer fields, are shown as far as they fit", async () => {
  const { mission, columns } = await choreography();
  delete mission.cut_off;
  for (const act of mission.acts) for (const field of ["fate", "over"]) delete act[field];
  for (const { lanes } of mission.plans) for (const lane of lanes) delete lane.value;
  const hostile = { outcome: [], acts: ["act", null, { robots: "r" }], robots: [{}], failures: [null, {}], course: [7, {}] };
  for (const report of [mission.report, hostile, {}, "report", []]) {
    const { page, complaints, close } = await open({ mission: { ...mission, report }, columns });
    for (const key of ["2", "3", "4", "5", "6", "7", "v", "End", "1"]) await page.keyboard.press(key);
    await page.locator("#facts").waitFor();
    assert.equal(await page.locator(".cut-off").count(), 0);
    assert.deepEqual(complaints, []);
    await close();
  }
});
