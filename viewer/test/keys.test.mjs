// Keys and mouse work as described in the help.
import assert from "node:assert/strict";
import { after, before, beforeEach, afterEach, test } from "node:test";
import { launch, settled, shown } from "./browser.mjs";
import { choreography } from "./choreography.mjs";
import { pageWith } from "./encode.mjs";

let browser;
let html;
let opened;
let page;

before(async () => {
  browser = await launch();
  html = await pageWith((await choreography()).base64);
});
after(() => browser.close());
beforeEach(async () => {
  opened = await browser.open(html);
  page = opened.page;
  await shown(page);
});
afterEach(async () => {
  assert.deepEqual(opened.complaints, []);
  await opened.close();
});

const text = (selector) => page.locator(selector).innerText();
const playhead = async () => {
  const [, sign, minutes, seconds] = /(-?)(\d+):([\d.]+)/.exec(await text("#playhead"));
  return (sign === "-" ? -1 : 1) * Math.round((Number(minutes) * 60 + Number(seconds)) * 1000);
};
const settle = () => settled(page);
const press = async (...keys) => {
  for (const key of keys) await page.keyboard.press(key);
  await settle();
};
/** Stops the page's clock. The page draws and plays only while the returned function advances the clock. */
const stopClock = async () => {
  await page.clock.install();
  await page.clock.pauseAt(Date.now() + 1000);
  return (ms) => page.clock.runFor(ms);
};
/** Position of a time on the timeline's canvas, according to the tooltip of the page itself. */
const box = () => page.locator(".timeline-canvas").boundingBox();
const overview = () => page.locator(".overview input").getAttribute("aria-valuetext");

test("Home and End move the playhead to both ends", async () => {
  await press("End");
  assert.equal(await playhead(), 12500);
  await press("Home");
  assert.equal(await playhead(), -389);
});

test("J, K, L and Space play, pause and double the speed", async () => {
  const pass = await stopClock();
  const keys = async (...keys) => {
    for (const key of keys) await page.keyboard.press(key);
    await pass(0);
  };
  await keys("l");
  assert.equal(await text("#speed"), "1×");
  await keys("l", "l");
  assert.equal(await text("#speed"), "4×");
  await pass(200);
  await keys("k");
  const paused = await playhead();
  assert.ok(paused > 300 && paused <= 800, `${paused}`);
  await pass(100);
  assert.equal(await playhead(), paused);
  await keys("j", "j");
  assert.equal(await text("#speed"), "-2×");
  await pass(150);
  await keys(" ");
  const back = await playhead();
  assert.ok(back < paused - 150 && back >= paused - 400, `${back} < ${paused}`);
});

test("playing stops at the end", async () => {
  await press("End", "ArrowLeft");
  const pass = await stopClock();
  for (const key of "lllll") await page.keyboard.press(key);
  await pass(400);
  assert.equal(await playhead(), 12500);
  assert.equal(await page.getByRole("button", { name: "Play (Space)" }).count(), 1);
});

test("arrows seek, and comma and full stop go from step to step of the focused lane", async () => {
  await press("ArrowRight");
  const moved = await playhead();
  assert.ok(moved > 600 && moved < 700, `${moved}`);
  await press(".");
  assert.equal(await playhead(), 750);
  await press(".");
  assert.equal(await playhead(), 1000);
  await press(",", ",");
  assert.equal(await playhead(), 500);
});

test("the buttons of the player do what the keys do", async () => {
  await page.getByRole("button", { name: "To the step after" }).click();
  await settle();
  assert.equal(await playhead(), 250);
  await page.getByRole("button", { name: "To the end (End)" }).click();
  await settle();
  assert.equal(await playhead(), 12500);
  await page.getByRole("button", { name: "Play backwards (J)" }).click();
  await page.waitForFunction(() => !document.querySelector("#playhead").textContent.endsWith("0:12.500"));
  await page.getByRole("button", { name: "Pause (Space)" }).click();
  await settle();
  assert.ok((await playhead()) < 12500);
  await page.getByRole("slider", { name: "Speed" }).fill("1");
  assert.equal(await text("#speed"), "-10×");
});

test("plus zooms in, F fits again, and Shift with arrows pans", async () => {
  assert.match(await overview(), /^100 %/);
  await press("+", "+", "+");
  assert.match(await overview(), /^30 %/);
  const before = await page.locator(".overview input").inputValue();
  await press("Shift+ArrowRight");
  assert.notEqual(await page.locator(".overview input").inputValue(), before);
  await press("f");
  assert.match(await overview(), /^100 %/);
});

test("brackets select a range and Z zooms to it", async () => {
  await press("[", "ArrowRight", "ArrowRight", "]", "z");
  assert.match(await overview(), /^11 %/);
});

test("the wheel zooms at the pointer, a drag pans, Shift and a drag select a range", async () => {
  const { x, y, width } = await box();
  await page.mouse.move(x + width / 2, y + 200);
  await page.mouse.wheel(0, -200);
  await settle();
  assert.match(await overview(), /^51 %/);
  const before = await page.locator(".overview input").inputValue();
  await page.mouse.down();
  await page.mouse.move(x + width / 2 - 100, y + 200, { steps: 4 });
  await page.mouse.up();
  await settle();
  assert.ok(Number(await page.locator(".overview input").inputValue()) > Number(before));
  await press("f");
  await page.keyboard.down("Shift");
  await page.mouse.move(x + 200, y + 300);
  await page.mouse.down();
  await page.mouse.move(x + 200 + width / 4, y + 300, { steps: 4 });
  await page.mouse.up();
  await page.keyboard.up("Shift");
  await press("z");
  assert.match(await overview(), /^2[78] %/);
});

test("a drag on the axis of time moves the playhead", async () => {
  const { x, y, width } = await box();
  await page.mouse.move(x + 50, y + 10);
  await page.mouse.down();
  await page.mouse.move(x + width / 2, y + 10, { steps: 3 });
  await page.mouse.up();
  await settle();
  assert.ok(Math.abs((await playhead()) - 6055) < 30, `${await playhead()}`);
});

test("a click on a cue shows its lines, and a click on a line selects the cue that contains it", async () => {
  const { x, y, width } = await box();
  await page.mouse.click(x + width * 0.15, y + 96 + 13);
  await settle();
  assert.match(await text(".source-tab .bar"), /cue drone 1, lines 8 to 87/);
  const line = page.locator(".code-line.marked").first();
  assert.match(await line.innerText(), /^8\s*- cue: drone 1/);
  await page.locator(".code").evaluate((element) => (element.scrollTop = 24 * 88));
  await page.locator("#line-90").click();
  await settle();
  assert.match(await text(".source-tab .bar"), /cue drone 2/);
});

test("N and P go through the cues", async () => {
  await press("n", "n");
  assert.match(await text(".source-tab .bar"), /cue drone 2/);
  await press("p");
  assert.match(await text(".source-tab .bar"), /cue drone 1/);
});

test("robots fold, and lanes are chosen, by mouse and by key", async () => {
  const lanes = () => page.locator(".row-lane").count();
  const before = await lanes();
  await page.getByRole("treeitem", { name: "cf1 4" }).click();
  await settle();
  assert.equal(await page.getByRole("treeitem", { name: "cf1 4" }).getAttribute("aria-expanded"), "false");
  await press("ArrowRight");
  assert.equal(await page.getByRole("treeitem", { name: "cf1 4" }).getAttribute("aria-expanded"), "true");
  assert.equal(await lanes(), before);
  await press("ArrowDown", "ArrowDown", "ArrowDown", "ArrowDown", "Enter");
  assert.equal(await page.locator(".row-lane[aria-selected=true]").count(), 4);
  await press("u");
  assert.equal(await lanes(), 0);
});

test("search and filters leave the rows that match", async () => {
  await press("/");
  await page.keyboard.type("shoulder");
  await settle();
  assert.equal(await page.locator(".row-lane").count(), 1);
  await page.getByRole("button", { name: "Clear filters" }).click();
  await page.getByLabel("Filter by group").selectOption({ label: "ground" });
  await settle();
  assert.equal(await page.locator(".row-robot").count(), 2);
  await page.getByRole("button", { name: "Clear filters" }).click();
  await page.getByLabel("Filter by cue").selectOption({ label: "drive" });
  await settle();
  assert.equal(await page.locator(".row-robot").count(), 1);
});

test("a deviation moves the playhead to where it is", async () => {
  await press("4");
  await page.getByLabel("Kind").selectOption("value");
  await settle();
  const row = page.locator("#deviations tbody tr").first();
  assert.match(await row.innerText(), /cf3 \/ x\s+value\s+\+0\.13 m/);
  assert.match(await row.locator("td.number").first().getAttribute("title"), /exactly 0\.125\d* m/);
  await row.getByRole("button").click();
  await settle();
  assert.ok(Math.abs((await playhead()) - 2250) < 2, `${await playhead()}`);
});

test("C goes to the closest approach, and the stage tells the distance there", async () => {
  await press("c");
  assert.equal(await playhead(), 1813);
  assert.match(await text("#closest-of-act"), /cf2 – cf4 0\.087 m at 0:01\.813/);
  assert.equal(await page.locator("#closest-now").textContent(), "closest now: cf1 – cf6 0.204 m, at least 0.15 m allowed");
});

test("the question mark shows every key, and Escape closes the help", async () => {
  await press("?");
  assert.ok((await page.locator("dialog kbd").count()) > 30);
  await press("Escape");
  await page.waitForFunction(() => document.querySelector("dialog[open]") === null);
});

test("T changes the theme, V the view of the stage, and S, G and E what the page is for", async () => {
  await press("t");
  assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "dark");
  await press("v");
  assert.equal(await page.getByRole("button", { name: "View: top" }).getAttribute("aria-pressed"), "true");
  for (const [key, visible, hidden] of [["s", ".strip", ".curves"], ["g", ".margins", ".strip"], ["e", ".curves", ".margins"]]) {
    await press(key);
    assert.deepEqual([await page.locator(visible).count(), await page.locator(hidden).count()], [1, 0], key);
  }
});

test("the focused lane is told to screen readers when the playhead rests", async () => {
  await page.getByRole("treeitem", { name: "x m", exact: true }).first().focus();
  await press(".");
  await page.waitForFunction(() =>
    document.querySelector("#spoken").textContent.includes("cf1 x: -3.301 m, step 2 of 18, cue drone 1"),
  );
});
