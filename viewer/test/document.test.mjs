// The page shows the content of the document.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { launch, settled, shown } from "./browser.mjs";
import { choreography } from "./choreography.mjs";
import { encode, pageWith } from "./encode.mjs";

let browser;
before(async () => (browser = await launch()));
after(() => browser.close());

test("numbers are short, with all digits in a tooltip", async () => {
  const { mission, base64 } = await choreography();
  const { page, close } = await browser.open(await pageWith(base64));
  await shown(page);
  for (const [id, text, digits] of [["#spread", "0.13 ms", "0.125"], ["#true-spread", "37 µs", "0.037117"]]) {
    assert.equal(await page.locator(id).innerText(), text);
    assert.equal(await page.locator(id).getAttribute("title"), `exactly ${digits} ms`);
  }
  const rows = await page.locator("#robots tbody tr").all();
  // The robot that failed comes first.
  const order = [4, 0, 1, 2, 3, 5, 6, 7];
  for (const [row, i] of order.entries()) {
    const { robot, start_error_ms } = mission.report.robots[i];
    assert.equal(await rows[row].locator("th").innerText(), robot);
    const cells = await rows[row].locator("td").allInnerTexts();
    assert.deepEqual(cells.slice(0, 2), ["72 of 72", i === 4 ? "⚠ 2 steps" : "–"]);
    assert.equal(await rows[row].locator("td").nth(2).getAttribute("title"), `exactly ${start_error_ms} ms`);
  }
  await page.keyboard.press("2");
  for (const [step, value] of [
    [1, "-3.3"],
    [2, "-3.301"],
    [3, "-3.309"],
    [4, "-3.327"],
  ]) {
    const cells = await page.locator("#values tbody tr").first().locator("td").allInnerTexts();
    assert.deepEqual(cells.slice(0, 2), [`${value} m`, `${step} of 18`]);
    await page.keyboard.press(".");
    await settled(page);
  }
  await close();
});

test("names of others are text, and what would turn the text around is an escape", async () => {
  const { mission, columns } = await choreography();
  const hostile = "<script>alert(1)</script>\"'&\u202eevil\u0007\u0000 \u05e9\u05dc\u05d5\u05dd";
  const shownAs = "<script>alert(1)</script>\"'&\\u202eevil\\u0007\\u0000 \u05e9\u05dc\u05d5\u05dd";
  mission.scenario = mission.robots[0].id = mission.robots[0].devices[0].id = mission.plans[0].cues[0].name = hostile;
  mission.acts[0].name =
    mission.events[0].text =
    mission.findings[0].message =
    mission.sources[0].name =
    mission.report.robots[0].robot =
      hostile;
  mission.sources[0].text = `${hostile}\n${mission.sources[0].text}`;
  const { page, complaints, close } = await browser.open(await pageWith(encode(mission, columns)));
  await shown(page);
  assert.equal(await page.locator("h1 bdi").textContent(), shownAs);
  assert.equal(await page.locator(".row-robot bdi").first().textContent(), shownAs);
  for (const key of ["2", "3", "4", "5", "6", "7"]) {
    await page.keyboard.press(key);
    await settled(page);
    assert.ok((await page.locator("#tab-body").textContent()).includes(shownAs), `panel ${key}`);
  }
  assert.equal(await page.locator("#page script").count(), 0);
  assert.deepEqual(complaints, []);
  await close();
});

test("a journal that knows no plans, and a mission of nothing, are shown as far as they are known", async () => {
  const { mission, columns } = await choreography();
  const journal = {
    ...mission,
    kind: "journal",
    report: null,
    plans: [],
    sources: [],
    findings: [],
    set: [],
    read: [],
    acts: mission.acts.map((act) => ({ ...act, plan: null })),
  };
  const nothing = { ...journal, from: 0, to: 0, robots: [], groups: [], acts: [], events: [], clocks: [] };
  for (const document of [journal, nothing]) {
    const { page, complaints, close } = await browser.open(await pageWith(encode(document, columns)));
    await shown(page);
    for (const key of ["l", "k", "+", "f", "z", "n", ".", "c", "ArrowDown", "Enter", "u", "v", "2", "3", "4", "5", "6", "7", "1"])
      await page.keyboard.press(key);
    await settled(page);
    assert.deepEqual(complaints, []);
    assert.equal(await page.locator("h1").innerText(), "swap, with an arm");
    await close();
  }
});

for (const [name, change, expected] of [
  ["without a mission", () => "@@MISSION@@", /holds no mission/],
  ["that is cut off", (base64) => base64.slice(0, base64.length / 2), /damaged or cut off/],
  ["that is no base64", () => "()", /damaged or cut off/],
  [
    "of a column cut off",
    (_, { mission, columns }) =>
      encode({ ...mission, plans: mission.plans.map((plan) => ({ ...plan, lanes: plan.lanes.map(beyond) })) }, columns),
    /cut off/,
  ],
]) {
  test(`a page ${name} says so`, async () => {
    const made = await choreography();
    const { page, close } = await browser.open(await pageWith(change(made.base64, made)));
    const notice = page.locator(".notice[role=alert]");
    await notice.waitFor();
    assert.match(await notice.innerText(), expected);
    await close();
  });
}

function beyond(lane) {
  return {
    ...lane,
    scripts: lane.scripts.map((script) => ({ ...script, steps: { ...script.steps, v: { ...script.steps.v, at: 1e9 } } })),
  };
}

test("a browser without DecompressionStream is told what it lacks", async () => {
  const { base64 } = await choreography();
  const { page, close } = await browser.open(await pageWith(base64), { script: "delete window.DecompressionStream" });
  await page.locator(".notice[role=alert]").waitFor();
  assert.match(await page.locator(".notice").innerText(), /DecompressionStream/);
  await close();
});

test("the page of a diff lists what differs, as text, and a click leads there", async () => {
  const { mission, columns } = await choreography();
  const hostile = "</script><script>alert(1)</script>\u202e";
  const shownAs = "</script><script>alert(1)</script>\\u202e";
  const of = { plan: 0, robot: null, device: null };
  mission.compared = {
    with: hostile,
    ghosts: [{ plan: 0, cues: [{ cue: 0, start: 100, end: 700 }], lanes: mission.plans[0].lanes.slice(0, 1) }],
    differences: [
      { ...of, at: 1500, subject: hostile, text: hostile },
      { ...of, at: null, plan: null, subject: "robots", text: "removed" },
    ],
  };
  const { page, complaints, close } = await browser.open(await pageWith(encode(mission, columns)));
  await shown(page);
  assert.equal(await page.locator("#tab-differences").getAttribute("aria-selected"), "true");
  const rows = page.locator("#differences tbody tr");
  assert.equal(await rows.count(), 2);
  assert.deepEqual(await rows.first().locator("bdi").allTextContents(), [shownAs, shownAs]);
  assert.equal(await rows.nth(1).locator("button").count(), 0);
  await page.keyboard.press("1");
  assert.equal(await page.locator("#tab-summary").getAttribute("aria-selected"), "true");
  await page.keyboard.press("8");
  const before = await page.locator(".times output").innerText();
  await rows.first().locator("button").click();
  assert.notEqual(await page.locator(".times output").innerText(), before);
  assert.equal(await page.locator("#page script").count(), 0);
  assert.deepEqual(complaints, []);
  await close();
});
