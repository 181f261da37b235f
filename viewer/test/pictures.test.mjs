// Pictures of the page, compared with approved ones in `test/pictures`: broken words, hidden cues and dark lamps are seen. BLESS=1
// approves the current pictures; look at each.
import assert from "node:assert/strict";
import { mkdir, readFile, writeFile } from "node:fs/promises";
import { after, before, test } from "node:test";
import { launch, settled, SIZES } from "./browser.mjs";
import { choreography, stopped } from "./choreography.mjs";
import { encode, pageWith } from "./encode.mjs";

const FOLDER = new URL("pictures/", import.meta.url);
/** Largest difference of a channel that is not counted, and the share of pixels that may differ more: fonts are smoothed differently. */
const [CHANNEL, SHARE] = [48, 0.01];

let browser;
before(async () => {
  browser = await launch();
  await mkdir(FOLDER, { recursive: true });
});
after(() => browser.close());

/** The first drone has a lamp, one cue has no duration, and another has a finding. */
async function mission(make) {
  const { mission, columns } = await make();
  const lamp = { id: "lamp", name: "", unit: "", interpolation: "hold", granularity: 1, min: 0, max: 255, default: null, sensor: false };
  mission.robots[0] = { ...mission.robots[0], devices: [...mission.robots[0].devices, lamp] };
  [255, 40, 0].forEach((level, value) =>
    mission.plans[0].lanes.push({ robot: 0, device: 4, control: "custom_1", value, worst_error: 0, worst_at: 0, scripts: [{ start: 0, steps: columns.series([0], [level]) }] }),
  );
  const { cues } = mission.plans[1];
  cues.push({ ...cues[0], name: "together", start: 4500, end: 4500, slack: 0, relations: [] });
  return { html: await pageWith(encode(mission, columns)) };
}

for (const [name, make, size, theme, address] of [
  ["show", choreography, SIZES.wide, "light", "#t=1&mode=show&view=front"],
  ["show-narrow", choreography, SIZES.narrow, "dark", "#t=1&mode=show&view=front"],
  ["check", choreography, SIZES.wide, "light", "#t=6.2&mode=check"],
  ["engineer-stopped", stopped, SIZES.wide, "dark", "#t=2.5&mode=engineer&view=space"],
  ["check-middle", stopped, SIZES.middle, "light", "#t=2.5&mode=check"],
]) {
  test(`the picture ${name} is the approved one`, async () => {
    const { html } = await mission(make);
    const { page, close } = await browser.open(html, { size, theme, address, bypassCSP: true });
    await page.waitForSelector("main");
    if (address.includes("check")) await page.waitForFunction(() => document.querySelectorAll(".chart").length === 4);
    await settled(page);
    const png = await page.screenshot();
    const file = new URL(`${name}.png`, FOLDER);
    if (process.env.BLESS === "1") await writeFile(file, png);
    const { size: same, share } = await difference(page, png, await readFile(file));
    assert.ok(same, "the picture has another size");
    if (share > SHARE) await writeFile(new URL(`${name}.new.png`, FOLDER), png);
    assert.ok(share <= SHARE, `${(100 * share).toFixed(2)} % of the pixels differ: see test/pictures/${name}.new.png`);
    await close();
  });
}

function difference(page, one, other) {
  return page.evaluate(
    async ({ pictures, channel }) => {
      const [a, b] = await Promise.all(
        pictures.map(async (base64) => {
          const image = new Image();
          image.src = `data:image/png;base64,${base64}`;
          await image.decode();
          const canvas = new OffscreenCanvas(image.width, image.height);
          const context = canvas.getContext("2d");
          context.drawImage(image, 0, 0);
          return context.getImageData(0, 0, image.width, image.height);
        }),
      );
      if (a.width !== b.width || a.height !== b.height) return { size: false, share: 1 };
      let different = 0;
      for (let i = 0; i < a.data.length; i += 4)
        if ([0, 1, 2].some((part) => Math.abs(a.data[i + part] - b.data[i + part]) > channel)) different++;
      return { size: true, share: different / (a.width * a.height) };
    },
    { pictures: [one, other].map((png) => png.toString("base64")), channel: CHANNEL },
  );
}
