// Uses the extension in VS Code as a person does, and prints what a person sees as JSON, step by step.
// node drive.mjs ADDRESS BROWSER FOLDER-FOR-PICTURES
import { renameSync } from "node:fs";
import { join } from "node:path";
import { chromium } from "playwright-core";

const [address, executablePath, pictures] = process.argv.slice(2);
const PATIENCE = 30_000;
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1400, height: 800 } });
page.setDefaultTimeout(PATIENCE);
const seen = {};

async function step(name, run) {
  try {
    seen[name] = await run();
  } catch (error) {
    seen[name] = { error: String(error).split("\n")[0] };
  }
  await page.screenshot({ path: join(pictures, `${Object.keys(seen).length}-${name}.png`) });
}

/** Return a value once it is what is wanted, or the last one. */
async function until(read, wanted) {
  const end = Date.now() + PATIENCE;
  for (;;) {
    const value = await read();
    if (wanted(value) || Date.now() > end) return value;
    await page.waitForTimeout(50);
  }
}

/** Return a value once it has not changed for a second, such as the picture after the last of many. */
async function settled(read) {
  let value = await read();
  for (let same = 0; same < 10; ) {
    await page.waitForTimeout(100);
    const next = await read();
    same = next === value ? same + 1 : 0;
    value = next;
  }
  return value;
}

async function command(title) {
  await page.keyboard.press("F1");
  await page.locator(".quick-input-widget input").fill(`>${title}`);
  await page.locator(".quick-input-list .monaco-list-row").first().waitFor();
  await page.keyboard.press("Enter");
}

/** Put the cursor before the first place where a text is in the editor. */
async function cursor(text, offset = 0) {
  const lines = await code();
  const line = lines.findIndex((each) => each.includes(text));
  await page.keyboard.press("Control+G");
  await page.locator(".quick-input-widget input").fill(`:${line + 1}:${lines[line].indexOf(text) + offset + 1}`);
  await page.keyboard.press("Enter");
  await page.waitForTimeout(300);
}

const code = async () => {
  const lines = await page.locator(".monaco-editor .view-lines .view-line").evaluateAll((all) =>
    all.map((line) => [line.style.top, line.textContent]).sort((a, b) => parseFloat(a[0]) - parseFloat(b[0])),
  );
  return lines.map(([, text]) => text.replaceAll("\u00a0", " "));
};
const problems = () => page.locator("#status\\.problems a").first().getAttribute("aria-label");
const none = (text) => /No Problems|Errors: 0/i.test(text ?? "");

/** Return the part of the page of the preview. */
async function preview(selector) {
  const frame = await until(() => page.frames().find((each) => each.url().includes("fake.html")), Boolean);
  return frame.locator(selector);
}
const source = async () => (await (await preview("#picture")).getAttribute("src")) ?? "";
const message = async () => (await (await preview("#message")).textContent()) ?? "";

await page.goto(address);

await step("trust", async () => {
  await page.getByText("Yes, I trust the authors").click();
  await page.getByText("desk.scene.yaml").first().click();
  await page.waitForSelector(".view-line");
  return until(() => page.locator("#status\\.editor\\.mode").textContent(), (text) => text === "SimFoundry");
});

await step("missing", async () => {
  const toasts = page.locator(".notification-toast");
  await toasts.getByText("language server").first().waitFor();
  await page.waitForTimeout(1000); // a second one would come now
  const said = await toasts.locator(".notification-list-item-message").allTextContents();
  const programs = join(new URL(address).searchParams.get("folder"), ".venv", "bin");
  renameSync(join(programs, "mended"), join(programs, "simfoundry"));
  await toasts.getByText("Try again").first().click();
  return said;
});

await step("finding", async () => {
  await page.waitForSelector(".squiggly-error");
  return problems();
});

await step("fixed", async () => {
  await cursor("dsk", 1);
  await page.keyboard.type("e");
  return until(problems, none);
});

await step("completion", async () => {
  await cursor("on: desk", 4);
  await page.keyboard.press("Control+Space");
  await page.locator(".suggest-widget .monaco-list-row").first().waitFor();
  const rows = await page.locator(".suggest-widget .monaco-list-row .label-name").allTextContents();
  await page.keyboard.press("Escape");
  return rows;
});

await step("rename", async () => {
  await cursor("OnTop(cup", 7);
  await page.keyboard.press("F2");
  const box = page.locator(".rename-box input"); // it is there before it has the focus
  await box.fill("mug");
  await box.press("Enter");
  return until(async () => (await code()).filter((line) => /mug|cup/.test(line)), (lines) => lines.every((line) => !line.includes("cup")));
});

await step("picture", async () => {
  await command("SimFoundry: Show scene");
  await until(source, (text) => text.startsWith("data:image/png;base64,"));
  await settled(source);
  const image = await preview("#picture");
  return { ...(await image.evaluate(async (each) => (await each.decode(), { width: each.naturalWidth, height: each.naturalHeight }))), message: await message() };
});

await step("keystroke", async () => {
  const before = await settled(source);
  await page.locator(".monaco-editor .view-lines").first().click();
  await cursor("0.1, 0.1, 0.1", 2);
  await page.keyboard.type("3");
  await page.keyboard.press("Delete");
  return (await until(source, (text) => text !== before)) !== before && (await until(message, (text) => !text)) === "";
});

await step("invalid", async () => {
  const before = await settled(source);
  await cursor("mass", 0);
  await page.keyboard.type("x");
  const found = await until(problems, (text) => !none(text));
  const words = await until(message, Boolean);
  const kept = (await settled(source)) === before;
  await page.screenshot({ path: join(pictures, "invalid.png") });
  await page.keyboard.press("Backspace");
  return { found, words, kept, gone: await until(message, (text) => !text) };
});

await step("orbit", async () => {
  const before = await settled(source);
  const box = await (await preview("#picture")).boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 + 120, box.y + box.height / 2 + 20, { steps: 8 });
  await page.mouse.up();
  return (await until(source, (text) => text !== before)) !== before;
});

await step("zoom", async () => {
  const before = await settled(source);
  await page.mouse.wheel(0, -300);
  return (await until(source, (text) => text !== before)) !== before;
});

await step("restart", async () => {
  await page.locator(".monaco-editor .view-lines").first().click();
  await cursor("on: desk", 5);
  await page.keyboard.press("Delete");
  const broken = await until(problems, (text) => !none(text));
  await command("SimFoundry: Restart server");
  await page.waitForTimeout(2000);
  return { broken, again: await until(problems, (text) => !none(text)) };
});

console.log(JSON.stringify(seen));
await browser.close();
