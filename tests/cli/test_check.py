"""What `check` and `explain` print, in every format; that nothing is lost, doubled or mixed up on the way."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.errors import SimfoundryError
from simfoundry.runtime import parallel
from simfoundry.runtime.parallel import SERIAL_TRIAL, map_parallel
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
from simfoundry.spec.yaml.text import Document, read
from tests.cli.command import MAIN, Done, python, run
from tests.conftest import REPOSITORY

GOOD = "simfoundry: scene/1\nname: good\nobjects: {cup: {shape: {sphere: 0.04}, mass: 0.2}}\n"
BAD = "simfoundry: scene/1\nname: bad\nobjects: {cup: {shape: {sphere: 0.04}, mas: 0.2}}\n"
WARNED = "simfoundry: scene/1\nname: warned\nmaterials:\n  wood: {density: 700}\n"
"""Documents without a finding, with two errors (a wrong key, no mass) and with one warning."""


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a good, a bad and a warned document, in which the commands run."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GITHUB_WORKSPACE", raising=False)
    for name, text in (("good", GOOD), ("bad", BAD), ("warned", WARNED)):
        (tmp_path / f"{name}.scene.yaml").write_text(text)
    (tmp_path / "simfoundry.yaml").touch()
    return tmp_path


# -- formats --------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("tree")
def test_text_is_that_of_a_compiler_and_sums_up() -> None:
    done = run("check")
    assert done.code == 1
    assert done.out == "1 error and 1 warning in 2 of 3 documents\n"
    assert done.err == (
        "bad.scene.yaml:3:40: error[SF101] unknown key `mas`\n"
        "      3 | objects: {cup: {shape: {sphere: 0.04}, mas: 0.2}}\n"
        "        |                                        ^\n"
        "        = did you mean `mass`?\n"
        "warned.scene.yaml:4:3: warning[SF401] nothing is made of `wood`\n"
        "      4 |   wood: {density: 700}\n"
        "        |   ^\n"
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
                "message": "nothing is made of `wood`",
                "file": "warned.scene.yaml",
                "line": 4,
                "column": 3,
                "path": "materials.wood",
                "hint": "remove it",
            }
        ],
    }
    assert run("check", "--json").out == run("check", "--format=json").out
    for way in (["--json"], ["--format", "json"], ["--format=json"]):
        nothing = run("check", "nowhere", *way)
        assert (nothing.code, nothing.err, nothing.json) == (2, "", {"error": "there is no file nowhere"})
    assert run("check", "good.scene.yaml", "--json").json["findings"] == []
    described = (REPOSITORY / "docs" / "checking.md").read_text()
    assert all(f"`{key}`" in described for key in (*done.json, *done.json["findings"][0]))


@pytest.mark.usefixtures("tree")
def test_annotations_stand_at_their_lines() -> None:
    done = run("check", "--format", "github")
    assert (done.code, done.err) == (1, "")
    assert done.out.splitlines() == [
        "::error file=bad.scene.yaml,line=3,col=40,title=SF101::unknown key `mas`%0Adid you mean `mass`?",
        "::warning file=warned.scene.yaml,line=4,col=3,title=SF401::nothing is made of `wood`%0Aremove it",
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
                        "region": {
                            "required": ["startLine", "startColumn"],
                            "additionalProperties": False,
                            "properties": {
                                "startLine": {"type": "integer", "minimum": 1},
                                "startColumn": {"type": "integer", "minimum": 1},
                            },
                        },
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
    jsonschema = pytest.importorskip("jsonschema")
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
    assert done.code == 2 and "there is no file missing.scene.yaml" in done.err
    (tree / "large.scene.yaml").write_bytes(b" " * (5 * 2**20))
    out = run("check", "--format", "github", "large.scene.yaml").out
    assert out.startswith("::error file=large.scene.yaml,title=SF005::the file has 5 MiB")
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
        bad = "".join(f"  cup_{n}: {{shape: {{sphere: 0.04}}, mass: 0.2, color: red}}\n" for n in range(40))
        (tree / f"many_{k:02}.scene.yaml").write_text(f"simfoundry: scene/1\nname: many\nobjects:\n{bad}")
    done = run("check", "--format", form)
    assert done.code == 1
    shown = done.out + done.err
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


def test_hidden_folders_are_left_out_and_where_one_stands_does_not_matter(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tree / ".venv").mkdir()
    (tree / ".venv" / "bad.scene.yaml").write_text(BAD)
    inside = tree / ".hidden" / "below"
    inside.mkdir(parents=True)
    (inside / "other.scene.yaml").write_text(GOOD)
    assert run("check").out.endswith("of 3 documents\n")
    monkeypatch.chdir(inside)
    assert run("check", "../..").out.endswith("of 3 documents\n")
    assert run("check", inside).out == "no findings in 1 document\n"


# -- documents that others use --------------------------------------------------------------------------------------

ASSET = "simfoundry: asset/1\nname: box\nlinks: {box: {parts: {a: {shape: {sphere: 0.1}}}, mass: 1, color: red}}\n"
USER = "simfoundry: scene/1\nname: user\nobjects: {box: {asset: ../assets/box.asset.yaml}}\n"


def test_what_several_scenes_use_is_reported_once(tree: Path) -> None:
    (tree / "assets").mkdir()
    (tree / "assets" / "box.asset.yaml").write_text(ASSET)
    (tree / "scenes").mkdir()
    for name in "abc":
        (tree / "scenes" / f"{name}.scene.yaml").write_text(USER)
    done = run("check", "scenes")
    assert done.err.count("SF101") == 1 and done.out == "1 error in 1 of 4 documents\n"
    assert done.err.startswith(f"{Path('assets/box.asset.yaml')}:3:60: error[SF101]")
    for k in range(3):
        overlay = f"simfoundry: scene/1\nextends: ../bad.scene.yaml\nname: overlay_{k}\n"
        (tree / "scenes" / f"overlay_{k}.scene.yaml").write_text(overlay)
    overlays = run("check", *sorted((tree / "scenes").glob("overlay_*")))
    assert overlays.out == "1 error in 1 of 4 documents\n" and overlays.err.startswith(
        "bad.scene.yaml:3:40: error[SF101]"
    )
    for path in (tree / "scenes").glob("overlay_*"):
        path.unlink()
    other = run("check", tree / "scenes", "scenes", "./scenes/../assets/box.asset.yaml")
    assert other.out == done.out and other.err.count("SF101") == 1


def test_what_several_scenes_use_is_read_once_and_anew_by_each_command(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tree / "assets").mkdir()
    (tree / "assets" / "box.asset.yaml").write_text(ASSET)
    (tree / "scenes").mkdir()
    for k in range(20):
        (tree / "scenes" / f"{k}.scene.yaml").write_text(USER)
    reads: list[str] = []

    def counted(path: Path) -> Document:
        reads.append(path.name)
        return read(path)

    monkeypatch.setattr("simfoundry.spec.load.read", counted)
    assert run("check", "scenes").out == "1 error in 1 of 21 documents\n"
    assert reads.count("box.asset.yaml") <= 2 and len(set(reads)) == 21
    (tree / "assets" / "box.asset.yaml").write_text(ASSET.replace(", color: red", ""))
    assert run("check", "scenes").out == "no findings in 21 documents\n"


# -- many documents -------------------------------------------------------------------------------------------------


def process_and_square(number: int) -> tuple[int, int]:
    time.sleep(0.002)
    return os.getpid(), number * number


PARENT = os.environ.setdefault("SIMFOUNDRY_TEST_PARENT", str(os.getpid()))


def dies_elsewhere(number: int) -> int:
    time.sleep(0.002)
    if str(os.getpid()) != PARENT:
        os._exit(1)
    return number


def test_processes_give_what_one_gives_in_the_same_order() -> None:
    heard: list[int] = []
    results = map_parallel(process_and_square, range(SERIAL_TRIAL + 200), heard.append, startup_s=0.01, processes=2)
    assert [square for _, square in results] == [n * n for n in range(SERIAL_TRIAL + 200)]
    assert heard == sorted(set(heard)) and heard[-1] == SERIAL_TRIAL + 200
    assert {pid for pid, _ in results[:SERIAL_TRIAL]} == {os.getpid()}
    assert os.getpid() not in {pid for pid, _ in results[SERIAL_TRIAL:]}


def test_no_process_is_started_for_little_work_or_on_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "_map_in_processes", lambda *_: pytest.fail("processes were started"))
    assert len(map_parallel(process_and_square, range(300), processes=8)) == 300
    assert len(map_parallel(process_and_square, range(100), startup_s=0.0, processes=1)) == 100
    assert (
        len(map_parallel(process_and_square, range(SERIAL_TRIAL - 1), startup_s=0.0, processes=8)) == SERIAL_TRIAL - 1
    )
    assert map_parallel(process_and_square, []) == []


def test_a_process_that_is_killed_is_a_sentence() -> None:
    with pytest.raises(SimfoundryError, match="ended with exit code 1"):
        map_parallel(dies_elsewhere, range(SERIAL_TRIAL + 50), startup_s=0.0, processes=2)


def test_a_large_tree_is_checked_by_processes_as_by_one(tree: Path) -> None:
    for k in range(SERIAL_TRIAL + 40):
        (tree / f"scene_{k:03}.scene.yaml").write_text(BAD if k % 7 == 3 else GOOD)
    eager = "from simfoundry.runtime.parallel import map_parallel as m\nm.__defaults__ = (m.__defaults__[0], 0.0, 2)\n"
    by_processes, alone = python(eager + MAIN, "check", "--json"), run("check", "--json")
    assert by_processes == alone
    assert alone.json["errors"] == 11 and alone.json["documents"] == SERIAL_TRIAL + 43


# -- what is loaded, and what a terminal shows ----------------------------------------------------------------------

UNNEEDED = (
    "rich",
    "multiprocessing",
    "concurrent.futures",
    "simfoundry.spec.check.pages",
    *(f"simfoundry.spec.check.report.as_{form}" for form in ("json", "sarif", "github")),
)


@pytest.mark.usefixtures("tree")
def test_checking_one_document_loads_what_it_needs() -> None:
    code = f"import atexit, sys\natexit.register(lambda: print(sorted(set({UNNEEDED!r}) & set(sys.modules))))\n{MAIN}"
    done = python(code, "check", "good.scene.yaml")
    assert done.out == "no findings in 1 document\n[]\n"


def terminal(*args: str, **env: str) -> str:
    """What a command shows on a terminal of 80 columns, as it is sent there."""
    ours, theirs = pty.openpty()
    plain = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR", "CI")}
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, *args],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={**plain, "PYTHONPATH": str(REPOSITORY), "TERM": "xterm-256color", "COLUMNS": "80", **env},
    )
    os.close(theirs)
    shown = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # Linux says so when the other end is closed
            break
        if not part:
            break
        shown += part
    os.close(ours)
    process.wait()
    return shown.decode().replace("\r\n", "\n")


@pytest.mark.usefixtures("tree")
def test_a_terminal_shows_color_unless_it_is_asked_not_to() -> None:
    shown = terminal("check", "bad.scene.yaml")
    assert "\x1b[1;31merror[SF101]\x1b[0m" in shown and "\x1b[1;31m^\x1b[0m" in shown
    plain = run("check", "bad.scene.yaml")
    more = "run `simfoundry explain SF101` for details\n"
    assert re.sub(r"\x1b\[[0-9;]*m", "", shown) == plain.err + plain.out + more
    assert "\x1b[1;33mwarning[SF401]\x1b[0m" in terminal("check", "warned.scene.yaml")
    for env in ({"NO_COLOR": "1"}, {"TERM": "dumb"}):
        assert terminal("check", "bad.scene.yaml", **env) == plain.err + plain.out + more
    assert "explain" not in terminal("check", "good.scene.yaml")
    assert "\x1b" not in plain.err + plain.out


def test_a_document_cannot_steer_the_terminal(tree: Path) -> None:
    (tree / "bad.scene.yaml").write_text(BAD.replace("mas:", '"\\e[2J\\e]0;x\\a":'))
    shown = terminal("check", "bad.scene.yaml")
    assert "\\x1b[2J" in shown and "\x1b[2J" not in shown and "\x07" not in shown


# -- explain --------------------------------------------------------------------------------------------------------


def test_explain_prints_the_page() -> None:
    done = run("explain", "sf201")
    assert done == Done(0, page("SF201").markdown, "")
    assert run("explain", "201").out == run("explain", "error[SF201]").out == done.out
    assert run("explain", "SF201", "--json").json == {
        "code": "SF201",
        "title": titles()["SF201"],
        "markdown": page("SF201").markdown,
    }


def test_explain_lists_all_codes() -> None:
    done = run("explain")
    lines = done.out.splitlines()
    assert done.code == 0 and [ln.split()[0] for ln in lines if ln.startswith("  ")] == sorted(titles())
    groups = run("explain", "--json").json["groups"]
    assert {code: title for codes in groups.values() for code, title in codes.items()} == titles()
    assert [ln for ln in lines if ln and not ln.startswith(" ")] == list(groups)


@pytest.mark.parametrize(("code", "words"), [("SF21", "did you mean"), ("SF4022", "did you mean `SF402`?")])
def test_explain_suggests_the_nearest_code(code: str, words: str) -> None:
    done = run("explain", code)
    if code == "SF21":  # a short number is a number: there is no SF021
        assert "there is no code `SF21`" in done.err
    assert done.code == 2 and done.out == "" and words in done.err
    assert words in run("explain", code, "--json").json["error"]


def test_explain_says_how_to_list_codes_where_none_is_near() -> None:
    assert "`simfoundry explain` lists all" in run("explain", "help").err


def test_explain_is_laid_out_on_a_terminal() -> None:
    shown = terminal("explain", "SF402")
    plain = re.sub(r"\x1b\[[0-9;]*m", "", shown)
    assert "\x1b[" in shown and "**" not in plain and "```" not in plain
    assert "SF402 an implausible density" in plain and "mass: 200" in plain
    assert max(map(len, plain.splitlines())) <= 80
    assert terminal("explain", "SF402", NO_COLOR="1") == page("SF402").markdown
