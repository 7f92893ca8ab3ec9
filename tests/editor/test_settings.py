"""The settings that docs/editors.md prints, in the editors themselves, each with the real language server.

An editor that is not installed is skipped, and so is a Neovim that is older than the settings.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from simfoundry.spec.models.kinds import KINDS, suffix
from tests.conftest import REPOSITORY

PAGE = REPOSITORY / "docs" / "editors.md"

# A scene with a finding that no schema can express: there is no `dsk`.
BROKEN = """\
simfoundry: scene/1
name: broken
objects:
  desk: {shape: {box: [1, 1, 0.1]}, fixed: true, pose: {xyz: [0, 0, -0.05]}}
  mug: {shape: {box: [0.1, 0.1, 0.1]}, mass: 0.3, place: {on: dsk}}
"""

# Seconds that an editor waits for the finding; it starts a server that imports the whole package.
PATIENCE = 60


def settings(language: str) -> list[str]:
    """The blocks of the page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(), re.M | re.S)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a broken scene; `simfoundry` is on the PATH, and the editors find no settings of anyone."""
    folder, programs = tmp_path / "project", tmp_path / "bin"
    folder.mkdir()
    programs.mkdir()
    (folder / "simfoundry.yaml").touch()
    (folder / "broken.scene.yaml").write_text(BROKEN)
    program = programs / "simfoundry"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m simfoundry "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))
    for name in ("HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "home"))
    return folder


def run(command: list[str], folder: Path) -> str:
    """Run an editor without a screen, and return what it prints."""
    call = {"capture_output": True, "text": True, "timeout": 2 * PATIENCE, "stdin": subprocess.DEVNULL}
    done = subprocess.run(command, cwd=folder, check=False, **call)  # type: ignore[call-overload]
    return str(done.stdout + done.stderr)


NEOVIM = """
local out = assert(io.open(arg_file, "w"))
vim.cmd.edit("broken.scene.yaml")
vim.wait(PATIENCE * 1000, function() return #vim.diagnostic.get(0) > 0 end, 50)
for _, found in ipairs(vim.diagnostic.get(0)) do
  out:write(found.lnum + 1, ":", found.col + 1, ":", found.code or "", ":", found.message, "\\n")
end
out:write("filetype:", vim.bo.filetype, "\\n")
out:close()
vim.cmd("qall!")
"""


def test_neovim_shows_the_finding(project: Path) -> None:
    nvim = shutil.which("nvim")
    if nvim is None:
        pytest.skip("Neovim is not installed")
    version = re.search(r"NVIM v(\d+)\.(\d+)", run([nvim, "--version"], project))
    if version is None or (int(version[1]), int(version[2])) < (0, 11):
        pytest.skip("the settings need Neovim 0.11 or newer")
    (printed,) = settings("lua")
    result = project.parent / "result"
    script = project.parent / "init.lua"
    script.write_text(printed + NEOVIM.replace("PATIENCE", str(PATIENCE)).replace("arg_file", json.dumps(str(result))))
    said = run([nvim, "--headless", "--clean", "-n", "-c", f"luafile {script}"], project)
    assert result.is_file(), said
    first, *_, kind = result.read_text().splitlines()
    assert re.fullmatch(r"5:63:SF\d+:.*`dsk`.*", first), first
    assert kind == "filetype:yaml.simfoundry"


EMACS = """
(find-file "broken.scene.yaml")
(run-hooks 'post-command-hook)  ; where Eglot connects; without a screen there are no commands
(with-timeout (PATIENCE)
  (while (not (FOUND)) (accept-process-output nil 0.05)))
(princ (format "mode: %s\\n" major-mode))
(SHOW)
"""

EGLOT = """
(defun found () (flymake-start) (flymake-diagnostics))
(defun show ()
  (dolist (each (flymake-diagnostics))
    (princ (format "%d:%s\\n" (line-number-at-pos (flymake-diagnostic-beg each)) (flymake-diagnostic-text each)))))
"""

LSP_MODE = """
(setq lsp-auto-guess-root t lsp-enable-file-watchers nil lsp-warn-no-matched-clients nil)
(lsp-workspace-folders-add default-directory)
(defun found () (> (hash-table-count (lsp-diagnostics)) 0))
(defun show ()
  (maphash (lambda (_ all)
             (dolist (each all)
               (princ (format "%d:%s\\n" (1+ (lsp-get (lsp-get (lsp-get each :range) :start) :line))
                              (lsp-get each :message)))))
           (lsp-diagnostics)))
"""


@pytest.mark.parametrize("client", ["eglot", "lsp-mode"])
def test_emacs_shows_the_finding(project: Path, client: str) -> None:
    emacs = shutil.which("emacs")
    if emacs is None:
        pytest.skip("Emacs is not installed")
    for package in ("yaml-mode", client):
        found = run([emacs, "--batch", "-f", "package-initialize", "--eval", f"(require '{package})"], project)
        if "Cannot open load file" in found:
            pytest.skip(f"the Emacs package {package} is not installed")
    eglot, lsp_mode = settings("elisp")
    printed = eglot if client == "eglot" else eglot.partition("(require 'eglot)")[0] + lsp_mode
    driver = (EGLOT if client == "eglot" else LSP_MODE) + EMACS.replace("FOUND", "found").replace("SHOW", "show")
    script = project.parent / "init.el"
    script.write_text(printed + driver.replace("PATIENCE", str(PATIENCE)))
    said = run([emacs, "--batch", "-f", "package-initialize", "-l", str(script)], project)
    assert "mode: simfoundry-mode" in said
    assert re.search(r"^5:.*`dsk`", said, re.M), said


def test_the_settings_name_every_kind() -> None:
    (helix,) = map(tomllib.loads, settings("toml"))
    (sublime,) = map(json.loads, settings("json"))
    suffixes = {suffix(kind) for kind in KINDS}
    assert {f"*{each}" for each in suffixes} == {entry["glob"] for entry in helix["language"][0]["file-types"]}
    assert sublime["clients"]["simfoundry"]["command"] == ["simfoundry", "lsp"]
    text = PAGE.read_text()
    for patterns in (*settings("lua"), settings("elisp")[0], text[text.index("## JetBrains") :]):
        assert all(each.split(".")[1] in patterns for each in suffixes)
