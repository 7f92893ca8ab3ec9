"""What a stranger reads and runs first: documents that hold, commands that exist, imports that are light."""

from __future__ import annotations

import ast
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import simfoundry
from simfoundry.cli.main import COMMANDS
from simfoundry.scene.lower import lower
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.spec.editor.reference import reference
from simfoundry.spec.files import MESH_SUFFIXES, PANORAMA_SUFFIXES, PICTURE_SUFFIXES
from simfoundry.spec.generated import generated, main, stale
from simfoundry.spec.load import load
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse
from simfoundry.splats.files import splat_bytes
from tests.conftest import of_the_checkout
from tests.scenes import checker_png
from tests.splats.random_splats import random_splat

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
HEAVY = PYPROJECT["tool"]["ruff"]["lint"]["flake8-tidy-imports"]["banned-module-level-imports"]

by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def documents(page: Path) -> list[dict[str, Any]]:
    """The fenced documents of a page, each with its ``text``."""
    blocks = re.findall(r"^```yaml\n(simfoundry:.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    return [{**parse(text).data, "text": text} for text in blocks]


# The smallest images of some formats.
PICTURES = {".png": checker_png(), ".hdr": b"#?RADIANCE\n\n-Y 1 +X 1\n\x80\x80\x80\x80"}
SPLATS = {".spz": splat_bytes(random_splat(3, 0, 0), "a.spz")}


def files_named(data: Any) -> set[str]:
    """Meshes, splats and pictures that a document refers to."""
    match data:
        case dict():
            return set().union(*(files_named(v) for v in data.values()))
        case tuple() | list():
            return set().union(*(files_named(v) for v in data))
        case str() if data.endswith((*MESH_SUFFIXES, *PICTURE_SUFFIXES, *PANORAMA_SUFFIXES, *SPLATS)):
            return {data}
    return set()


@by_page
def test_documents_in_the_pages_are_without_findings(page: Path, tmp_path: Path) -> None:
    shown = documents(page)
    paths = []
    for document in shown:
        kind = document["simfoundry"].split("/")[0]
        paths.append(tmp_path / f"{document['name']}.{kind}.yaml")
        paths[-1].write_text(document["text"])
        for name in files_named(document):
            (tmp_path / name).write_bytes((PICTURES | SPLATS).get(Path(name).suffix, b""))
    for path in paths:
        loaded = load(path)
        assert [(d.code, d.line, d.message) for d in loaded.all_findings()] == []
        if isinstance(loaded.spec, SceneSpec):
            scene = lower(loaded)
            assert [o.name for o in scene.objects] == list(loaded.spec.objects)


def test_the_pages_show_documents_of_every_kind() -> None:
    kinds = {str(d["simfoundry"]) for d in documents(ROOT / "README.md")}
    assert kinds == {"scene/1"}
    assert {d["simfoundry"] for d in documents(ROOT / "docs" / "reference.md")} == set(KINDS)


@of_the_checkout
@by_page
def test_links_lead_somewhere(page: Path) -> None:
    headings = {re.sub(r"[^\w -]", "", h).lower().replace(" ", "-") for h in _headings(page)}
    for target in re.findall(r"(?<!!)\[[^\]]*\]\(([^)]+)\)", page.read_text()):
        if target.startswith("#"):
            assert target[1:] in headings, f"{page.name} has no heading for {target}"
        elif "://" not in target:
            assert (page.parent / target.partition("#")[0]).exists(), f"{page.name} links to {target}"


def _headings(page: Path) -> list[str]:
    return re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)


def test_the_readme_starts_with_two_commands_that_make_knows() -> None:
    first = re.search(r"^```sh\n(.*?)^```", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE)
    assert first is not None
    commands = [line.partition("#")[0].strip() for line in first[1].splitlines()]
    assert commands == ["make demo", "make test"]
    assert commands[1] in (ROOT / ".ci" / "run").read_text().splitlines()


def test_every_make_target_is_listed_and_every_mention_exists() -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z]+):", makefile, re.MULTILINE))
    phony = re.search(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    assert phony is not None
    assert targets == set(phony[1].split())
    told = subprocess.run(
        ["make", "--no-print-directory", "help"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert {line.split()[1] for line in told.splitlines()} == targets
    for page in PAGES:
        assert set(re.findall(r"`make ([a-z]+)`", page.read_text())) <= targets, page.name


@by_page
def test_commands_in_the_pages_exist(page: Path) -> None:
    mentioned = set(re.findall(r"(?:`|bin/)simfoundry ([a-z]+)", page.read_text()))
    assert mentioned <= set(COMMANDS)


def test_an_old_python_is_refused_in_a_sentence(tmp_path: Path) -> None:
    old = tmp_path / "python3"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo Python 3.9.1 && exit 0\nexit 1\n')
    old.chmod(0o755)
    done = subprocess.run(
        ["make", f"PYTHON={old}", f"VENV={tmp_path / 'venv'}", "test"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode != 0
    assert f"SimFoundry needs Python 3.11 or newer, and `{old}` is Python 3.9.1." in done.stdout
    assert not (tmp_path / "venv").exists()


def test_files_name_no_machine_and_no_registry() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("this copy is not a git checkout, so its own files are not known")
    places = re.compile(rb"(?<![\w.])/(?:work|root|tmp/\w+|home/\w+)/|python[h]osted|pypi\.(?:org|io)")
    found = {}
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        match = places.search(path.read_bytes()) if path.is_file() else None
        if match is not None:
            found[name] = match[0].decode()
    assert found == {}


def test_importing_everything_loads_nothing_heavy() -> None:
    code = (
        "import importlib, pkgutil, sys, simfoundry\n"
        "for module in pkgutil.walk_packages(simfoundry.__path__, 'simfoundry.'):\n"
        "    importlib.import_module(module.name)\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "simfoundry" in loaded.split()
    assert set(loaded.split()) & set(HEAVY) == set()


def test_checking_a_document_does_not_load_numpy() -> None:
    code = "import sys, simfoundry.spec.load; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_the_changelog_leads_with_this_version() -> None:
    heading = re.search(r"^## \[(.+?)\](?: - (\S+))?$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert heading is not None
    assert simfoundry.__version__ == (heading[2] if heading[1] == "Unreleased" else heading[1])


def test_every_dependency_is_fixed_and_mujoco_is_not_the_faulty_one() -> None:
    project = PYPROJECT["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    names = {re.split(r"[<>=!;\[ ]", entry)[0].lower() for entry in needed}
    fixed = dict(re.findall(r"^([a-z0-9-]+)==(\S+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    assert names <= set(fixed)
    assert fixed["mujoco"] != "4.0.0"


@of_the_checkout
def test_every_imported_library_is_a_dependency() -> None:
    named = {"cv2": "opencv-python-headless", "PIL": "pillow", "pxr": "usd-core", "yaml": "pyyaml", "zmq": "pyzmq"}
    named |= {"pydantic_ai": "pydantic-ai-slim", "collada": "pycollada", "mcap_ros2": "mcap-ros2-support"}
    extras = PYPROJECT["project"]["optional-dependencies"]
    whole = {
        name: entries
        for name, entries in extras.items()
        if name not in ("browser", "dev", "pybullet", "drake", "newton", "sapien")
    }
    entries = [*PYPROJECT["project"]["dependencies"], *(e for listed in whole.values() for e in listed)]
    needed = {re.split(r"[<>=!;\[ ]", entry)[0].lower() for entry in entries}
    code = list((ROOT / "simfoundry").rglob("*.py"))
    imported = {
        name.partition(".")[0]
        for path in code
        for node in ast.walk(ast.parse(path.read_text()))
        for name in _imported(node)
    }
    foreign = {named.get(n, n.replace("_", "-")).lower() for n in imported - {"simfoundry"} - sys.stdlib_module_names}
    assert {"numpy", "usd-core"} <= foreign
    # pydantic_core is pydantic's own, pinned by it
    assert foreign - needed == {"pydantic-core"}


def _imported(node: ast.AST) -> list[str]:
    match node:
        case ast.Import():
            return [alias.name for alias in node.names]
        case ast.ImportFrom(module=str(module), level=0):
            return [module]
    return []


def test_the_reference_is_fresh() -> None:
    assert "docs/reference.md" not in stale(ROOT)


def test_the_reference_says_type_meaning_and_default() -> None:
    lines = reference().splitlines()
    assert "| `mass` | number > 0 or [estimate](#estimate) | Mass [kg]. | – |" in lines
    assert "| `size` | [integer 1 to 8192] × 2 | Width and height of the image [px]. | **required** |" in lines
    assert "| `fixed` | `true`, `false` | If true, the object is welded to the world. | `false` |" in lines
    assert lines.count("### Shape") == lines.count("### Pose") == 1


def test_generated_files_are_found_stale_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([]) == 2
    (tmp_path / "schemas").mkdir()
    assert main(["--check"]) == 1
    assert list(stale(tmp_path)) == list(generated())
    assert main([]) == 0
    assert main(["--check"]) == 0
    (tmp_path / "docs" / "reference.md").write_text("edited by hand")
    assert list(stale(tmp_path)) == ["docs/reference.md"]


def test_the_meshes_of_the_demo_are_what_their_script_makes() -> None:
    """Compared by shape: the letters on the textures are drawn by a font library that may change."""
    folder = ROOT / "specs" / "captures" / "desk"
    made = runpy.run_path(str(folder / "make_meshes.py"))["meshes"]()
    assert {f"{name}.obj" for name in made} == {p.name for p in (folder / "meshes").glob("*.obj")}
    for name, mesh in made.items():
        assert obj_with_material(mesh, name)[f"{name}.obj"] == (folder / "meshes" / f"{name}.obj").read_bytes()
