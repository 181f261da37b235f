// The extension starts the server and passes documents to it, and its problem matcher reads what `downbeat check` prints:
//   node test.mjs DOWNBEAT
// `vscode` is replaced by the parts of it that the extension uses. The client of the real extension needs all of VS Code, so it is
// replaced as well; it speaks no protocol here.
import assert from "node:assert";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import Module, { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";

const program = resolve(process.argv[2]);
const require = createRequire(import.meta.url);
const about = require("./package.json");

const started = [];
class LanguageClient {
  constructor(id, name, server, options) {
    started.push({ server, options });
  }
  async start() {}
  async stop() {}
}
const vscode = {
  commands: { registerCommand: (name) => ({ name }) },
  workspace: {
    getConfiguration: () => ({ get: (key, value) => value }),
    createFileSystemWatcher: (pattern) => ({ pattern }),
  },
};
const load = Module._load;
Module._load = (name, ...rest) =>
  name === "vscode" ? vscode : name === "vscode-languageclient/node" ? { LanguageClient } : load(name, ...rest);
const subscriptions = [];
const { activate, deactivate } = require("./extension.js");
await activate({ subscriptions });
assert.deepEqual(started[0].server, { command: "downbeat", args: ["lsp"] });
assert.equal(started[0].options.documentSelector[0].language, "yaml");
const declared = about.contributes.commands.map((command) => command.command);
assert.deepEqual(subscriptions.filter((one) => one.name).map((one) => one.name), declared);
await deactivate();

const folder = mkdtempSync(join(tmpdir(), "downbeat-"));
spawnSync(program, ["init", join(folder, "show")]);
const show = join(folder, "show", "show.yaml");
writeFileSync(show, readFileSync(show, "utf8").replace(/robots: \w+/, "robots: nobody"));
const output = spawnSync(program, ["check", "show.yaml"], { cwd: join(folder, "show"), encoding: "utf8" });
const lines = output.stderr.split("\n");
const [first, second] = about.contributes.problemMatchers[0].pattern.map((pattern) => new RegExp(pattern.regexp));
const at = lines.findIndex((line) => first.exec(line)?.[2] === "DB0008");
assert.ok(at >= 0, output.stderr);
assert.equal(second.exec(lines[at + 1])[1], "show.yaml");
console.log("the extension starts the server, and its problem matcher reads findings");
