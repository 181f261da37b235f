// What the three views of the page show, and links to an instant.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { launch, settled, SIZES, WITHOUT_WEBGL } from "./browser.mjs";
import { choreography } from "./choreography.mjs";
import { encode, pageWith } from "./encode.mjs";

let browser;
before(async () => (browser = await launch()));
after(() => browser.close());

/** The test mission in which the first drone has a lamp that is red from the start. */
async function lit() {
  const { mission, columns } = await choreography();
  const lamp = { id: "lamp", name: "", unit: "", interpolation: "hold", granularity: 1, min: 0, max: 255, default: null, sensor: false };
  mission.robots[0] = { ...mission.robots[0], devices: [...mission.robots[0].devices, lamp] };
  [255, 0, 0].forEach((level, value) =>
    mission.plans[0].lanes.push({ robot: 0, device: 4, control: "custom_1", value, worst_error: 0, worst_at: 0, scripts: [{ start: 0, steps: columns.series([0], [level]) }] }),
  );
  return { mission, columns, html: await pageWith(encode(mission, columns)) };
}

/** Number of pixels of the stage that are clearly red. */
const redPixels = (page) =>
  page.locator(".hero").screenshot().then((png) =>
    page.evaluate(async (base64) => {
      const image = new Image();
      image.src = `data:image/png;base64,${base64}`;
      await image.decode();
      const canvas = new OffscreenCanvas(image.width, image.height);
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      const { data } = context.getImageData(0, 0, image.width, image.height);
      let red = 0;
      for (let i = 0; i < data.length; i += 4) if (data[i] > 170 && data[i + 1] < 110 && data[i + 2] < 110) red++;
      return red;
    }, png.toString("base64")),
  );

for (const [name, script] of [["with WebGL", ""], ["without WebGL", WITHOUT_WEBGL]]) {
  test(`the show begins with a lit stage that takes most of the window, ${name}`, async () => {
    const { html } = await lit();
    const { page, complaints, close } = await browser.open(html, { script, address: "#t=0.5&mode=show&view=front", bypassCSP: true });
    await page.waitForSelector(".hero");
    await settled(page);
    const { width, height } = await page.locator(".hero .fill").boundingBox();
    assert.ok((width * height) / (SIZES.wide.width * SIZES.wide.height) > 0.7, `${width} x ${height}`);
    assert.ok((await redPixels(page)) > 40, `${await redPixels(page)}`);
    assert.match(await page.locator(".caption").innerText(), /swap\s+drone \d · drone \d · drone \d and 3 more/);
    assert.equal(await page.evaluate(() => document.querySelector(".painted").width > 300), script === "");
    assert.deepEqual(complaints, []);
    await close();
  });
}

test("the show plays by itself, unless a link names an instant", async () => {
  const { html } = await lit();
  for (const [address, plays] of [["", true], ["#t=1", false]]) {
    const { page, close } = await browser.open(html, { address });
    await page.waitForSelector(".hero");
    assert.equal(await page.getByRole("button", { name: "Pause (Space)" }).count(), plays ? 1 : 0);
    await close();
  }
});

test("a link leads to its instant, cue and view, and the page makes the same link", async () => {
  const { html } = await lit();
  const { page, complaints, close } = await browser.open(html, { address: "#t=6.25&cue=look+around&view=side&mode=engineer" });
  await page.waitForSelector(".timeline-canvas");
  assert.equal(await page.locator("#playhead").innerText(), "0:06.250");
  assert.equal(await page.getByRole("button", { name: "View: side" }).getAttribute("aria-pressed"), "true");
  await page.keyboard.press("7");
  assert.match(await page.locator(".source-tab .bar").innerText(), /cue look around/);
  await page.getByRole("button", { name: "Copy a link" }).click();
  await page.waitForFunction(() => document.querySelector("#link-copied").textContent !== "");
  assert.equal(await page.evaluate(() => location.hash), "#t=6.250&cue=look+around&view=side&mode=engineer");
  assert.deepEqual(complaints, []);
  await close();
});

test("a click on a robot selects it and its row", async () => {
  const { html } = await lit();
  const { page, complaints, close } = await browser.open(html, { address: "#t=0.5&mode=show&view=top" });
  await page.waitForSelector(".hero");
  await settled(page);
  const box = await page.locator(".hero .fill").boundingBox();
  // Searches for a robot along a grid: the places depend on the size of the window.
  let found = "";
  for (let x = 0.1; x < 0.9 && found === ""; x += 0.02)
    for (let y = 0.1; y < 0.9 && found === ""; y += 0.04) {
      await page.mouse.click(box.x + x * box.width, box.y + y * box.height);
      found = await page.locator(".caption-robot").allInnerTexts().then((texts) => texts[0] ?? "");
    }
  assert.match(found, /^(cf\d|arm-1|rover-1)$/);
  assert.deepEqual(complaints, []);
  await close();
});

test("margins show each limit, and a click leads to the worst instant", async () => {
  const { html } = await lit();
  const { page, complaints, close } = await browser.open(html, { address: "#mode=check" });
  await page.waitForFunction(() => document.querySelectorAll(".chart").length === 4);
  const titles = await page.locator(".chart-title").allInnerTexts();
  assert.match(titles[0], /closest distance\s+✕ 0\.0\d+ m, cf\d – cf\d, 0:0\d\.\d+\s+at least 0\.15 m/);
  assert.match(titles[1], /highest speed[\s\S]*at most 2 m\/s/);
  assert.match(titles[3], /distance to the bounds[\s\S]*at least 0 m/);
  assert.match(await page.locator("#budget").innerText(), /cf1 \/ x has 18 steps and holds 100 at a time/);
  const before = await page.locator("#playhead").innerText();
  await page.locator(".chart .link").first().click();
  assert.notEqual(await page.locator("#playhead").innerText(), before);
  assert.deepEqual(complaints, []);
  await close();
});

test("a mission without bodies says how to see it, and opens at its check", async () => {
  const { mission, columns } = await choreography();
  mission.robots = mission.robots.map((robot) => ({ ...robot, body: null }));
  const { page, complaints, close } = await browser.open(await pageWith(encode(mission, columns)), { address: "" });
  await page.waitForSelector("main.check-mode");
  await page.keyboard.press("s");
  assert.match(await page.locator(".no-stage").innerText(), /body/);
  assert.deepEqual(complaints, []);
  await close();
});

test("panels can be resized with the keyboard", async () => {
  const { html } = await lit();
  const { page, close } = await browser.open(html);
  await page.waitForSelector(".timeline-canvas");
  const height = () => page.locator(".timeline").boundingBox().then((box) => box.height);
  const before = await height();
  await page.locator(".splitter.row").focus();
  await page.keyboard.press("ArrowUp");
  await settled(page);
  assert.ok((await height()) > before + 10);
  await close();
});

test("print leaves the verdict and the chosen details, with every row", async () => {
  const { html } = await lit();
  const { page, close } = await browser.open(html, { address: "#mode=check" });
  await page.waitForSelector("main.check-mode");
  await page.keyboard.press("3");
  await page.emulateMedia({ media: "print" });
  for (const hidden of [".transport", ".tabs", ".timeline", ".margins", ".toolbar"]) assert.equal(await page.locator(hidden).isVisible(), false, hidden);
  assert.ok(await page.locator("#verdict").isVisible());
  const cut = await page.evaluate(() => {
    const { bottom } = document.querySelector("#cues").getBoundingClientRect();
    return bottom > document.documentElement.scrollHeight;
  });
  assert.equal(cut, false);
  await close();
});
