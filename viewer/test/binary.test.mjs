// Pages that the real program writes: their documents have the types of `src/mission.ts` and `src/trials.ts`, key by key, so renaming a
// key on only one side fails here. DOWNBEAT names the program, ../target/debug/downbeat by default.
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { after, before, test } from "node:test";
import { promisify } from "node:util";
import { gunzipSync } from "node:zlib";
import { load } from "./load.mjs";

const run = promisify(execFile);
const root = resolve(import.meta.dirname, "../..");
const downbeat = process.env.DOWNBEAT ?? join(root, "target/debug/downbeat");
const example = (name) => join(root, "scripts/examples", name);

let folder;
before(async () => (folder = await mkdtemp(join(tmpdir(), "downbeat-page-"))));
after(() => rm(folder, { recursive: true, force: true }));

/** The document of the page that this command line writes. */
async function documentOf(...words) {
  const page = join(folder, "page.html");
  // `diff` exits with 1 if there are differences.
  await run(downbeat, [...words, "--html", page], { cwd: root, env: { ...process.env, DOWNBEAT_STATE: join(folder, "state") } }).catch(
    (error) => error.code === 1 || Promise.reject(error),
  );
  const [, packed] = /"([A-Za-z0-9+/=]{100,})"|>([A-Za-z0-9+/=]{100,})</.exec(await readFile(page, "utf8"))?.filter(Boolean) ?? [];
  const bytes = gunzipSync(Buffer.from(packed, "base64"));
  return JSON.parse(bytes.subarray(4, 4 + bytes.readUInt32LE(0)).toString("utf8"));
}

/** Compiler errors for the documents as constants of their type: a missing key, an unknown key or a key of another type is an error. */
async function typeErrors(type, module, documents) {
  // The report may have any shape.
  const literal = (document) => JSON.stringify("report" in document ? { ...document, report: null } : document);
  const constants = documents.map((document, index) => `export const document${index}: ${type} = ${literal(document)};`);
  const file = join(folder, `${type}.ts`);
  await writeFile(file, `import type { ${type} } from "${join(root, "viewer/src", module)}";\n${constants.join("\n")}\n`);
  const tsc = join(root, "viewer/node_modules/typescript/bin/tsc");
  const options = ["--noEmit", "--strict", "--skipLibCheck", "--target", "ES2021", "--module", "ESNext", "--moduleResolution", "bundler"];
  return (await run(process.execPath, [tsc, ...options, file]).catch((error) => error)).stdout;
}

const swap = example("swap.yaml");
const recording = () => join(folder, "swap.mcap");

test("documents of missions have the types of the page", async () => {
  await run(downbeat, ["run", swap, "--record", recording()], { cwd: root, env: { ...process.env, DOWNBEAT_STATE: join(folder, "state") } });
  const documents = [
    await documentOf("dry-run", swap),
    await documentOf("dry-run", example("meeting.yaml")),
    await documentOf("report", recording(), "--scenario", swap),
    await documentOf("report", recording()),
    await documentOf("diff", recording(), recording()),
  ];
  for (const { acts, plans, events, robots } of documents) {
    assert.ok(acts.length > 0 && plans.length > 0 && events.length > 0 && robots.length > 0);
  }
  assert.equal(await typeErrors("Mission", "mission", documents), "");
  const [{ robots, ...others }] = documents;
  const [{ interpolation, ...device }] = robots[0].devices;
  const renamed = { ...others, robots: [{ ...robots[0], devices: [{ ...device, interpolated: interpolation }] }] };
  assert.match(await typeErrors("Mission", "mission", [renamed]), /interpolated"' does not exist in type 'Device'/);
});

test("documents of trials have the types of the page", async () => {
  const wifi = example("worlds/wifi.yaml");
  const document = await documentOf("dry-run", swap, "--world", wifi, "--trials", "50", "--seed", "7");
  assert.equal(document.trials, 50);
  assert.equal(await typeErrors("Trials", "trials", [document]), "");
});

test("the page reads the report of the real program", async () => {
  const { readReport } = await load("data/report.ts");
  const { report } = await documentOf("dry-run", example("meeting.yaml"));
  const read = readReport(report);
  assert.notEqual(read.outcome, null);
  assert.notEqual(read.spread_ms, null);
  assert.notEqual(read.true_spread_ms, null);
  assert.ok(read.course.every(({ act, fate }) => act !== "" && fate !== ""));
  for (const act of read.acts) {
    assert.ok(act.act !== "" && act.number !== null && act.robots.length > 0);
    assert.ok(act.robots.every(({ robot, devices }) => robot !== "" && devices.every(({ device, planned_start }) => device !== "" && planned_start !== null)));
  }
  for (const robot of read.robots) {
    const { standing, steps_done, steps_planned, late_steps } = robot;
    assert.ok(standing !== "" && steps_done !== null && steps_planned !== null && late_steps !== null, JSON.stringify(robot));
  }
});
