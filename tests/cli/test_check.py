"""The documents that `check` finds and reads, what it loads for them, and what it prints on a terminal."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from simfoundry.runtime.parallel import SERIAL_TRIAL
from simfoundry.spec.yaml.text import Document, parse
from tests.cli.command import MAIN, python, run, terminal
from tests.cli.documents import BAD, GOOD


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

ASSET = "simfoundry: asset/1\nname: box\nlinks: {box: {parts: {a: {shape: {sphere: 0.1}}}, mass: 1, colour: red}}\n"
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

    def counted(text: str, file: str) -> Document:
        reads.append(Path(file).name)
        return parse(text, file)

    monkeypatch.setattr("simfoundry.spec.yaml.text.parse", counted)
    assert run("check", "scenes").out == "1 error in 1 of 21 documents\n"
    assert reads.count("box.asset.yaml") <= 2 and len({*reads} - {"simfoundry.yaml"}) == 21
    (tree / "assets" / "box.asset.yaml").write_text(ASSET.replace(", colour: red", ""))
    assert run("check", "scenes").out == "no findings in 21 documents\n"


# -- many documents -------------------------------------------------------------------------------------------------


@pytest.mark.slow  # 2 s
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


@pytest.mark.slow  # 3 s
@pytest.mark.usefixtures("tree")
def test_a_terminal_shows_color_unless_it_is_asked_not_to() -> None:
    shown = terminal("check", "bad.scene.yaml")
    assert "\x1b[1;31merror[SF101]\x1b[0m" in shown and "\x1b[1;31m^^^\x1b[0m" in shown
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
