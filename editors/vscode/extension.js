// Starts `downbeat lsp` for YAML files.
const { commands, workspace } = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

exports.activate = async (context) => {
  const command = workspace.getConfiguration("downbeat").get("command", "downbeat");
  const watcher = workspace.createFileSystemWatcher("**/*.{yaml,yml,json,urdf,csv,svg}");
  context.subscriptions.push(watcher);
  client = new LanguageClient(
    "downbeat",
    "Downbeat",
    { command, args: ["lsp"] },
    { documentSelector: [{ scheme: "file", language: "yaml" }], synchronize: { fileEvents: watcher } },
  );
  context.subscriptions.push(commands.registerCommand("downbeat.restart", () => client.restart()));
  await client.start();
};

exports.deactivate = () => client?.stop();
