// Measures the page with a large mission: `npm run measure [ROBOTS STEPS]`, by default 100 robots with 100,000 steps each.
import { readFile } from "node:fs/promises";
import { cpus, loadavg } from "node:os";
import { gzipSync } from "node:zlib";
import { launch } from "./test/browser.mjs";
import { pageWith } from "./test/encode.mjs";
import { large } from "./test/large.mjs";

const FRAMES = 100;
const [robots, steps] = [Number(process.argv[2] ?? 100), Number(process.argv[3] ?? 100_000)];

const empty = await readFile(new URL("page.html", import.meta.url));
const mission = large({ robots, steps });
const html = await pageWith(mission.base64);
console.log(`load of the machine: ${loadavg()[0].toFixed(1)} on ${cpus().length} cores`);
console.log(`page code: ${(gzipSync(empty, { level: 9 }).length / 1000).toFixed(1)} kB gzipped`);
console.log(`mission: ${robots} robots, ${mission.steps} steps; file: ${(html.length / 1e6).toFixed(1)} MB`);

const browser = await launch();
const { page, complaints } = await browser.open(html, { address: "#t=0&mode=show" });
await page.waitForSelector(".hero");
const load = await page.evaluate(
  () => new Promise((resolve) => requestAnimationFrame(() => setTimeout(() => resolve(performance.now())))),
);
console.log(`usable after ${Math.round(load)} ms (since the navigation began, first picture drawn)`);

await page.keyboard.press("e");
await page.waitForSelector(".timeline-canvas");
await frames("pan, everything folded", "Shift+ArrowRight", 8);
await frames("zoom, everything folded", "+", 0);
await page.keyboard.press("u");
await frames("pan, everything unfolded", "Shift+ArrowRight", 8);
await frames("zoom, everything unfolded", "+", 0);
await page.evaluate(() => {
  document.querySelector(".rows").scrollTop = 1e6;
});
await frames("pan, scrolled to the last lanes", "Shift+ArrowRight", 8);
await frames("playhead moves", "ArrowRight", 3);

const session = await page.context().newCDPSession(page);
await session.send("HeapProfiler.collectGarbage");
const { usedSize, backingStorageSize = 0 } = await session.send("Runtime.getHeapUsage");
console.log(
  `memory after garbage collection: heap ${(usedSize / 1e6).toFixed(1)} MB, array buffers ${(backingStorageSize / 1e6).toFixed(1)} MB`,
);
if (complaints.length > 0) console.log(complaints);
await played(1000);
await browser.close();

/** Plays drones with lamps in the show, and counts the frames. */
async function played(drones) {
  const { base64 } = large({ robots: drones, steps: 4000, lamps: true });
  const { page } = await browser.open(await pageWith(base64), { address: "#mode=show&t=1&view=space" });
  await page.waitForSelector(".hero");
  await page.keyboard.press("l");
  const count = await page.evaluate(async () => {
    const end = performance.now() + 4000;
    let frames = 0;
    while (performance.now() < end) {
      await new Promise(requestAnimationFrame);
      frames++;
    }
    return frames;
  });
  console.log(`${drones} drones with lamps play at ${(count / 4).toFixed(0)} frames a second`);
}

/** From the key to the end of the frame that it causes; every so often the direction changes. */
async function frames(name, key, zoomFirst) {
  await page.keyboard.press("f");
  for (let i = 0; i < zoomFirst; i++) await page.keyboard.press("+");
  const times = await page.evaluate(
    async ({ key, count }) => {
      const opposite = { "Shift+ArrowRight": "Shift+ArrowLeft", ArrowRight: "ArrowLeft", "+": "-" }[key];
      const press = (name) =>
        document.dispatchEvent(
          new KeyboardEvent("keydown", { key: name.replace("Shift+", ""), shiftKey: name.startsWith("Shift+"), bubbles: true }),
        );
      const times = [];
      for (let i = 0; i < count; i++) {
        await new Promise(requestAnimationFrame);
        const before = performance.now();
        press(Math.floor(i / 20) % 2 === 0 ? key : opposite);
        await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
        times.push(performance.now() - before);
      }
      return times.sort((a, b) => a - b);
    },
    { key, count: FRAMES },
  );
  const at = (share) => times[Math.floor(share * (FRAMES - 1))].toFixed(1);
  console.log(`${name}: p50 ${at(0.5)} ms, p95 ${at(0.95)} ms, longest ${at(1)} ms over ${FRAMES} frames`);
}
