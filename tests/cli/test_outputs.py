"""No command replaces what a person made or edited, and what cannot be written ends in one sentence."""

from __future__ import annotations

import io
import shutil
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from simfoundry.runtime.files import MARK, ensure_replaceable, is_generated
from tests.cli.command import MAIN, Done, python, run
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: desk
viewpoint: front
materials:
  wood: {density: 700, friction: 0.5}
objects:
  table: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  cube: {shape: {box: [0.05, 0.05, 0.05]}, material: wood, pose: {xyz: [0.1, 0, 0.025]}}
cameras:
  front: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-0.8, 0, 0.5], look_at: [0, 0, 0]}}
"""

TABLE = "task,policy,successes,rollouts\nlift,a,3,5\nlift,b,1,5\n"

MINE = "a file of mine, whatever it is called\n"


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("desk.scene.yaml", "other.scene.yaml"):
        (tmp_path / name).write_text(SCENE)
    for name in ("real.csv", "sim.csv"):
        (tmp_path / name).write_text(TABLE)
    return tmp_path


WRITERS = {
    "render": ("desk.scene.yaml", "--engine", "raycast", "-o"),
    "diff": ("desk.scene.yaml", "other.scene.yaml", "--format", "html", "-o"),
    "settle": ("desk.scene.yaml", "-o"),
    "merge": ("desk.scene.yaml", "desk.scene.yaml", "other.scene.yaml", "-o"),
    "flatten": ("desk.scene.yaml", "-o"),
    "correlate": ("real.csv", "sim.csv", "--svg"),
    "verify": ("desk.scene.yaml", "--no-behaviors", "--engine", "usdview", "--html"),
}
"""Commands that write a file, with their arguments up to its path."""


@pytest.mark.parametrize("command", WRITERS)
def test_a_file_of_somebody_else_stays(desk: Path, command: str) -> None:
    (desk / "notes.txt").write_text(MINE)
    done = run(command, *WRITERS[command], "notes.txt")
    assert done.code == 2 and "notes.txt exists and was not generated" in done.err and "--force" in done.err
    assert (desk / "notes.txt").read_text() == MINE


@pytest.mark.parametrize("command", WRITERS)
def test_an_input_is_never_an_output(desk: Path, command: str) -> None:
    source = "real.csv" if command == "correlate" else "desk.scene.yaml"
    before = (desk / source).read_text()
    done = run(command, *WRITERS[command], source, "--force")
    assert done.code == 2 and f"{source} is an input of this command" in done.err
    assert (desk / source).read_text() == before


@pytest.mark.parametrize("command", ["render", "diff", "correlate"])
def test_what_was_generated_is_made_again_without_asking(desk: Path, command: str) -> None:
    for _ in range(2):
        assert run(command, *WRITERS[command], "out.generated").code == 0
    assert is_generated(desk / "out.generated")


def test_a_link_to_an_input_is_that_input(desk: Path) -> None:
    (desk / "link.yaml").symlink_to("desk.scene.yaml")
    done = run("flatten", "desk.scene.yaml", "-o", "link.yaml", "--force")
    assert done.code == 2 and "is an input" in done.err
    assert (desk / "desk.scene.yaml").read_text() == SCENE


def test_a_base_is_an_input(desk: Path) -> None:
    (desk / "b.scene.yaml").write_text("simfoundry: scene/1\nname: b\nextends: desk.scene.yaml\n")
    done = run("render", "b.scene.yaml", "-o", "desk.scene.yaml", "--force")
    assert done.code == 2 and "is an input" in done.err


def test_the_mark_counts_at_the_head_only(tmp_path: Path) -> None:
    about = tmp_path / "about.txt"
    about.write_text("x" * 2000 + MARK)
    assert not is_generated(about)
    ensure_replaceable(tmp_path / "absent")


def test_a_real_capture_is_not_overwritten_by_a_synthesized_one(desk: Path) -> None:
    (desk / "mine").mkdir()
    (desk / "mine" / "color.png").write_bytes(b"a photograph")
    done = run("synthesize", "desk.scene.yaml", "-o", "mine")
    assert done.code == 2 and "mine/color.png exists" in done.err
    assert (desk / "mine" / "color.png").read_bytes() == b"a photograph"


@pytest.mark.parametrize(
    ("target", "file", "advice"),
    [("usd", "scene.usda", "simfoundry import build/usd/scene.usda --onto"), ("mjcf", "load.py", "--force")],
)
def test_an_edited_build_is_kept(desk: Path, target: str, file: str, advice: str) -> None:
    assert run("compile", "desk.scene.yaml", "-t", target).code == 0
    assert run("compile", "desk.scene.yaml", "-t", target).code == 0, "what was not edited is replaced freely"
    edited = desk / "build" / target / file
    edited.write_text(edited.read_text() + "\n# an edit of mine\n")
    done = run("compile", "desk.scene.yaml", "-t", target)
    assert done.code == 2 and f"({file})" in done.err and advice in done.err
    assert edited.read_text().endswith("# an edit of mine\n")
    assert run("compile", "desk.scene.yaml", "-t", target, "--force").code == 0
    assert not edited.read_text().endswith("# an edit of mine\n")


# What cannot be read or written.


def test_an_array_that_claims_more_than_the_disk_is_a_finding(tmp_path: Path) -> None:
    folder = tmp_path / "desk"
    shutil.copytree(REPOSITORY / "specs" / "captures" / "desk", folder)
    document = folder / "capture.yaml"
    document.write_text(document.read_text().replace("image: depth.png", "image: depth.npy"))
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }".ljust(117) + "\n"
    (folder / "depth.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode())
    done = run("capture", folder, "-o", tmp_path / "out")
    assert done.code == 2 and "depth.npy could not be read as an image" in done.err and "Traceback" not in done.err


def simfoundry(*args: str, before: str = "", **env: str) -> Done:
    """Run a command in a process of its own, after some Python."""
    return python(f"{before}\n{MAIN}", *args, **env)


@pytest.mark.parametrize("as_json", [False, True], ids=["text", "json"])
def test_a_terminal_without_unicode_shows_what_it_can(desk: Path, as_json: bool) -> None:
    (desk / "desk.scene.yaml").write_text(SCENE.replace("cube:", "tasse→:"))
    done = simfoundry("check", "desk.scene.yaml", *(["--json"] if as_json else []), PYTHONIOENCODING="latin-1")
    assert done.code == 1 and "Traceback" not in done.err
    if as_json:
        assert "tasse→" in done.json["findings"][0]["message"], "JSON loses no character"
    else:
        assert "tasse?" in done.err + done.out


def test_a_document_is_never_printed_with_characters_missing(desk: Path) -> None:
    (desk / "desk.scene.yaml").write_text(SCENE.replace("name: desk", "name: desk\ndescription: Höhe → 3 cm"))
    done = simfoundry("flatten", "desk.scene.yaml", PYTHONIOENCODING="latin-1")
    assert done.code == 2 and done.out == "" and "PYTHONIOENCODING=utf-8" in done.err


@pytest.mark.skipif(sys.platform != "linux", reason="limits of file sizes are set as on Linux")
def test_a_full_disk_names_the_file(desk: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))"
    done = simfoundry("compile", "desk.scene.yaml", "-t", "usd", before=limit)
    assert done.code == 2 and "Traceback" not in done.err
    assert "scene.usda: File too large" in done.err
    assert not (desk / "build" / "usd").exists() and not list((desk / "build").glob(".build*"))


def test_arrays_of_captures_are_still_read(tmp_path: Path) -> None:
    from simfoundry.capture.load import _numpy

    stored = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.save(tmp_path / "a.npy", stored)
    read = _numpy(tmp_path / "a.npy")
    assert read.tobytes() == stored.tobytes() and type(read) is np.ndarray
    buffer = io.BytesIO()
    np.savez(buffer, stored)
    (tmp_path / "b.npy").write_bytes(buffer.getvalue())
    with pytest.raises(Exception, match="'NpzFile'"):
        _numpy(tmp_path / "b.npy")
