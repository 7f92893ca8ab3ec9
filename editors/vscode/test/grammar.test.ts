/** The grammar, in the engine of VS Code, over real documents and over what is easy to get wrong. */

import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { before, test } from "node:test";
import * as oniguruma from "vscode-oniguruma";
import { type IGrammar, INITIAL, Registry, parseRawGrammar } from "vscode-textmate";

const REPOSITORY = process.env.SIMFOUNDRY_REPOSITORY!;
const GRAMMAR = join(REPOSITORY, "editors/vscode/syntaxes/simfoundry.tmLanguage.json");

let grammar: IGrammar;

before(async () => {
  const data = readFileSync(require.resolve("vscode-oniguruma/release/onig.wasm"));
  await oniguruma.loadWASM(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength) as ArrayBuffer);
  const registry = new Registry({
    onigLib: Promise.resolve({
      createOnigScanner: (patterns) => new oniguruma.OnigScanner(patterns),
      createOnigString: (text) => new oniguruma.OnigString(text),
    }),
    loadGrammar: (scope) =>
      Promise.resolve(scope === "source.simfoundry" ? parseRawGrammar(readFileSync(GRAMMAR, "utf8"), GRAMMAR) : null),
  });
  grammar = (await registry.loadGrammar("source.simfoundry"))!;
});

interface Token {
  text: string;
  /** The most specific scope, without `.simfoundry`. */
  scope: string;
  scopes: string[];
}

/** Return the tokens of each line that are not only spaces. */
function tokens(text: string): Token[][] {
  let state = INITIAL;
  return text.split("\n").map((line) => {
    const found = grammar.tokenizeLine(line, state);
    state = found.ruleStack;
    return found.tokens
      .map((token) => ({ text: line.slice(token.startIndex, token.endIndex), scopes: token.scopes }))
      .filter((token) => token.text.trim())
      .map((token) => ({ ...token, scope: token.scopes.at(-1)!.replace(/\.simfoundry$/, "") }));
  });
}

/** Assert that each part of a line has a scope, in order; parts that are not named may have any. */
function hasScopes(text: string, expected: [string, string][]): void {
  const found = tokens(text).flat();
  let next = 0;
  for (const [part, scope] of expected) {
    const at = found.findIndex((token, k) => k >= next && token.text.trim() === part);
    assert.notEqual(at, -1, `${JSON.stringify(part)} is no token of its own: ${JSON.stringify(found.map((token) => token.text))}`);
    assert.ok(found[at]!.scope.startsWith(scope), `${part}: ${found[at]!.scope} instead of ${scope}`);
    next = at + 1;
  }
}

const PREDICATE = "entity.name.function.predicate";
const ARGUMENT = "variable.parameter.argument";
const PARAMETER = "variable.other.parameter";
const NUMBER = "constant.numeric";
const FILE = "string.unquoted.file";
const OPERATOR = "keyword.operator.arithmetic";
const KEY = "entity.name.tag";

const CASES: Record<string, [string, [string, string][]]> = {
  "the kind": ["simfoundry: scene/1", [["simfoundry", "keyword.control.kind"], ["scene", "entity.name.type.kind"], ["1", NUMBER]]],
  "the schema": ["# yaml-language-server: $schema=../x.schema.json", [["yaml-language-server", "keyword.other.directive"]]],
  "a section": ["objects:", [["objects", "keyword.other.section"]]],
  "a named member": ["objects:\n  cup: {mass: 0.3, fixed: true}", [["cup", KEY], ["mass", KEY], ["0.3", NUMBER], ["true", "constant.language"]]],
  "a predicate": ["relations:\n  - OnTop(cup, desk)", [["-", "punctuation.definition.block"], ["OnTop", PREDICATE], ["cup", ARGUMENT], ["desk", ARGUMENT]]],
  "a predicate with numbers": ["goal: At(cup, 0.1, -.2, 3e-2)", [["At", PREDICATE], ["0.1", NUMBER], ["-.2", NUMBER], ["3e-2", NUMBER]]],
  "a predicate of a joint": ["goal: Open(cabinet.drawer)", [["Open", PREDICATE], ["cabinet", ARGUMENT], [".drawer", "variable.other.property"]]],
  "predicates in a list": ["relations: [OnTop(a, b), Inside(c, d)]", [["OnTop", PREDICATE], ["b", ARGUMENT], ["Inside", PREDICATE], ["d", ARGUMENT]]],
  "a quoted predicate": ['goal: {not: "OnTop(a, b)"}', [["not", "keyword.operator.logical"], ["OnTop", PREDICATE], ["a", ARGUMENT]]],
  "nested conditions": ["goal:\n  any:\n    - all: [Open(a)]", [["any", "keyword.operator.logical"], ["all", "keyword.operator.logical"], ["Open", PREDICATE]]],
  "a parameter": ["  step: $gap", [["$", "punctuation.definition.variable"], ["gap", PARAMETER]]],
  "arithmetic": ["  step: [$gap, 2 * ($gap + 0.1), -$x / 3]", [["gap", PARAMETER], ["2", NUMBER], ["*", OPERATOR], ["(", "punctuation.section.parens"], ["+", OPERATOR], ["0.1", NUMBER], ["-", OPERATOR], ["/", OPERATOR], ["3", NUMBER]]],
  "a file": ["extends: ../bases/droid.scene.yaml", [["../bases/droid.scene.yaml", FILE]]],
  "a mesh in braces": ["  cup: {asset: meshes/cup-2.glb, mass: 1}", [["meshes/cup-2.glb", FILE], ["1", NUMBER]]],
  "a color": ['  color: "#c8a070"', [["#c8a070", "constant.other.color.rgb-value"]]],
  "an angle": ["  pose: {yaw_deg: 30}", [["yaw_", KEY], ["deg", "keyword.other.unit"], ["30", NUMBER]]],
  "a unit in a comment": ["mass: 1  # density [kg/m^3]", [["1", NUMBER], ["[kg/m^3]", "keyword.other.unit"]]],
  "a quantity": ["  mass: {value: 0.3, min: 0.2, source: me}", [["value", KEY], ["0.3", NUMBER], ["me", "string.unquoted.plain"]]],
  "an anchor and an alias": ["  a: &one {mass: 1}\n  b: *one", [["one", "entity.name.type.anchor"], ["one", "variable.other.alias"]]],
  "a sentence": ["instruction: Put the cup, please: it's 2 cm off # now", [["now", "comment.line"]]],
  "null": ["  cup_3_1: null", [["null", "constant.language"]]],
  "a version is no number": ["  name: v1.2.3", [["v1.2.3", "string.unquoted.plain"]]],
  "a list of lists": ["profile: [[0, 0], [0.04, 0]]", [["0.04", NUMBER]]],
};

for (const [name, [text, expected]] of Object.entries(CASES)) test(`scopes of ${name}`, () => hasScopes(text, expected));

test("a block of text ends where its indentation ends", () => {
  const found = tokens("description: |\n  OnTop(a, b)\n\n  $gap: 1\nmass: 1");
  assert.ok(found[1]!.every((token) => token.scope === "string.unquoted.block"));
  assert.ok(found[3]!.every((token) => token.scope === "string.unquoted.block"));
  assert.equal(found[4]![0]!.scope, "keyword.other.section");
});

test("braces and brackets that are open at the end of a line go on", () => {
  const found = tokens("goal: [\n  OnTop(a, b),\n  Open(c)\n]\nname: a");
  assert.equal(found[2]![0]!.scope, PREDICATE);
  assert.deepEqual(found[4]!.map((token) => token.scopes.length), [2, 2, 2]);
});

test("an unfinished predicate does not reach the next line", () => {
  const found = tokens("goal: OnTop(cup, \nname: a");
  assert.equal(found[1]![0]!.scope, "keyword.other.section");
});

function specs(folder: string): string[] {
  return readdirSync(folder, { withFileTypes: true }).flatMap((entry) =>
    entry.isDirectory() ? specs(join(folder, entry.name)) : /\.yaml$/.test(entry.name) ? [join(folder, entry.name)] : [],
  );
}

test("every word of every document of the repository has a scope", () => {
  const files = specs(join(REPOSITORY, "specs"));
  assert.ok(files.length > 50);
  const bare: string[] = [];
  for (const file of files) {
    for (const [k, line] of tokens(readFileSync(file, "utf8")).entries()) {
      for (const token of line) {
        const inner = token.scopes.filter((scope) => !scope.startsWith("source.") && !scope.startsWith("meta."));
        if (!inner.length || inner.some((scope) => scope.startsWith("invalid"))) bare.push(`${file}:${k + 1}: ${token.text}`);
      }
    }
  }
  assert.deepEqual(bare, []);
});

test("every predicate and number of the documents is one", () => {
  const text = specs(join(REPOSITORY, "specs")).map((file) => readFileSync(file, "utf8")).join("\n");
  const written = text.split("\n").filter((line) => !line.trim().startsWith("#"));
  const expected = written.join("\n").match(/\b(?:OnTop|Inside|Open|Closed|Released|Grasped|LeftOf|RightOf)(?=\()/g)!.length;
  const found = tokens(written.join("\n")).flat().filter((token) => token.scope === PREDICATE);
  assert.ok(found.length >= expected && expected > 50, `${found.length} of ${expected}`);
  const strings = tokens(written.join("\n")).flat().filter((token) => token.scope === "string.unquoted.plain");
  assert.deepEqual(strings.map((token) => token.text).filter((word) => /^[-+]?[0-9.]+$/.test(word)), []);
});
