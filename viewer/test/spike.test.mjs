// A single step with an extreme value is visible at every zoom: its lane has a column that reaches the top.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { launch, settled, shown } from "./browser.mjs";
import { pageWith } from "./encode.mjs";
import { large } from "./large.mjs";

const SPIKE = 12_345;
let browser;
before(async () => (browser = await launch()));
after(() => browser.close());

test("a spike of one step in 25,000 is visible from the whole mission down to single steps", async () => {
  const { page, close } = await browser.open(await pageWith(large({ robots: 2, steps: 100_000, spike: SPIKE }).base64));
  await shown(page);
  for (let zoom = 0; zoom < 24; zoom++) {
    await settled(page);
    assert.ok((await highest(page)) < 8, `at zoom ${zoom} the lane's highest pixel is ${await highest(page)} px below its top`);
    // The page zooms at the playhead, so the first key moves it to the spike.
    if (zoom === 0) await seekToSpike(page);
    await page.keyboard.press("+");
  }
  await close();
});

/** Rows from the lane's top to the first pixel of a planned value, read from the picture. */
async function highest(page) {
  return page.evaluate(() => {
    const canvas = document.querySelector(".timeline-canvas");
    const row = document.querySelector(".row-lane");
    const top = Math.round(row.getBoundingClientRect().top - canvas.getBoundingClientRect().top);
    const { data, width } = canvas.getContext("2d").getImageData(0, top, canvas.width, 30);
    for (let i = 0; i < data.length; i += 4) {
      const blue = data[i + 2] - data[i];
      if (blue > 60) return Math.floor(i / 4 / width);
    }
    return Infinity;
  });
}

async function seekToSpike(page) {
  await page.getByRole("treeitem", { name: "x m", exact: true }).first().focus();
  const target = SPIKE * 20;
  const at = () => page.evaluate(() => document.querySelector("#playhead").textContent);
  const box = await page.locator(".timeline-canvas").boundingBox();
  const [from, to] = [-400 - 0.02 * 500_400, 500_000 + 0.02 * 500_400];
  await page.mouse.click(box.x + ((target - from) / (to - from)) * box.width, box.y + 10);
  for (let i = 0; i < 40; i++) {
    const [minutes, seconds] = (await at()).split(":").map(Number);
    const ms = Math.round((minutes * 60 + seconds) * 1000);
    if (ms === target) return;
    await page.keyboard.press(ms < target ? "." : ",");
    await settled(page);
  }
  assert.fail(`the playhead is at ${await at()}`);
}
