/** The page of the preview runs only its own script, and shows data only as data. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";

import { page } from "../src/page";

const NONCE = "0123456789abcdefABCDEF-_";
const SCRIPT = "https://file+.vscode-resource.vscode-cdn.net/x/page.js";

test("the policy allows the script, its style, and pictures as data", () => {
  const html = page(SCRIPT, NONCE);
  const policy = /Content-Security-Policy" content="([^"]+)"/.exec(html)![1]!;
  assert.deepEqual(policy.split("; ").sort(), ["default-src 'none'", "img-src data:", `script-src 'nonce-${NONCE}'`, `style-src 'nonce-${NONCE}'`]);
  assert.equal([...html.matchAll(/<script/g)].length, 1);
  assert.ok(!/\son\w+=|style=/.test(html));
});

test("neither the nonce nor the address can end an attribute", () => {
  assert.throws(() => page(SCRIPT, 'x" onload="y'));
  assert.throws(() => page(SCRIPT, "short"));
  assert.throws(() => page('x"><script>', NONCE));
});

test("the script of the page never writes markup", () => {
  const source = readFileSync(join(process.env.SIMFOUNDRY_REPOSITORY!, "editors/vscode/src/pageScript.ts"), "utf8");
  assert.ok(!/innerHTML|outerHTML|insertAdjacent|document\.write|eval\(|Function\(/.test(source));
});
