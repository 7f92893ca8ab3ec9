"""Every capture that cannot become a scene: a finding, exit code 2, no traceback, and earlier output as it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.capture.captures import HEIGHT, WIDTH, color, cut, edit, plane, write
from tests.cli.command import run


def _no_file(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def _random_depth(folder: Path) -> None:
    raw = np.random.default_rng(0).integers(400, 3000, (HEIGHT, WIDTH)).astype(np.uint16)
    Image.fromarray(raw).save(folder / "depth.png")


def _nothing(folder: Path) -> None:
    """A bare table is what an unspoilt capture of these tests shows."""


def _name(folder: Path) -> None:
    edit(folder, "name: desk", "name: My Desk!")


def _no_yaml(folder: Path) -> None:
    (folder / "capture.yaml").write_text("frames: [1, 2")


def _not_utf8(folder: Path) -> None:
    (folder / "capture.yaml").write_bytes(b"simfoundry: capture/1\nname: \xff\xfe\n")


def _a_scene(folder: Path) -> None:
    (folder / "capture.yaml").write_text("simfoundry: scene/1\nname: desk\n")


def _a_folder(folder: Path) -> None:
    (folder / "color.png").unlink()
    (folder / "color.png").mkdir()


def _elsewhere(folder: Path) -> None:
    edit(folder, "color.png", "/etc/color.png")


def _three_channels(folder: Path) -> None:
    Image.fromarray(color()).save(folder / "depth.png")


def _cut(folder: Path) -> None:
    cut(folder / "color.png")


BAD = {
    "no color": (_no_file("color.png"), "SF203", ":5:12", "file `color.png` does not exist"),
    "no depth": (_no_file("depth.png"), "SF203", ":7:14", "file `depth.png` does not exist"),
    "no document": (_no_file("capture.yaml"), "SF001", "capture.yaml: error", "has no capture.yaml"),
    "no YAML": (_no_yaml, "SF002", ":1:", ""),
    "not UTF-8": (_not_utf8, "SF001", ":2:7", ""),
    "a scene": (_a_scene, "SF006", ":1:1", "expected a `capture/1` document"),
    "a folder": (_a_folder, "SF203", ":5:12", "is not a file"),
    "elsewhere": (_elsewhere, "SF204", ":5:12", "is outside the project"),
    "name": (_name, "SF106", ":2:7", "My Desk!"),
    "channels": (_three_channels, "SF501", ":7:14", "3 channels"),
    "cut": (_cut, "SF501", ":5:12", "could not be read"),
    "no plane": (_random_depth, "SF503", ":4:3", "could not find a flat surface"),
    "no object": (_nothing, "SF504", ":4:3", "nothing stands out"),
}


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    """What an earlier good run left."""
    out = tmp_path / "out"
    (out / "meshes").mkdir(parents=True)
    (out / "desk.scene.yaml").write_text("simfoundry: scene/1\nname: desk\n")
    (out / "meshes" / "cup.obj").write_text("v 0 0 0\n")
    _seal(out)
    return out


def _seal(out: Path) -> None:
    from hashlib import sha256

    files = {p.relative_to(out).as_posix(): sha256(p.read_bytes()).hexdigest() for p in out.rglob("*") if p.is_file()}
    (out / "report.json").write_text(json.dumps({"files": files}))


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow  # 2 s
@pytest.mark.parametrize(("spoil", "code", "place", "message"), BAD.values(), ids=BAD)
def test_a_bad_capture_ends_in_a_finding(
    tmp_path: Path, earlier: Path, spoil: Callable[[Path], None], code: str, place: str, message: str
) -> None:
    folder, before = write(tmp_path / "capture"), tree(earlier)
    spoil(folder)
    done = run("capture", folder, "-o", earlier)
    assert done.code == 2
    assert done.out == ""
    line = done.one_line(f"error[{code}]")
    assert place in line and message in line
    assert "Traceback" not in done.err
    assert tree(earlier) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["capture", "out"]  # nothing half-done lies about

    again = run("capture", folder, "-o", earlier, "--json")
    assert again.code == 2 and again.err == ""
    assert [f["code"] for f in again.json["findings"]].count(code) == 1


def test_a_folder_without_a_document_says_what_it_must_hold(tmp_path: Path) -> None:
    import yaml

    (tmp_path / "photos").mkdir()
    done = run("capture", tmp_path / "photos", "-o", tmp_path / "out")
    assert done.code == 2 and "simfoundry schema capture" in done.err
    example = yaml.safe_load(done.err.split("`")[1])
    write(tmp_path / "photos", document=yaml.safe_dump(example, sort_keys=False), depth=plane())
    assert run("check", tmp_path / "photos").code == 0  # the example is a document


def test_a_misspelled_frame(tmp_path: Path) -> None:
    folder = write(tmp_path / "capture")
    done = run("capture", folder, "-o", tmp_path / "out", "--frame", "veiw")
    assert done.code == 2
    done.one_line("capture.yaml:3:1: error[SF201] the capture has no frame `veiw`")
    assert "did you mean `view`?" in done.err


def test_no_such_capture(tmp_path: Path) -> None:
    assert run("capture", tmp_path / "nowhere").code == 2
    assert "does not exist" in run("capture", tmp_path / "nowhere", "--json").json["error"]


# -- where the output goes ----------------------------------------------------------------------------------------


def test_files_of_others_are_not_replaced(tmp_path: Path) -> None:
    folder, out = write(tmp_path / "capture"), tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("years of work")
    done = run("capture", folder, "-o", out)
    assert done.code == 2 and "thesis.tex" in done.err and "--force" in done.err
    assert "SF504" in run("capture", folder, "-o", out, "--force").err  # goes on; this capture has no object
    assert tree(out) == {"thesis.tex": b"years of work"}


def test_a_file_added_to_earlier_output_is_not_replaced(tmp_path: Path, earlier: Path) -> None:
    """That it is still there after a good run is tested in tests/capture/test_overrides.py."""
    folder = write(tmp_path / "capture")
    (earlier / "desk.edited.scene.yaml").write_text("mine")
    assert run("capture", folder, "-o", earlier).code == 2  # this capture has no object
    assert (earlier / "desk.edited.scene.yaml").read_text() == "mine"


def test_an_edit_of_earlier_output_is_not_replaced(tmp_path: Path, earlier: Path) -> None:
    folder = write(tmp_path / "capture")
    (earlier / "desk.scene.yaml").write_text("simfoundry: scene/1\nname: my_desk\n")
    done = run("capture", folder, "-o", earlier, "--json")
    assert done.code == 2 and "edited since they were generated (desk.scene.yaml)" in done.json["error"]


@pytest.mark.parametrize("inside", ["", "deeper"])
def test_the_capture_itself_is_never_replaced(tmp_path: Path, inside: str) -> None:
    folder = write(tmp_path / "capture" / inside)
    before = tree(tmp_path)
    done = run("capture", folder, "-o", tmp_path / "capture", "--force")
    assert done.code == 2 and "contains the capture itself" in done.err
    assert tree(tmp_path) == before


def test_a_file_where_the_output_should_go(tmp_path: Path) -> None:
    folder = write(tmp_path / "capture")
    (tmp_path / "out").write_text("a file")
    assert run("capture", folder, "-o", tmp_path / "out").code == 2
    assert (tmp_path / "out").read_text() == "a file"
