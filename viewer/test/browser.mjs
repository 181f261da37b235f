// One headless browser for the tests of a file, and pages that fail on anything unexpected.
import { mkdtemp, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { chromium } from "playwright-core";

const ARGUMENTS = [
  "--no-sandbox",
  "--disable-gpu",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
  "--enable-precise-memory-info",
];

export const SIZES = {
  wide: { width: 1440, height: 900 },
  middle: { width: 1024, height: 768 },
  narrow: { width: 390, height: 844 },
};

// Other load may leave little CPU time for the tests. A healthy browser may then need half a minute for a page.
const PATIENCE_MS = Number(process.env.PATIENCE_MS ?? 300_000);

/** Chromium itself reports this if it draws WebGL in software. */
const DRIVER = /GPU stall due to ReadPixels/;

/** A script after which the browser has no WebGL. */
export const WITHOUT_WEBGL = `
  const all = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) { return /webgl/.test(kind) ? null : all.call(this, kind, ...more); };
`;

export async function launch() {
  const folder = await mkdtemp(join(tmpdir(), "viewer-"));
  const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ARGUMENTS, timeout: PATIENCE_MS });
  let pages = 0;
  return {
    async open(html, { size = SIZES.wide, theme = "light", forcedColors = "none", bypassCSP = false, script = "", address: at = "#mode=engineer" } = {}) {
      const file = join(folder, `${pages++}.html`);
      await writeFile(file, html);
      const context = await browser.newContext({ viewport: size, colorScheme: theme, forcedColors, bypassCSP });
      context.setDefaultTimeout(PATIENCE_MS);
      const page = await context.newPage();
      if (script !== "") await page.addInitScript(script);
      const complaints = [];
      page.on("console", (message) => DRIVER.test(message.text()) || complaints.push(`console: ${message.text()}`));
      page.on("pageerror", (error) => complaints.push(`error: ${error.message}`));
      const address = pathToFileURL(file).href;
      page.on("request", (request) => request.url().split("#")[0] !== address && complaints.push(`request: ${request.url().slice(0, 100)}`));
      await page.goto(address + at);
      return { page, complaints, close: () => context.close() };
    },
    async close() {
      await browser.close();
      await rm(folder, { recursive: true });
    },
  };
}

export const shown = (page) => page.waitForSelector(".timeline-canvas");

/** Resolves once the page has drawn all earlier changes. */
export const settled = (page) =>
  page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
