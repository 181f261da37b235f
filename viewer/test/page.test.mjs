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

for (const theme of ["light", "dark"]) {
  for (const [name, size] of Object.entries(SIZES)) {
    test(`the ${name} page in the ${theme} theme says nothing on the console and asks nothing of the network`, async () => {
      const { page, complaints, close } = await browser.open(html, { size, theme });
      await shown(page);
      for (const tab of TABS) await page.getByRole("tab", { name: tab }).click();
      await page.keyboard.press("v");
      await page.keyboard.press("End");
      await settled(page);
      assert.deepEqual(complaints, []);
      const overflow = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
      assert.ok(overflow <= 0, `the page is ${overflow} px wider than the window`);
      await close();
    });
  }

  for (const size of [SIZES.wide, SIZES.narrow]) {
    test(`axe finds nothing in the ${theme} theme at ${size.width} px`, async () => {
      const { page, close } = await browser.open(html, { size, theme, bypassCSP: true });
      await shown(page);
      await page.evaluate(axe);
      for (const tab of TABS) {
        await page.getByRole("tab", { name: tab }).click();
        assert.deepEqual(await violations(page), [], tab);
      }
      await page.keyboard.press("?");
      await page.waitForSelector("dialog[open]");
      assert.deepEqual(await violations(page), [], "help");
      await close();
    });
  }
}

for (const [name, size] of Object.entries(SIZES)) {
  test(`everything to press on the ${name} page is 24 px or more in both directions`, async () => {
    const { page, close } = await browser.open(html, { size });
    await shown(page);
    for (const tab of TABS) {
      await page.getByRole("tab", { name: tab }).click();
      const small = await page.evaluate(() =>
        [...document.querySelectorAll("button, select, input, [role=treeitem], [role=option]")]
          .map((element) => ({ element, box: element.getBoundingClientRect() }))
          .filter(({ box }) => box.width > 0 && (box.width < 24 || box.height < 24))
          .map(({ element, box }) => `${element.outerHTML.slice(0, 80)} ${box.width} x ${box.height}`),
      );
      assert.deepEqual(small, [], tab);
    }
    await close();
  });
}

async function violations(page) {
  return page.evaluate(async () => {
    const tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"];
    const result = await window.axe.run(document, { runOnly: { type: "tag", values: tags } });
    return result.violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`);
  });
}
