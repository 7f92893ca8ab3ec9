"""The formats of `check`: text, JSON, annotations of GitHub and SARIF; no finding is lost or doubled."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.check.pages import page, titles
from simfoundry.spec.check.report import (
    FORMATS,
    Checked,
    CheckReport,
    gather,
    render_github,
    render_text,
    renderer,
)
from simfoundry.spec.diagnostics import Diagnostic, Severity
from tests.cli.command import Done, run
from tests.cli.documents import BAD
from tests.conftest import REPOSITORY


@pytest.mark.usefixtures("tree")
def test_text_is_that_of_a_compiler_and_sums_up() -> None:
    done = run("check")
    assert done.code == 1
    assert done.out == "1 error and 1 warning in 2 of 3 documents\n"
    assert done.err == (
        "bad.scene.yaml:3:40: error[SF101] unknown key `mas`\n"
        "      3 | objects: {cup: {shape: {sphere: 0.04}, mas: 0.2}}\n"
        "        |                                        ^^^\n"
        "        = did you mean `mass`?\n"
        "warned.scene.yaml:4:3: warning[SF401] the `wood` material is not used\n"
        "      4 |   wood: {density: 700}\n"
        "        |   ^^^^\n"
        "        = remove it\n"
    )
    assert run("check", "good.scene.yaml") == Done(0, "no findings in 1 document\n", "")
    assert run("check", "warned.scene.yaml").out == "1 warning in 1 document\n"


@pytest.mark.usefixtures("tree")
def test_json_has_the_shape_that_is_promised() -> None:
    done = run("check", "warned.scene.yaml", "good.scene.yaml", "--format", "json")
    assert (done.code, done.err) == (1, "")
    assert done.json == {
        "files": ["warned.scene.yaml", "good.scene.yaml"],
        "documents": 2,
        "errors": 0,
        "warnings": 1,
        "findings": [
            {
                "code": "SF401",
                "severity": "warning",
                "message": "the `wood` material is not used",
                "file": "warned.scene.yaml",
                "line": 4,
                "column": 3,
                "path": "materials.wood",
                "hint": "remove it",
                "word": "wood",
                "fixes": [],
            }
        ],
    }
    assert run("check", "--json").out == run("check", "--format=json").out
    for way in (["--json"], ["--format", "json"], ["--format=json"]):
        nothing = run("check", "nowhere", *way)
        assert (nothing.code, nothing.err, nothing.json) == (2, "", {"error": "nowhere does not exist"})
    assert run("check", "good.scene.yaml", "--json").json["findings"] == []
    described = (REPOSITORY / "docs" / "checking.md").read_text()
    assert all(f"`{key}`" in described for key in (*done.json, *done.json["findings"][0]))


@pytest.mark.usefixtures("tree")
def test_annotations_stand_at_their_lines() -> None:
    done = run("check", "--format", "github")
    assert (done.code, done.err) == (1, "")
    assert done.out.splitlines() == [
        "::error file=bad.scene.yaml,line=3,col=40,endColumn=43,title=SF101::unknown key `mas`%0Adid you mean `mass`?",
        "::warning file=warned.scene.yaml,line=4,col=3,endColumn=7,title=SF401::"
        "the `wood` material is not used%0Aremove it",
        "1 error and 1 warning in 2 of 3 documents",
    ]
    assert run("check", "good.scene.yaml", "--format", "github").out == "no findings in 1 document\n"


def test_annotations_count_from_the_checkout(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tree / "below").mkdir()
    monkeypatch.chdir(tree / "below")
    assert "file=../" not in run("check", "..", "--format", "github").out
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tree))
    assert "::error file=bad.scene.yaml,line=3," in run("check", "..", "--format", "github").out
    assert sarif(run("check", "..", "--format", "sarif"))["results"][0]["locations"][0]["physicalLocation"][
        "artifactLocation"
    ] == {"uri": "bad.scene.yaml", "uriBaseId": "%SRCROOT%"}


ANY = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=20)


@given(message=ANY, hint=ANY, file=ANY.filter(lambda t: "/" not in t and t not in (".", "..")), line=st.integers(0, 9))
def test_no_text_breaks_out_of_an_annotation(message: str, hint: str, file: str, line: int) -> None:
    finding = Diagnostic("SF101", Severity.ERROR, message, file, line, line, "", hint)
    text = render_github(CheckReport((file,), 1, (finding,)))
    match = re.fullmatch(r"::error ([^:]*)::([^\r\n]*)", text)
    assert match is not None
    properties = dict(part.split("=", 1) for part in match[1].split(","))
    place = {"line": str(line), "col": str(line)} if line else {}
    assert {k: unquote(v) for k, v in properties.items()} == {"file": file, **place, "title": "SF101"}
    assert match[2].replace("%0A", "\n").replace("%0D", "\r").replace("%25", "%") == f"{message}\n{hint}"


TEXT_OF = {"type": "object", "properties": {"text": {"type": "string", "minLength": 1}}, "required": ["text"]}
SARIF = {
    "type": "object",
    "required": ["version", "runs", "$schema"],
    "additionalProperties": False,
    "properties": {
        "$schema": {"type": "string", "pattern": "^https://.*sarif-schema-2\\.1\\.0\\.json$"},
        "version": {"const": "2.1.0"},
        "runs": {"type": "array", "minItems": 1, "items": {"$ref": "#/$defs/run"}},
    },
    "$defs": {
        "run": {
            "type": "object",
            "required": ["tool", "results", "columnKind"],
            "additionalProperties": False,
            "properties": {
                "tool": {
                    "type": "object",
                    "required": ["driver"],
                    "properties": {"driver": {"$ref": "#/$defs/driver"}},
                },
                "columnKind": {"enum": ["utf16CodeUnits", "unicodeCodePoints"]},
                "originalUriBaseIds": {
                    "type": "object",
                    "additionalProperties": {"properties": {"description": TEXT_OF}},
                },
                "results": {"type": "array", "items": {"$ref": "#/$defs/result"}},
            },
        },
        "driver": {
            "type": "object",
            "required": ["name", "rules", "semanticVersion"],
            "properties": {
                "name": {"const": "SimFoundry"},
                "semanticVersion": {"pattern": r"^\d+\.\d+\.\d+"},
                "rules": {"type": "array", "uniqueItems": True, "items": {"$ref": "#/$defs/rule"}},
            },
        },
        "rule": {
            "type": "object",
            "required": ["id", "shortDescription", "fullDescription", "help", "defaultConfiguration"],
            "additionalProperties": False,
            "properties": {
                "id": {"pattern": "^SF[0-9]{3}$"},
                "shortDescription": TEXT_OF,
                "fullDescription": TEXT_OF,
                "help": {**TEXT_OF, "required": ["text", "markdown"]},
                "defaultConfiguration": {"properties": {"level": {"enum": ["none", "note", "warning", "error"]}}},
            },
        },
        "result": {
            "type": "object",
            "required": ["ruleId", "ruleIndex", "level", "message", "locations"],
            "additionalProperties": False,
            "properties": {
                "ruleId": {"pattern": "^SF[0-9]{3}$"},
                "ruleIndex": {"type": "integer", "minimum": 0},
                "level": {"enum": ["none", "note", "warning", "error"]},
                "message": TEXT_OF,
                "locations": {"type": "array", "minItems": 1, "maxItems": 1, "items": {"$ref": "#/$defs/location"}},
                "fixes": {"type": "array", "minItems": 1, "items": {"$ref": "#/$defs/fix"}},
            },
        },
        "fix": {
            "type": "object",
            "required": ["description", "artifactChanges"],
            "additionalProperties": False,
            "properties": {
                "description": TEXT_OF,
                "artifactChanges": {
                    "type": "array",
                    "minItems": 1,
                    "items": {
                        "type": "object",
                        "required": ["artifactLocation", "replacements"],
                        "additionalProperties": False,
                        "properties": {
                            "artifactLocation": {"required": ["uri"]},
                            "replacements": {
                                "type": "array",
                                "minItems": 1,
                                "items": {
                                    "type": "object",
                                    "required": ["deletedRegion", "insertedContent"],
                                    "additionalProperties": False,
                                    "properties": {
                                        "deletedRegion": {"$ref": "#/$defs/region"},
                                        "insertedContent": TEXT_OF,
                                    },
                                },
                            },
                        },
                    },
                },
            },
        },
        "region": {
            "required": ["startLine", "startColumn"],
            "additionalProperties": False,
            "properties": {
                "startLine": {"type": "integer", "minimum": 1},
                "startColumn": {"type": "integer", "minimum": 1},
                "endColumn": {"type": "integer", "minimum": 2},
            },
        },
        "location": {
            "type": "object",
            "required": ["physicalLocation"],
            "additionalProperties": False,
            "properties": {
                "physicalLocation": {
                    "type": "object",
                    "required": ["artifactLocation"],
                    "additionalProperties": False,
                    "properties": {
                        "artifactLocation": {"properties": {"uri": {"type": "string", "format": "uri-reference"}}},
                        "region": {"$ref": "#/$defs/region"},
                    },
                },
                "logicalLocations": {"type": "array", "items": {"required": ["fullyQualifiedName"]}},
            },
        },
    },
}
"""What SARIF 2.1.0 asks of the properties that are written here; no others are."""


def sarif(done: Done) -> Any:
    """The only run of a SARIF report, which must hold what the standard asks."""
    assert done.err == ""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema validates the SARIF output in development only")
    jsonschema.Draft202012Validator(SARIF).validate(done.json)
    return done.json["runs"][0]


def test_sarif_holds_every_finding_with_the_page_of_its_rule(tree: Path) -> None:
    odd = "odd, 100% näme#1.scene.yaml"
    (tree / "x y").mkdir()
    (tree / "x y" / odd).write_text(BAD.replace("objects", "# 🍵\nobjects").replace("{sphere", "{ sphere"))
    (tree / "bytes.scene.yaml").write_bytes(b"\xff")
    (tree / "folder.scene.yaml").mkdir()
    found = sarif(run("check", "--format", "sarif"))
    rules = found["tool"]["driver"]["rules"]
    assert [r["id"] for r in rules] == sorted(titles())
    for rule in rules:
        assert rule["shortDescription"]["text"] == titles()[rule["id"]]
        assert rule["help"]["markdown"] == page(rule["id"]).body
    places = []
    for result in found["results"]:
        assert rules[result["ruleIndex"]]["id"] == result["ruleId"]
        assert rules[result["ruleIndex"]]["defaultConfiguration"]["level"] == result["level"]
        place = result["locations"][0]["physicalLocation"]
        assert place["artifactLocation"]["uriBaseId"] in found["originalUriBaseIds"]
        region = place.get("region", {})
        places.append((unquote(place["artifactLocation"]["uri"]), result["ruleId"], region.get("startColumn")))
    expected = run("check", "--json").json["findings"]
    assert places == [(f["file"], f["code"], f["column"] or None) for f in expected]
    assert (f"x y/{odd}", "SF101", 41) in places
    assert re.search(r'"uri": "x%20y/odd%2C%20100%25%20n%C3%A4me%231\.scene\.yaml"', run("check", "--format=sarif").out)


def test_sarif_names_files_elsewhere_by_absolute_uris_and_takes_no_links_from_documents(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tree / "bad.scene.yaml").write_text(BAD.replace("mas:", '"[x](https://example.org)":'))
    (tree / "elsewhere").mkdir()
    monkeypatch.chdir(tree / "elsewhere")
    result = sarif(run("check", "../bad.scene.yaml", "--format", "sarif"))["results"][0]
    location = result["locations"][0]["physicalLocation"]["artifactLocation"]
    assert location == {"uri": (tree / "bad.scene.yaml").as_uri()}
    assert result["message"]["text"].startswith("unknown key `[x] (https://example.org)`")


def test_a_finding_of_a_whole_file_has_no_line(tree: Path) -> None:
    (tree / "folder").mkdir()
    (tree / "folder.scene.yaml").symlink_to(tree / "folder")
    done = run("check", "--format", "github", "missing.scene.yaml")
    assert done.code == 2 and "missing.scene.yaml does not exist" in done.err
    (tree / "large.scene.yaml").write_bytes(b" " * (5 * 2**20))
    out = run("check", "--format", "github", "large.scene.yaml").out
    assert out.startswith("::error file=large.scene.yaml,title=SF005::the file is 5 MiB")
    region = sarif(run("check", "--format", "sarif", "large.scene.yaml"))["results"][0]["locations"][0]
    assert "region" not in region["physicalLocation"] and "logicalLocations" not in region


@given(st.randoms(use_true_random=False))
def test_findings_come_in_one_order_however_they_were_found(random: Any) -> None:
    alike = [Diagnostic("SF101", Severity.ERROR, "no", "a.yaml", 1, 1, path, hint) for path in "pqr" for hint in "xyz"]
    shuffled = [*alike, *alike]
    random.shuffle(shuffled)
    parts = [Checked(tuple(shuffled[:5])), Checked(tuple(shuffled[5:]))]
    assert list(gather(["a.yaml"], parts).findings) == alike


@pytest.mark.parametrize("form", FORMATS)
def test_long_lists_are_shown_whole_and_every_run_is_alike(tree: Path, form: str) -> None:
    for k in range(12):
        bad = "".join(f"  cup_{n}: {{shape: {{sphere: 0.04}}, mass: 0.2, colour: red}}\n" for n in range(40))
        (tree / f"many_{k:02}.scene.yaml").write_text(f"simfoundry: scene/1\nname: many\nobjects:\n{bad}")
    done = run("check", "--format", form)
    assert done.code == 1
    shown = done.out + done.err
    if form == "sarif":  # each fix names the file once more
        shown = "".join(json.dumps(result["locations"]) for result in sarif(done)["results"])
    assert [shown.count(f"many_{k:02}.scene.yaml") - (form == "json") for k in range(12)] == [40] * 12
    assert run("check", "--format", form) == done
    if form in ("text", "github"):
        assert done.out.endswith("481 errors and 1 warning in 14 of 15 documents\n")


@pytest.mark.usefixtures("tree")
def test_a_format_that_does_not_exist_is_named() -> None:
    done = run("check", "--format", "sarf")
    assert done.code == 2 and "'sarif'" in done.err and done.out == ""


def test_every_format_renders_by_itself() -> None:
    report = gather(["a.yaml"], [Checked((Diagnostic("SF101", Severity.ERROR, "no", "a.yaml"),))])
    assert {form: "SF101" in renderer(form)(report) for form in FORMATS} == dict.fromkeys(FORMATS, True)
    assert render_text(CheckReport(("a.yaml",), 1, ())) == "no findings in 1 document"
