"""Every finding, as a user reads it: a small bad input and its exact text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.lint.lints import lint
from simfoundry.scene.lower import lower
from simfoundry.spec.check.pages import titles
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, render
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from tests.frontends.usd.stages import project

BAD = Path(__file__).parent / "bad"
CASES = sorted(p.name for p in BAD.glob("*.yaml"))


def too_large(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(200 * 2**20)


def not_utf8(path: Path) -> None:
    path.write_bytes(b"simfoundry: scene/1\nname: caf\xe9\n")


def with_nul(path: Path) -> None:
    path.write_bytes(b"simfoundry: scene/1\nname: a\0b\n")


def with_markers(path: Path) -> None:
    sides = [f"  cup: {{shape: {{sphere: {r}}}, mass: 0.2}}" for r in (0.04, 0.05)]
    lines = [
        "simfoundry: scene/1",
        "name: bad",
        "objects:",
        "<" * 7 + " HEAD",
        sides[0],
        "=" * 7,
        sides[1],
        ">" * 7 + " x",
    ]
    path.write_text("\n".join([*lines, "relations: [", ""]))


def edited_stage(path: Path) -> None:
    import simfoundry.cli  # noqa: F401 - the command line reads stages

    made = project(path.parent)
    stage = made.edit()
    stage.GetPrimAtPath("/World/Objects/cabinet/tray").GetAttribute("physics:mass").Set(9.0)
    made.save(stage).rename(path)


MADE: dict[str, Callable[[Path], object]] = {
    "SF001_absent.scene.yaml": Path.exists,
    "SF001_folder.scene.yaml": Path.mkdir,
    "SF001_latin1.scene.yaml": not_utf8,
    "SF002_nul.scene.yaml": with_nul,
    "SF005_too_large.scene.yaml": too_large,
    "SF209_markers_of_git.scene.yaml": with_markers,
    "SF421_mass_of_a_link.usda": edited_stage,
}


def findings_of(path: Path, root: Path) -> list[Diagnostic]:
    """What checking, linting and then lowering a document finds."""
    loaded = load(path, root)
    found = [*loaded.all_findings(), *lint(loaded)]
    if isinstance(loaded.spec, SceneSpec) and not loaded.errors:
        try:
            lower(loaded)
        except SpecError as error:
            return list(dict.fromkeys([*found, *error.diagnostics]))  # lints find some of these too
    return found


def compare(name: str, findings: list[Diagnostic], root: Path, update: bool) -> None:
    golden = BAD / Path(name).with_suffix(".txt").name
    shown = render(findings).replace(str(root), "<project>") + "\n"
    if update:
        golden.write_text(shown)
    assert shown == golden.read_text()


@pytest.mark.parametrize("name", CASES)
def test_bad_document_is_explained(name: str, update_goldens: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(BAD)
    findings = findings_of(Path(name), BAD)
    compare(name, findings, BAD, update_goldens)
    if name.startswith("SF"):
        assert name[:5] in {d.code for d in findings}


@pytest.mark.parametrize("name", MADE)
def test_bad_file_is_explained(
    name: str, update_goldens: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    MADE[name](Path(name))
    findings = findings_of(Path(name), tmp_path)
    compare(name, findings, tmp_path, update_goldens)
    assert name[:5] in {d.code for d in findings}


def test_every_code_of_documents_and_meshes_has_an_example() -> None:
    explained = {name[:5] for name in (*CASES, *MADE)}
    assert {code for code in titles() if code < "SF500"} - explained == set()
    assert {code for code in explained if code.startswith("SF")} <= set(titles())


def test_no_golden_is_left_over() -> None:
    assert {p.name for p in BAD.glob("*.txt")} == {Path(n).with_suffix(".txt").name for n in (*CASES, *MADE)}


def test_only_lints_are_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(BAD)
    for name in CASES:
        for d in findings_of(Path(name), BAD):
            assert (d.severity is Severity.WARNING) == d.code.startswith("SF4"), d
