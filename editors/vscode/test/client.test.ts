/** The extension's own code for the server's process, with a real client and the real server. */

import assert from "node:assert/strict";
import { chmodSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, test } from "node:test";
import { pathToFileURL } from "node:url";
import {
  type Diagnostic, DidChangeTextDocumentNotification, DidOpenTextDocumentNotification, ExitNotification,
  InitializedNotification, InitializeRequest, type ProtocolConnection, PublishDiagnosticsNotification, ShutdownRequest,
  createProtocolConnection,
} from "vscode-languageserver-protocol/node";

import { ServerProcess } from "../src/startServer";

const COMMAND = process.env.SIMFOUNDRY_COMMAND!;
const SCENE = "simfoundry: scene/1\nname: desk\nobjects:\n  desk: {shape: {box: [1, 1, 0.1]}, fixed: true, pose: {xyz: [0, 0, -0.05]}}\n  cup: {shape: {box: [0.1, 0.1, 0.1]}, mass: 0.3, place: {on: desk}}\n";

const folder = mkdtempSync(join(tmpdir(), "simfoundry-"));
after(() => rmSync(folder, { recursive: true, force: true }));

function program(name: string, text: string): string {
  const path = join(folder, name);
  writeFileSync(path, text);
  chmodSync(path, 0o755);
  return path;
}

async function connected(run: (connection: ProtocolConnection, server: ServerProcess) => Promise<void>): Promise<void> {
  const server = await ServerProcess.start(COMMAND, folder, () => {});
  const connection = createProtocolConnection(server.process.stdout, server.process.stdin);
  connection.listen();
  try {
    const rootUri = pathToFileURL(folder).href;
    await connection.sendRequest(InitializeRequest.type, { processId: process.pid, rootUri, capabilities: {}, workspaceFolders: null });
    await connection.sendNotification(InitializedNotification.type, {});
    await run(connection, server);
    await connection.sendRequest(ShutdownRequest.type);
    const ended = new Promise((resolve) => server.process.once("exit", resolve));
    await connection.sendNotification(ExitNotification.type);
    assert.equal(await ended, 0);
  } finally {
    connection.dispose();
    server.process.kill();
  }
}

test("a finding appears while one types, and goes", () =>
  connected(async (connection) => {
    const uri = pathToFileURL(join(folder, "desk.scene.yaml")).href;
    let arrived: (found: Diagnostic[]) => void = () => {};
    connection.onNotification(PublishDiagnosticsNotification.type, (params) => {
      if (params.uri === uri) arrived(params.diagnostics);
    });
    const next = (): Promise<Diagnostic[]> => new Promise((resolve) => (arrived = resolve));
    let found = next();
    const text = SCENE.replace("on: desk", "on: dsk");
    await connection.sendNotification(DidOpenTextDocumentNotification.type, { textDocument: { uri, languageId: "simfoundry", version: 1, text } });
    const [problem] = await found;
    assert.match(problem!.message, /dsk/);
    assert.equal(problem!.range.start.line, 4);
    found = next();
    await connection.sendNotification(DidChangeTextDocumentNotification.type, { textDocument: { uri, version: 2 }, contentChanges: [{ text: SCENE }] });
    assert.deepEqual(await found, []);
  }));

test("a program that does not start, is too old, or stops says so in sentences", async () => {
  await assert.rejects(ServerProcess.start(join(folder, "none"), folder, () => {}), /^Error: The language server \(none lsp\) stopped: .*ENOENT/);
  const old = await ServerProcess.start(program("old", "#!/bin/sh\necho \"Error: No such command 'lsp'.\" >&2\nexit 2\n"), folder, () => {});
  assert.match(await old.lastWords(), /has no language server because it is too old\. Update it with pip install "simfoundry\[editor\]"\.$/);
  const needs = program("needs", "#!/bin/sh\necho 'error: the language server needs pygls: pip install simfoundry[editor]' >&2\nexit 2\n");
  const sentence = await (await ServerProcess.start(needs, folder, () => {})).lastWords();
  assert.equal(sentence.split("simfoundry[editor]").length, 2);
  const fault = program("fault", "#!/bin/sh\nprintf 'Traceback (most recent call last):\\n  x = (\\n      ^\\nSyntaxError: bad\\n' >&2\nexit 1\n");
  assert.match(await (await ServerProcess.start(fault, folder, () => {})).lastWords(), /\(fault lsp\) stopped: SyntaxError: bad\. If/);
  const silent = await ServerProcess.start(program("silent", "#!/bin/sh\nexit 1\n"), folder, () => {});
  assert.match(await silent.lastWords(), /^The language server \(silent lsp\) stopped\. If a package is missing/);
});
