"""The extension for VS Code: the file that is installed, its parts, and its own tests, which run in Node."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

import simfoundry
from editors.npm import NoPackagesError, install
from editors.vscode.build import HERE, build, bundle, check_types, run
from simfoundry.spec.models.kinds import KINDS, suffix
from tests.conftest import REPOSITORY

MANIFEST: dict[str, Any] = json.loads((HERE / "package.json").read_text())

# Installing its packages takes half a minute; `.ci/run` runs these tests after it has built the extension.
pytestmark = pytest.mark.slow

# The extension with its client is about 110 kB; a megabyte would be sources or packages that do not belong in it.
LARGEST = 300_000


@pytest.fixture(scope="module")
def modules() -> Path:
    """The packages that build the extension; the tests are skipped where they cannot be had."""
    try:
        return install(HERE, REPOSITORY / "build")
    except NoPackagesError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def vsix(modules: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built extension."""
    assert modules.is_dir()
    return build(tmp_path_factory.mktemp("vsix"))


# -- the file that is installed -------------------------------------------------------------------------------------


def test_the_file_contains_what_it_needs_and_nothing_else(vsix: Path) -> None:
    with zipfile.ZipFile(vsix) as archive:
        names = {name.removeprefix("extension/") for name in archive.namelist()}
        manifest = json.loads(archive.read("extension/package.json"))
        text = b"".join(archive.read(name) for name in archive.namelist())
    code = {"extension.js", "page.js", "NOTICES.txt"}
    data = {"icon.png", "language-configuration.json", "package.json", "snippets.json", "LICENSE.txt", "readme.md"}
    assert (
        names == {"[Content_Types].xml", "extension.vsixmanifest", "syntaxes/simfoundry.tmLanguage.json"} | code | data
    )
    assert vsix.stat().st_size < LARGEST
    assert not {"devDependencies", "scripts", "private"} & set(manifest)
    assert str(REPOSITORY).encode() not in text and b"sourceMappingURL" not in text


def test_the_file_states_the_licenses_of_what_it_contains(vsix: Path) -> None:
    with zipfile.ZipFile(vsix) as archive:
        assert archive.read("extension/LICENSE.txt") == (REPOSITORY / "LICENSE").read_bytes()
        notices = archive.read("extension/NOTICES.txt").decode()
    for package in ("vscode-languageclient", "vscode-jsonrpc", "semver", "minimatch"):
        assert re.search(rf"^{package} \d", notices, re.MULTILINE), package


def test_every_part_that_the_manifest_names_is_in_the_file(vsix: Path) -> None:
    with zipfile.ZipFile(vsix) as archive:
        names = set(archive.namelist())
    named = re.findall(r'"\./([^"]+)"', json.dumps(MANIFEST)) + [MANIFEST["icon"]]
    assert {f"extension/{name}" for name in named} <= names


def test_two_builds_are_equal(vsix: Path, tmp_path: Path) -> None:
    assert build(tmp_path).read_bytes() == vsix.read_bytes()


# -- the manifest ---------------------------------------------------------------------------------------------------


def test_the_version_is_that_of_the_package() -> None:
    assert MANIFEST["version"] == simfoundry.__version__


def test_every_kind_of_document_is_of_the_language() -> None:
    language = MANIFEST["contributes"]["languages"][0]
    assert language["extensions"] == [suffix(kind) for kind in sorted(KINDS, key=_order)]
    assert language["filenames"] == ["capture.yaml", "simfoundry.yaml"]


def _order(kind: str) -> int:
    return [".scene", ".task", ".asset", ".capture", ".cousins", ".policy", ".dataset"].index(
        f".{kind.partition('/')[0]}"
    )


def test_every_command_is_registered() -> None:
    code = (HERE / "src" / "extension.ts").read_text()
    commands = {command["command"] for command in MANIFEST["contributes"]["commands"]}
    assert set(re.findall(r'registerCommand\("([\w.]+)"', code)) == commands


def test_findings_of_the_command_line_are_recognized(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text("simfoundry: scene/1\nname: a\nmas: 1\n")
    command = [sys.executable, "-m", "simfoundry", "check", "."]  # as the task of the extension runs it
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    pattern = MANIFEST["contributes"]["problemMatchers"][0]["pattern"]
    lines = (done.stdout + done.stderr).splitlines()
    (match,) = [found for line in lines if (found := re.match(pattern["regexp"], line))]
    assert match[pattern["line"]] == "3"
    assert (tmp_path / match[pattern["file"]]).samefile(path)
    assert (match[pattern["severity"]], match[pattern["code"]]) == ("error", "SF101")
    assert match[pattern["message"]] == "unknown key `mas`"


def test_packages_are_pinned_and_no_registry_is_named() -> None:
    packages = json.loads((HERE / "package-lock.json").read_text())["packages"]
    wanted = MANIFEST["devDependencies"]
    assert packages.pop("")["devDependencies"] == wanted
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in wanted.values())
    assert {name: packages[f"node_modules/{name}"]["version"] for name in wanted} == wanted
    assert all(entry["integrity"].startswith("sha512-") for entry in packages.values())
    assert not any("resolved" in entry for entry in packages.values())


# -- its own tests --------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("modules")
def test_its_types_hold() -> None:
    check_types()


def test_its_own_tests_pass_in_node(modules: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Grammar in the engine of VS Code, finding and starting the real server, and the preview."""
    program = tmp_path / "simfoundry"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m simfoundry "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("SIMFOUNDRY_COMMAND", str(program))
    monkeypatch.setenv("SIMFOUNDRY_REPOSITORY", str(REPOSITORY))
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))
    monkeypatch.setenv("NODE_PATH", str(modules))
    bundle(tmp_path / "tests", "--tests")
    said = run(["node", "--test", *map(str, sorted((tmp_path / "tests").glob("*.test.js")))], tmp_path)
    assert int(re.findall(r"^[#ℹ] pass (\d+)$", said, re.MULTILINE)[-1]) >= 50
    assert re.findall(r"^[#ℹ] (?:fail|skipped) (\d+)$", said, re.MULTILINE) == ["0", "0"]
