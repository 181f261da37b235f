// The page of trials shows the content of its document, at every size, in both themes, by mouse and by keys.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";
import { launch, SIZES } from "./browser.mjs";
import { Columns, encode, pageWith } from "./encode.mjs";
import { load } from "./load.mjs";
import { tried } from "./tried.mjs";

const { replayOf } = await load("trials/command.ts");
const { time } = await load("text/amount.ts");
let browser;
before(async () => (browser = await launch()));
after(() => browser.close());

const open = async (document, options) => {
  const opened = await browser.open(await pageWith(encode(document, new Columns())), options);
  await opened.page.waitForSelector("main.trials");
  return opened;
};
const percent = ({ share }) => (share === null ? "none" : `${Math.round(share * 10_000) / 100} %`);
const ms = (quantiles) => (quantiles === null ? ["–", "–", "–"] : ["p50_ms", "p99_ms", "max_ms"].map((key) => time(quantiles[key])));
const rows = async (page, table) =>
  Promise.all((await page.locator(`${table} tbody tr`).all()).map((row) => row.locator("th, td").allInnerTexts()));
/** Position of a mark of the histogram, as a fraction of its width. */
const placed = (page, selector) => page.locator(selector).evaluate((line) => Number.parseFloat(line.getAttribute("x1")) / 100);

test("numbers are those of the document", async () => {
  const document = tried();
  const { page, complaints, close } = await open(document);
  assert.equal(await page.locator("h1").innerText(), "swap");
  assert.equal(await page.locator("#count").innerText(), "300 trials");
  assert.equal(await page.locator("#world").innerText(), `in the world friday-night, seed ${document.seed}`);
  for (const id of ["starts", "finishes", "aborts", "mixed"]) {
    const share = document[id];
    assert.equal(await page.locator(`#${id} strong`).innerText(), percent(share));
    const ends = [share.least, share.largest].map((end) => Math.round(end * 10_000) / 100);
    assert.equal(await page.locator(`#${id} small`).innerText(), `${share.count} of 300; 95 % interval ${ends[0]} to ${ends[1]} %`);
    const drawn = page.locator(`#${id} line.interval`);
    assert.ok(Math.abs(Number.parseFloat(await drawn.getAttribute("x1")) - share.least * 100) < 0.001);
    assert.ok(Math.abs(Number.parseFloat(await drawn.getAttribute("x2")) - share.largest * 100) < 0.001);
  }
  assert.deepEqual(await page.locator("#spread dd").allInnerTexts(), [...ms(document.spread), "5 ms"]);
  assert.deepEqual(
    await rows(page, "#outcomes"),
    document.outcomes.map(([name, share]) => [name.replaceAll("_", " "), String(share.count), percent(share)]),
  );
  assert.deepEqual(
    await rows(page, "#reasons"),
    document.reasons.map(({ robot, kind, share, example, text }) => [
      robot ?? "–",
      kind.replaceAll("_", " "),
      String(share.count),
      percent(share),
      `trial ${example}`,
      text,
    ]),
  );
  const marks = { cf1: "weakest robot", cf5: "weakest link" };
  for (const [i, cells] of (await rows(page, "#robots")).entries()) {
    const { robot, fails_first, accepts_within, accepts_last, reconnects } = document.robots[i];
    assert.equal(cells[0].replace(/\s/g, " "), robot + (marks[robot] ?? ""));
    assert.deepEqual(
      [cells[1], ...cells.slice(3)],
      [`${fails_first.count} (${percent(fails_first)})`, ...ms(accepts_within), percent(accepts_last), percent(reconnects)],
    );
  }
  assert.deepEqual(
    (await rows(page, "#lead")).map((cells) => cells.slice(2)),
    [ms(document.lead.had), ms(document.lead.enough)],
  );
  assert.match(await page.locator("#undecided").innerText(), /^10 acts /);
  assert.deepEqual(await rows(page, "#requirements"), [
    ["spread p99", "below 5 ms", "3.411043 ms", "met", ""],
    ["starts", "above 99.9 %", "97 %", "not met", ""],
    ["closest", "at least 0.3 m", "–", "not known", "robots were left out"],
  ]);
  assert.equal(await page.locator("header .badge.bad").innerText(), "1 of 3 requirements not met");
  assert.deepEqual((await rows(page, "#acts"))[1].slice(1), ["0 of 0 (none)", "–", "–", "–", "8 ms", "none"]);
  assert.deepEqual(complaints, []);
  await close();
});

test("the histogram has a bar for each of its counts, and marks where the numbers are", async () => {
  const document = tried();
  const { page, close } = await open(document);
  const { counts, beyond, width_ms } = document.histogram;
  const bars = await page.locator(".histogram .bin").evaluateAll((bins) =>
    bins.map((bin) => ({ x: Number.parseFloat(bin.getAttribute("x")), high: Number(bin.getAttribute("height")) })),
  );
  const drawn = [...counts.filter((count) => count > 0), beyond];
  assert.equal(bars.length, drawn.length);
  bars.forEach(({ high }, i) => assert.ok(Math.abs(high / drawn[i] - bars[0].high / drawn[0]) < 0.5 / drawn[i], `bar ${i}`));
  const end = width_ms * counts.length;
  const lines = await page.locator(".histogram line.quantile").evaluateAll((all) => all.map((line) => Number.parseFloat(line.getAttribute("x1"))));
  assert.ok(Math.abs(lines[0] / lines[1] - document.spread.p50_ms / document.spread.p99_ms) < 1e-3);
  assert.ok(lines[2] > bars.at(-1).x, "the largest is in the column of what is beyond");
  const tolerance = await placed(page, ".histogram line.tolerance");
  assert.ok(Math.abs(tolerance - (5 / end) * 0.93) < 1e-3, String(tolerance));
  await page.locator("summary").press("Enter");
  assert.deepEqual(
    (await rows(page, "#bins")).map((cells) => Number(cells[2])),
    drawn,
  );
  assert.deepEqual((await rows(page, "#bins")).at(-1), ["10.4 ms", "–", "2"]);
  await close();
});

test("a tolerance far away is told and not drawn to scale", async () => {
  const document = tried();
  document.acts.forEach((act) => (act.tolerance_ms = 500));
  const { page, close } = await open(document);
  assert.equal(await page.locator(".histogram line.tolerance").count(), 0);
  assert.equal(await page.locator(".histogram .label.tolerance").textContent(), "tolerance 500 ms →");
  await close();
});

test("keys choose a trial, and the command that plays it again follows", async () => {
  const { page, close } = await open(tried());
  const command = "downbeat dry-run show.yaml --world 'it'\\''s friday.yaml' --seed 18446744073709551615 --trial ";
  assert.equal(await page.locator("#replay").innerText(), `${command}0`);
  await page.getByRole("button", { name: "trial 33", exact: true }).press("Enter");
  assert.equal(await page.locator("#replay").innerText(), `${command}33`);
  const before = await page.evaluate(() => document.documentElement.dataset.theme);
  await page.keyboard.press("t");
  assert.notEqual(await page.evaluate(() => document.documentElement.dataset.theme), before);
  await close();
});

test("words of the command are quoted for a shell", () => {
  assert.equal(replayOf(["a-b/c.yaml", "", "a b", "$(x)", "~", "it's"], 7), "a-b/c.yaml '' 'a b' '$(x)' '~' 'it'\\''s' --trial 7");
});

test("names of others are text, and what would turn the text around is an escape", async () => {
  const hostile = "</script><img src=x onerror=alert(1)>\u202e\u0007\u05e9";
  const shownAs = "</script><img src=x onerror=alert(1)>\\u202e\\u0007\u05e9";
  const document = tried();
  document.scenario = document.world = document.program = hostile;
  document.acts[0].act = document.reasons[0].robot = document.reasons[0].kind = document.reasons[0].text = hostile;
  document.robots[0].robot = document.weakest_robot = document.outcomes[0][0] = document.requirements[2].note = hostile;
  document.replay[4] = hostile;
  const { page, complaints, close } = await open(document);
  for (const place of ["h1", "#world", "#acts", "#outcomes", "#robots", "#requirements", "#replay", "main > p"]) {
    assert.ok((await page.locator(place).textContent()).includes(shownAs), place);
  }
  assert.equal((await page.locator("#reasons tbody tr").first().textContent()).split(shownAs).length, 4);
  assert.equal(await page.locator("#page script, #page img").count(), 0);
  assert.deepEqual(complaints, []);
  await close();
});

test("trials of which nothing started, in no world of their own, are shown", async () => {
  const share = { count: 0, of: 1, share: 0, least: 0, largest: 0.8 };
  const document = { ...tried({ trials: 1 }), world: "", spread: null, histogram: null, lead: null, weakest_robot: null, weakest_link: null };
  Object.assign(document, { acts: [], reasons: [], robots: [], starts: share, outcomes: [["stopped_or_so", share]], requirements: [] });
  const { page, complaints, close } = await open(document);
  assert.equal(await page.locator("#world").innerText(), `in the world of the fleet file, seed ${document.seed}`);
  assert.ok(await page.locator("#no-spread").isVisible());
  assert.equal(await page.locator("#count").innerText(), "1 trial");
  assert.equal(await page.locator("#requirements").count(), 0);
  assert.deepEqual(complaints, []);
  await close();
});

test("a thousand robots do not stop the page", async () => {
  const { page, close } = await open(tried({ trials: 100_000, robots: 1_000 }));
  assert.equal(await page.locator("#robots tbody tr").count(), 300);
  await page.getByRole("button", { name: "300 of 1000 robots: show more" }).click();
  assert.equal(await page.locator("#robots tbody tr").count(), 600);
  await close();
});

for (const theme of ["light", "dark"]) {
  for (const [name, size] of Object.entries({ ...SIZES, phone: { width: 400, height: 800 } })) {
    test(`the ${name} page in the ${theme} theme fits, and axe finds nothing`, async () => {
      const axe = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
      const { page, complaints, close } = await open(tried(), { size, theme, bypassCSP: true });
      const overflow = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
      assert.ok(overflow <= 0, `the page is ${overflow} px wider than the window`);
      const small = await page.evaluate(() =>
        [...document.querySelectorAll("button, summary")]
          .map((element) => ({ element, box: element.getBoundingClientRect() }))
          .filter(({ box }) => box.width < 24 || box.height < 24)
          .map(({ element }) => element.outerHTML.slice(0, 80)),
      );
      assert.deepEqual(small, []);
      assert.deepEqual(complaints, []);
      await page.evaluate(axe);
      const found = await page.evaluate(async () => {
        const tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"];
        const { violations } = await window.axe.run(document, { runOnly: { type: "tag", values: tags } });
        return violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`);
      });
      assert.deepEqual(found, []);
      await close();
    });
  }
}
