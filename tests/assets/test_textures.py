"""Pictures that meshes name, and that are not there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from simfoundry.assets.textures import texture_faults
from tests.assets.meshes import block, obj
from tests.cli.command import run
from tests.scenes import checker_png

DAE = "<COLLADA><library_images><image id='a'><init_from>{}</init_from></image></library_images></COLLADA>"


def named(folder: Path, kind: str, picture: str) -> Path:
    """A mesh file that names a picture."""
    path = folder / f"cup.{kind}"
    if kind == "obj":
        (folder / "cup.mtl").write_text(f"newmtl skin\nmap_Kd -s 1 1 1 {picture}\n")
        path.write_text("mtllib cup.mtl\nusemtl skin\n" + obj(*block((0.1, 0.1, 0.1))))
    elif kind == "dae":
        path.write_text(DAE.format(picture))
    else:
        text = json.dumps({"asset": {"version": "2.0"}, "images": [{"uri": picture}]}).encode()
        head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text)).to_bytes(4, "little")
        chunk = len(text).to_bytes(4, "little") + b"JSON" + text
        path.write_bytes(head + chunk if kind == "glb" else text)
    return path


@pytest.mark.parametrize("kind", ["obj", "dae", "glb", "gltf"])
def test_a_picture_that_is_missing_corrupt_or_outside_is_named(tmp_path: Path, kind: str) -> None:
    project = tmp_path / "project"
    project.mkdir()
    owner = "cup.mtl" if kind == "obj" else f"cup.{kind}"
    (project / "good skin.png").write_bytes(checker_png())
    (project / "cut.png").write_bytes(checker_png()[:-30])
    (tmp_path / "out.png").write_bytes(checker_png())
    assert texture_faults(named(project, kind, "good skin.png"), project) == []
    for picture, wrong in (
        ("lost.png", "does not exist"),
        ("cut.png", "is not a readable image"),
        ("../out.png", "is outside the project"),
    ):
        faults = texture_faults(named(project, kind, picture), project)
        assert faults == [f"{owner} refers to the texture {picture}, which {wrong}"]


def test_every_command_says_it(tmp_path: Path) -> None:
    (tmp_path / "simfoundry.yaml").touch()
    named(tmp_path, "obj", "lost.png")
    scene = tmp_path / "a.scene.yaml"
    scene.write_text("simfoundry: scene/1\nname: a\nobjects: {cup: {asset: cup.obj, mass: 1}}\n")
    said = "cup.mtl refers to the texture lost.png, which does not exist"
    checked = run("check", scene)
    assert "warning[SF412]" in checked.err and said in checked.err
    assert said in run("show", scene).out
    compiled = run("compile", scene, "-o", tmp_path / "build", "-t", "mjcf")
    assert compiled.code == 0 and said in compiled.out
