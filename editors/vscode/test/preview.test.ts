/** The preview without VS Code: what it asks for, when, and what it shows. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { Preview } from "../src/preview";
import { type PreviewParams, type PreviewResult, type Shown, pageMessage } from "../src/protocol";

const RESULT: PreviewResult = { version: 1, png: "aGk=", width: 640, height: 480, message: null, azimuth_deg: 40, elevation_deg: 30, distance: 2 };
const turn = (): Promise<void> => new Promise((resolve) => setImmediate(resolve));

/** A server that answers when it is told to. */
class Answers {
  readonly asked: PreviewParams[] = [];
  readonly shown: Shown[] = [];
  readonly findings: Record<string, string> = {};
  private readonly waiting: { resolve(result: PreviewResult): void; reject(error: Error): void }[] = [];
  readonly preview = new Preview(
    (params) => {
      this.asked.push(params);
      return new Promise((resolve, reject) => this.waiting.push({ resolve, reject }));
    },
    (shown) => this.shown.push(shown),
    (uri) => this.findings[uri] ?? "",
  );

  async answer(result: Partial<PreviewResult> | Error = {}): Promise<void> {
    const next = this.waiting.shift()!;
    if (result instanceof Error) next.reject(result);
    else next.resolve({ ...RESULT, ...result });
    await turn();
  }
}

test("a document is asked for once, from the start", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  server.preview.follow("file:///a", "a");
  assert.deepEqual(server.asked, [{ uri: "file:///a" }]);
  await server.answer();
  assert.deepEqual(server.shown, [{ name: "a", message: "", png: "aGk=" }]);
  assert.equal(server.asked.length, 1);
});

test("of many keystrokes during a request, one more request follows", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  for (let k = 0; k < 50; k++) server.preview.changed("file:///a");
  assert.equal(server.asked.length, 1);
  await server.answer();
  assert.equal(server.asked.length, 2);
  await server.answer();
  assert.equal(server.asked.length, 2);
});

test("the change of another document is not asked for", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  await server.answer();
  server.preview.changed("file:///b");
  assert.equal(server.asked.length, 1);
});

test("an invalid text keeps the picture and shows the finding", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  await server.answer();
  server.preview.changed("file:///a");
  server.findings["file:///a"] = "Line 3: unknown key `mas`";
  await server.answer({ png: null, message: "The text has errors." });
  const message = "The text has errors.\nLine 3: unknown key `mas`";
  assert.deepEqual(server.shown[1], { name: "a", message });
  server.preview.receive({ type: "ready" }); // a page that loads anew gets both
  assert.deepEqual(server.shown[2], { name: "a", message, png: "aGk=" });
});

test("an error is shown, and the next change asks again", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  await server.answer(new Error("the server stopped"));
  assert.deepEqual(server.shown, [{ name: "a", message: "There is no picture: the server stopped" }]);
  server.preview.changed("file:///a");
  await server.answer();
  assert.equal(server.shown[1]!.message, "");
});

test("a server without a preview is to be updated", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  await server.answer(Object.assign(new Error("Method Not Found"), { code: -32601 }));
  assert.match(server.shown[0]!.message, /has no preview\. Update it/);
});

test("the answer for a document that is no longer shown is dropped", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  server.preview.follow("file:///b", "b");
  await server.answer({ message: "of a" });
  assert.equal(server.shown.length, 0);
  await server.answer({ message: "of b" });
  assert.deepEqual(server.shown.map((shown) => shown.message), ["of b"]);
});

test("a drag orbits from where the camera is, and no camera goes over the top", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  server.preview.receive({ type: "orbit", azimuth_deg: 300, elevation_deg: 0 }); // before it is known where it is
  server.preview.receive({ type: "orbit", azimuth_deg: 100, elevation_deg: 500 });
  await server.answer();
  assert.deepEqual(server.asked[1], { uri: "file:///a", azimuth_deg: 80, elevation_deg: 89, distance: 2 });
  await server.answer();
  assert.equal(server.asked.length, 2);
});

test("the wheel zooms within bounds, and a reset returns to the view of the server", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  await server.answer();
  server.preview.receive({ type: "zoom", factor: 0.5 });
  server.preview.receive({ type: "zoom", factor: 0.5 });
  await server.answer();
  assert.deepEqual([server.asked[1]!.distance, server.asked[2]!.distance], [1, 0.5]);
  await server.answer();
  server.preview.receive({ type: "zoom", factor: 1e9 });
  await server.answer();
  assert.equal(server.asked.at(-1)!.distance, 1000);
  server.preview.receive({ type: "reset" });
  assert.deepEqual(server.asked.at(-1), { uri: "file:///a" });
});

test("a server that does not tell where the camera is, is not asked forever", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  server.preview.receive({ type: "zoom", factor: 0.5 });
  for (let k = 0; k < 2; k++) await server.answer({ distance: undefined, azimuth_deg: undefined });
  assert.equal(server.asked.length, 2);
});

test("an answer of nothing is a sentence", async () => {
  const preview = new Preview(() => Promise.resolve(null), (shown) => said.push(shown.message));
  const said: string[] = [];
  preview.follow("file:///a", "a");
  await turn();
  assert.deepEqual(said, ["There is no picture of this document."]);
});

test("the size of the panel is asked for, within bounds", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  server.preview.receive({ type: "resize", width: 1e6, height: 1.2 });
  await server.answer();
  assert.deepEqual([server.asked[1]!.width, server.asked[1]!.height], [1600, 64]);
  server.preview.receive({ type: "resize", width: 400, height: 900 }); // a panel beside the text is often tall
  await server.answer();
  assert.deepEqual([server.asked[2]!.width, server.asked[2]!.height], [400, 300]);
});

test("a closed preview asks and shows no more", async () => {
  const server = new Answers();
  server.preview.follow("file:///a", "a");
  server.preview.close();
  await server.answer();
  server.preview.refresh();
  assert.deepEqual([server.asked.length, server.shown.length], [1, 0]);
});

test("only messages of the page are read", () => {
  for (const bad of [null, 3, "orbit", [], {}, { type: "x" }, { type: "orbit" }, { type: "zoom", factor: -1 }, { type: "zoom", factor: "2" }, { type: "resize", width: NaN, height: 1 }]) {
    assert.equal(pageMessage(bad), undefined);
  }
  assert.deepEqual(pageMessage({ type: "zoom", factor: 2, more: 1 }), { type: "zoom", factor: 2 });
});
