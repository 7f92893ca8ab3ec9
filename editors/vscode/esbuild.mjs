// Bundles the extension, the page's script, and the tests: `node esbuild.mjs FOLDER [--tests]`.
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const [folder, flag] = process.argv.slice(2);
const shared = { bundle: true, target: "es2022", legalComments: "none", logLevel: "warning", absWorkingDir: here };
const node = { ...shared, platform: "node", format: "cjs", mainFields: ["module", "main"] };

if (flag === "--tests") {
  const tests = readdirSync(join(here, "test")).filter((name) => name.endsWith(".test.ts"));
  const external = ["vscode-oniguruma", "vscode-textmate"]; // found beside the sources, with the WebAssembly of the first
  await build({ ...node, external, entryPoints: tests.map((name) => join("test", name)), outdir: folder, sourcemap: "inline" });
} else {
  const extension = { ...node, minify: true, external: ["vscode"], metafile: true };
  const { metafile } = await build({ ...extension, entryPoints: ["src/extension.ts"], outfile: join(folder, "extension.js") });
  await build({ ...shared, minify: true, platform: "browser", format: "iife", entryPoints: ["src/pageScript.ts"], outfile: join(folder, "page.js") });
  writeFileSync(join(folder, "NOTICES.txt"), notices(Object.keys(metafile.inputs)));
}

/** Return the licenses of the packages that the bundle contains. */
function notices(inputs) {
  const packages = new Set(inputs.flatMap((input) => input.match(/^.*node_modules\/(?:@[^/]+\/)?[^/]+/) ?? []));
  return [...packages].sort().map((path) => {
    const { name, version, license } = JSON.parse(readFileSync(join(here, path, "package.json"), "utf8"));
    const file = readdirSync(join(here, path)).find((each) => /^licen[cs]e/i.test(each));
    if (!file) throw new Error(`${path} has no license file`);
    return `${name} ${version} (${license})\n\n${readFileSync(join(here, path, file), "utf8").trim()}\n`;
  }).join(`\n${"-".repeat(80)}\n\n`);
}
