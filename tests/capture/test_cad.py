"""Objects of a capture become models of a CAD library where these explain the image better, and only there."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from simfoundry.assets.cache import Cache
from simfoundry.capture.cad.library import CadLibrary, model_name, open_library
from simfoundry.capture.cad.match import CadLookup, is_plausible, visible_area
from simfoundry.capture.inputs import examine
from simfoundry.capture.shapes.evidence import Evidence
from simfoundry.capture.shapes.fit import FittedShape, candidates, choose, fit_shape
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.synthesize import write_capture
from simfoundry.cli.capture import capture_command
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, Cylinder, Mesh, tessellate
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.scene import SceneSpec
from tests.capture.test_register_mesh import bracket, errors, evidence_of, lying


def save(folder: Path, name: str, mesh: Mesh) -> Path:
    """Write a mesh as OBJ."""
    folder.mkdir(parents=True, exist_ok=True)
    for path, data in obj_with_material(mesh, name).items():
        (folder / path).write_bytes(data)
    return folder / f"{name}.obj"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A bracket, a can and a carton, each with a file that is no model of its own."""
    out = tmp_path / "cad"
    save(out / "001_bracket", "textured", bracket())
    save(out / "001_bracket", "textured_coacd_0", tessellate(Box(np.array([0.1, 0.1, 0.1]))))
    save(out, "can", tessellate(Cylinder(0.033, 0.1)))
    save(out, "carton", tessellate(Box(np.array([0.05, 0.1, 0.16]))))
    return out


def fitted(evidence: Evidence, library: CadLibrary | None) -> FittedShape:
    """The shape of an object that is alone in its image."""
    mask = ~evidence.support.inliers
    suggest = None if library is None else CadLookup(library).candidates
    return fit_shape(evidence.frame, evidence.support, mask, 0.0, suggest=suggest)


@pytest.mark.slow
def test_an_object_becomes_the_model_that_it_is(folder: Path) -> None:
    truth = lying(90, 0, 130)
    evidence = evidence_of(bracket(), truth)
    found = fitted(evidence, open_library(folder))
    assert found.model == "bracket" and isinstance(found.geometry, Mesh)
    assert errors(found.X_WO, truth, bracket()).max() < 0.002
    assert found.alternatives and all(not each.model for each in found.alternatives)


@pytest.mark.slow
def test_an_object_that_is_no_model_stays_a_solid(folder: Path) -> None:
    ball = tessellate(Box(np.array([0.09, 0.06, 0.05])))
    evidence = evidence_of(ball, Pose.of((0, 0, 0.025)))
    found = fitted(evidence, open_library(folder))
    assert isinstance(found.geometry, Box) and not found.model
    alone = fitted(evidence, None)
    assert np.array_equal(found.geometry.size, alone.geometry.size)  # type: ignore[union-attr]
    best = choose(candidates(evidence))
    assert best.agreement.cost < min(c.cost for c in CadLookup(open_library(folder)).candidates(evidence))


def test_sizes_rule_models_out() -> None:
    evidence = evidence_of(bracket(), lying(0, 0, 20))
    assert is_plausible(evidence, MeshTemplate.of(bracket()))
    for factor in (0.4, 4.0):
        scaled = Mesh(bracket().vertices * factor, bracket().faces)
        assert not is_plausible(evidence, MeshTemplate.of(scaled))
    box = evidence_of(tessellate(Box(np.array([0.1, 0.1, 0.001]))), Pose.of((0, 0, 0.0005)))
    height = box.eye[2] / np.linalg.norm(box.eye)
    assert visible_area(box) == pytest.approx(0.01 * height, rel=0.08)  # the square, foreshortened


def test_the_models_in_a_folder(folder: Path, tmp_path: Path) -> None:
    save(folder, "broken", Mesh(bracket().vertices, bracket().faces[1:]))
    (folder / "odd.stl").write_bytes(b"solid nothing")
    shutil.copy(folder / "can.obj", folder / "can.ply.txt")
    library = open_library(folder, cache=Cache(tmp_path / "cache"))
    assert [m.name for m in library.models] == ["bracket", "broken", "can", "carton", "odd"]
    reasons = [f.message.removeprefix("the CAD model ") for f in library.findings()]
    assert reasons[0] == "broken.obj was not used: broken.obj is not closed: 3 edges have a face on only one side"
    assert reasons[1].startswith("odd.stl was not used: odd.stl ") and len(reasons) == 2
    in_other_units = [f.message for f in open_library(folder, 25.4).findings()]
    assert "the CAD model 001_bracket/textured.obj was not used: textured.obj is 4.02 m across, more than a table" in (
        in_other_units
    )
    bracket_again = MeshTemplate.of(bracket())
    kept = open_library(folder, cache=Cache(tmp_path / "cache"))
    for path in folder.rglob("*.obj"):  # what was prepared once is not read again
        path.unlink()
    found = kept.template(kept.models[0])
    assert found is not None and found.diameter == pytest.approx(bracket_again.diameter, abs=1e-4)
    assert found.silhouettes == pytest.approx(bracket_again.silhouettes, rel=1e-3)
    assert [f.message for f in kept.findings()] == [f.message for f in library.findings()]
    assert library.digest == kept.digest != open_library(folder).digest


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("003_cracker_box/google_16k/textured.obj", "cracker_box"),
        ("025_mug/textured.obj", "mug"),
        ("tools/Hammer-2.glb", "hammer_2"),
        ("cup.asset.yaml", "cup"),
        ("7/model.obj", "thing_7"),
    ],
)
def test_names_of_models(path: str, name: str) -> None:
    assert model_name(Path("/lib") / path, Path("/lib")) == name


def test_a_library_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(SimfoundryError, match="is not a folder"):
        open_library(tmp_path / "none")
    (tmp_path / "notes.txt").write_text("no mesh")
    with pytest.raises(SimfoundryError, match="contains no model"):
        open_library(tmp_path)


def test_an_asset_is_a_model(folder: Path) -> None:
    save(folder / "boxed", "part", tessellate(Box(np.array([0.04, 0.06, 0.08]))))
    text = (
        "simfoundry: asset/1\nname: boxed\nmaterials:\n  wood: {density: 650, friction: 0.5}\nlinks:\n  body:\n"
        "    material: wood\n    parts:\n      crate: {shape: {box: [0.04, 0.06, 0.08]}}\n"
        "      knob: {shape: {box: [0.02, 0.02, 0.02]}, pose: {xyz: [0, 0, 0.05]}}\n"
    )
    (folder / "boxed" / "boxed.asset.yaml").write_text(text)
    library = open_library(folder)
    assert [m.name for m in library.models] == ["bracket", "boxed", "can", "carton"]
    mesh = library.mesh(library.models[1])
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([0.04, 0.06, 0.1])


@pytest.mark.slow
def test_a_capture_takes_models_and_says_so(folder: Path, tmp_path: Path) -> None:
    evidence = evidence_of(bracket(), lying(90, 0, 130), 3)
    write_capture(tmp_path / "desk", evidence.frame)
    f, (cx, cy) = evidence.frame.K[0, 0], evidence.frame.K[:2, 2]
    document = tmp_path / "desk" / "capture.yaml"
    document.write_text(
        "simfoundry: capture/1\nname: desk\ncad: ../cad\nframes:\n  view:\n    color: color.png\n"
        f"    depth: {{image: depth.png, scale: 0.0001}}\n    camera: {{fx: {f}, fy: {f}, cx: {cx}, cy: {cy}}}\n"
    )
    out = tmp_path / "out"
    result = CliRunner().invoke(capture_command, [str(document.parent), "-o", str(out), "--json"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert result.stdout, result.output
    report = json.loads(result.stdout)
    assert set(report["objects"]) == {"bracket"}, result.output
    spec = load_scene(out / "desk.scene.yaml").spec
    assert isinstance(spec, SceneSpec)
    item = spec.objects["bracket"]
    assert item.category == "bracket" and item.asset == "meshes/bracket.obj"
    assert item.origin is not None and item.origin.note == "CAD model `bracket`"
    assert [s.state for s in examine(out) if s.stage == "shape"] == ["cached"]
    shutil.rmtree(folder / "001_bracket")
    assert [s.state for s in examine(out) if s.stage == "shape"] == ["stale"]
    other = save(tmp_path / "other", "block", tessellate(Box(np.array([0.3, 0.3, 0.3])))).parent
    arguments = [str(document.parent), "-o", str(out), "--json", "--cad", str(other)]
    result = CliRunner().invoke(capture_command, arguments)
    assert set(json.loads(result.stdout)["objects"]) != {"bracket"}
    assert [s.state for s in examine(out) if s.stage == "shape"] == ["cached"]


@pytest.mark.slow
def test_a_larger_model_does_not_sink_into_the_table(folder: Path) -> None:
    evidence = evidence_of(tessellate(Box(np.array([0.1, 0.05, 0.06]))), Pose.of((0, 0, 0.03)))
    found = fitted(evidence, open_library(folder))  # its carton of 0.05 x 0.1 x 0.16 shows the same faces, 10 cm sunk
    assert isinstance(found.geometry, Box) and not found.model
    (other,) = CadLookup(open_library(folder)).candidates(evidence)
    assert other.model != "carton" or other.cost > 0.1
