/** Where the program is looked for, and what is said if it is not there. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { type Places, findServer } from "../src/findServer";

const PLACES: Places = { setting: "", folders: ["/p"], python: undefined, env: { PATH: "/usr/bin:bin:/opt/bin" }, home: "/users/me", platform: "linux" };

const found = (places: Partial<Places>, ...programs: string[]) => findServer({ ...PLACES, ...places }, (path) => programs.includes(path));

test("the selected environment comes before that of the folder, and both before the PATH", () => {
  const programs = ["/opt/bin/simfoundry", "/p/.venv/bin/simfoundry", "/env/bin/simfoundry"];
  assert.deepEqual(found({ python: "/env" }, ...programs), { command: "/env/bin/simfoundry" });
  assert.deepEqual(found({ python: "/env/bin/python" }, ...programs), { command: "/env/bin/simfoundry" });
  assert.deepEqual(found({}, ...programs), { command: "/p/.venv/bin/simfoundry" });
  assert.deepEqual(found({}, "/opt/bin/simfoundry"), { command: "/opt/bin/simfoundry" });
  assert.deepEqual(found({ env: { VIRTUAL_ENV: "/v", PATH: "/opt/bin" } }, "/opt/bin/simfoundry", "/v/bin/simfoundry"), { command: "/v/bin/simfoundry" });
});

test("the second folder of a workspace counts, and relative entries of the PATH do not", () => {
  assert.deepEqual(found({ folders: ["/p", "/q"] }, "/q/.venv/bin/simfoundry"), { command: "/q/.venv/bin/simfoundry" });
  assert.ok("missing" in found({}, "bin/simfoundry", "/p/bin/simfoundry"));
});

test("on Windows, programs are in Scripts", () => {
  const places: Partial<Places> = { platform: "win32", folders: ["C:\\p"], env: { Path: "D:\\tools;C:\\x" } };
  assert.deepEqual(found(places, "C:\\p\\.venv\\Scripts\\simfoundry.exe"), { command: "C:\\p\\.venv\\Scripts\\simfoundry.exe" });
  assert.deepEqual(found(places, "C:\\x\\simfoundry.exe"), { command: "C:\\x\\simfoundry.exe" });
});

test("the setting wins, with ~ and ${workspaceFolder}", () => {
  const programs = ["/p/.venv/bin/simfoundry", "/users/me/a/simfoundry", "/p/tools/simfoundry", "/q/tools/simfoundry"];
  assert.deepEqual(found({ setting: "~/a/simfoundry" }, ...programs), { command: "/users/me/a/simfoundry" });
  assert.deepEqual(found({ setting: "${workspaceFolder}/tools/simfoundry" }, ...programs), { command: "/p/tools/simfoundry" });
  assert.deepEqual(found({ setting: "tools/simfoundry", folders: ["/x", "/q"] }, ...programs), { command: "/q/tools/simfoundry" });
});

test("what is missing is said in sentences, with what to do", () => {
  const nowhere = found({});
  assert.ok("missing" in nowhere && nowhere.missing.includes('pip install "simfoundry[editor]"') && nowhere.missing.endsWith("."));
  const wrong = found({ setting: "/no/simfoundry" }, "/opt/bin/simfoundry");
  assert.ok("missing" in wrong && wrong.missing.startsWith("The setting simfoundry.path names /no/simfoundry, which is not a program."));
});
