// The page in each size and theme: no console output, no network traffic, no axe violations.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";
import { launch, settled, shown, SIZES } from "./browser.mjs";
import { choreography } from "./choreography.mjs";
import { pageWith } from "./encode.mjs";

const TABS = ["Summary", "Values", "Cues", "Deviations", "Findings", "Events", "Source"];
let browser;
let html;
let axe;

before(async () => {
  browser = await launch();
  html = await pageWith((await choreography()).base64);
  axe = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
});
after(() => browser.close());

const MODES = ["show", "check", "engineer"];

/** Opens the page at an instant in the middle, in one of its views. */
async function open(mode, options) {
  const opened = await browser.open(html, { ...options, address: `#t=6.2&mode=${mode}` });
  await opened.page.waitForSelector(`main.${mode}-mode`);
  await settled(opened.page);
  return opened;
}

/** Runs `look` for each tab of the details, or once if the view has none. */
async function inEachTab(page, mode, look) {
  if (mode === "show") return look("show");
  for (const tab of TABS) {
    await page.getByRole("tab", { name: tab }).click();
    await look(tab);
  }
}

for (const [name, size] of Object.entries(SIZES)) {
  for (const theme of ["light", "dark"]) {
    test(`the ${name} page in the ${theme} theme says nothing on the console and asks nothing of the network`, async () => {
      for (const mode of MODES) {
        const { page, complaints, close } = await open(mode, { size, theme });
        await inEachTab(page, mode, () => {});
        for (const key of ["v", "v", "v", "v", "End"]) await page.keyboard.press(key);
        await settled(page);
        assert.deepEqual(complaints, [], mode);
        const overflow = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
        assert.ok(overflow <= 0, `${mode} is ${overflow} px wider than the window`);
        await close();
      }
    });
  }

  test(`no word and no time is broken on the ${name} page`, async () => {
    for (const mode of ["check", "engineer"]) {
      const { page, close } = await open(mode, { size });
      await inEachTab(page, mode, async (tab) => assert.deepEqual(await brokenWords(page), [], `${mode}, ${tab}`));
      await close();
    }
  });
}

for (const [theme, size] of [["light", SIZES.wide], ["dark", SIZES.wide], ["light", SIZES.narrow]]) {
  test(`axe finds nothing in the ${theme} theme at ${size.width} px`, async () => {
    for (const mode of MODES) {
      const { page, close } = await open(mode, { size, theme, bypassCSP: true });
      await page.evaluate(axe);
      await inEachTab(page, mode, async (tab) => assert.deepEqual(await violations(page), [], `${mode}, ${tab}`));
      await page.keyboard.press("?");
      await page.waitForSelector("dialog[open]");
      assert.deepEqual(await violations(page), [], "help");
      await close();
    }
  });
}

test("with forced colours, every view works and axe finds nothing", async () => {
  for (const mode of MODES) {
    const { page, complaints, close } = await open(mode, { forcedColors: "active", bypassCSP: true });
    await page.evaluate(axe);
    assert.deepEqual(await violations(page), [], mode);
    assert.deepEqual(complaints, []);
    await close();
  }
});

test("every view can be reached and left with the keyboard alone", async () => {
  const { page, complaints, close } = await open("show", {});
  for (const [name, mode] of [["Check (G)", "check"], ["Engineer (E)", "engineer"], ["Show (S)", "show"]]) {
    await page.getByRole("button", { name }).focus();
    await page.keyboard.press("Enter");
    await page.waitForSelector(`main.${mode}-mode`);
    // The focus passes through the whole view and comes out at its end.
    const seen = new Set();
    for (let i = 0; i < 60; i++) {
      await page.keyboard.press("Tab");
      seen.add(await page.evaluate(() => document.activeElement?.closest("header, section, .splitter")?.className ?? "outside"));
    }
    assert.ok(seen.size >= 2, `${mode}: ${[...seen]}`);
  }
  assert.deepEqual(complaints, []);
  await close();
});

for (const [name, size] of Object.entries(SIZES)) {
  test(`everything to press on the ${name} page is 24 px or more in both directions`, async () => {
    for (const mode of MODES) {
      const { page, close } = await open(mode, { size });
      await inEachTab(page, mode, async (tab) => assert.deepEqual(await smallTargets(page), [], `${mode}, ${tab}`));
      await close();
    }
  });
}

const smallTargets = (page) =>
  page.evaluate(() =>
    [...document.querySelectorAll("button, select, input, [role=treeitem], [role=option]")]
      .map((element) => ({ element, box: element.getBoundingClientRect() }))
      .filter(({ box }) => box.width > 0 && (box.width < 24 || box.height < 24))
      .map(({ element, box }) => `${element.outerHTML.slice(0, 80)} ${box.width} x ${box.height}`),
  );

/** Short words whose letters are on several lines. */
const brokenWords = (page) =>
  page.evaluate(() => {
    const broken = [];
    const walker = document.createTreeWalker(document.querySelector("#page"), NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node !== null; node = walker.nextNode()) {
      for (const { 0: word, index } of node.data.matchAll(/[\w:.]+/g)) {
        const range = document.createRange();
        range.setStart(node, index);
        range.setEnd(node, index + word.length);
        const lines = new Set([...range.getClientRects()].filter(({ width }) => width > 0).map(({ top }) => Math.round(top)));
        if (word.length < 20 && lines.size > 1) broken.push(word);
      }
    }
    return broken;
  });

async function violations(page) {
  return page.evaluate(async () => {
    const tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"];
    const result = await window.axe.run(document, { runOnly: { type: "tag", values: tags } });
    return result.violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`);
  });
}
