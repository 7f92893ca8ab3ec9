"""A stage that nobody edited is the document that it was compiled from, in whatever file it is by now."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.usd import compile_usd
from simfoundry.frontends.usd.compiled.loading import import_usd, load_usd, read_stage
from simfoundry.frontends.usd.compiled.reading import read_spec
from simfoundry.frontends.usd.compiled.stage import StageError, open_stage
from simfoundry.scene.lower import lower, lower_file
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.shapes import CompoundShape
from simfoundry.spec.yaml.write import to_data, to_yaml
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.frontends.usd.stages import DESK, Project, project
from tests.spec.strategies import SCENES

if TYPE_CHECKING:
    from pxr import Usd

SPECS = sorted((REPOSITORY / "specs" / "scenes").glob("*.scene.yaml"))
RELATIONS = st.lists(st.sampled_from(["OnTop(a, b)", " Inside( a,b )", "At(a, 1, 2.50)", "Open(a.b)"]), max_size=3)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Project:
    return project(tmp_path_factory.mktemp("desk"))


def stage_of(artifact: Artifact) -> Usd.Stage:
    """The stage of an artifact that refers to no other file."""
    from pxr import Sdf, Usd

    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(artifact.files["scene.usda"].decode())
    return Usd.Stage.Open(layer)


def lowered(spec: SceneSpec, folder: Path) -> Loaded | None:
    """The spec as a loaded document, if it lowers."""
    loaded = Loaded(folder / "random.scene.yaml", folder, spec, ())
    try:
        lower(loaded)
    except (SpecError, OverflowError, ValueError):  # numbers so large that their squares are none
        return None
    return loaded


def standing(item: ObjectSpec) -> ObjectSpec:
    """A primitive that needs nothing from elsewhere."""
    if isinstance(item.shape, CompoundShape):
        parts = {name: part.model_copy(update={"material": None}) for name, part in item.shape.compound.items()}
        item = item.model_copy(update={"shape": CompoundShape(compound=parts)})
    given: dict[str, Any] = {"material": None, "visual": None, "joints": {}, "mass": item.mass or 1.0, "density": None}
    return item.model_copy(update=given)


@settings(phases=[Phase.generate])
@given(SCENES, RELATIONS)
def test_any_scene_comes_back_as_it_was(tmp_path_factory: pytest.TempPathFactory, spec: SceneSpec, texts: Any) -> None:
    import numpy as np

    folder = tmp_path_factory.getbasetemp()
    with np.errstate(all="ignore"):
        spec = spec.model_copy(update={"no_contact": (), "relations": ()})
        objects = {n: standing(o) for n, o in spec.objects.items() if o.shape is not None}
        objects = {
            n: o
            for n, o in objects.items()
            if lowered(spec.model_copy(update={"objects": {n: o}, "relations": ()}), folder)
        }
        whole = spec.model_copy(update={"objects": objects, "relations": tuple(texts)})
        loaded = lowered(whole, folder)
        assume(loaded is not None)
        assert loaded is not None
        stage = stage_of(compile_usd(lower(loaded)))
        reading = read_spec(stage)
    assert reading is not None
    data = to_data(whole)
    assert reading.data == data and list(reading.data) == list(data)
    assert reading.notes == () and not reading.renamed
    assert to_yaml(SceneSpec.model_validate(reading.data)) == to_yaml(whole)


@pytest.mark.parametrize("path", SPECS, ids=[p.name.split(".")[0] for p in SPECS])
def test_the_specs_come_back_byte_for_byte(path: Path, tmp_path: Path) -> None:
    compile_usd(lower_file(path)).write(tmp_path)
    stage = tmp_path / "scene.usda"
    assert import_usd(stage, path).text == path.read_text(encoding="utf-8")
    reading = read_stage(stage)
    assert reading.notes == ()
    spec = load_scene(path).spec
    assert spec is not None and SceneSpec.model_validate(reading.data) == spec
    assert reading.file == path.relative_to(REPOSITORY).as_posix()


def test_the_document_survives_crates_and_flattening(desk: Project, tmp_path: Path) -> None:
    stage = desk.edit()
    for name in ("flat.usda", "flat.usdc", "flat.usd"):
        path = tmp_path / name
        stage.Flatten().Export(str(path))
        assert import_usd(path, desk.document).text == DESK
    stage.GetRootLayer().Export(str(tmp_path / "crate.usdc"))
    assert import_usd(tmp_path / "crate.usdc", desk.document).text == DESK


def test_layers_on_top_count(desk: Project, tmp_path: Path) -> None:
    """A layer of somebody's own on top of ours, in centimeters and y up as new layers are, and a session saved."""
    from pxr import Gf, Sdf, Usd, UsdGeom

    top = Sdf.Layer.CreateNew(str(tmp_path / "top.usda"))
    top.subLayerPaths = [str(desk.stage)]
    stage = Usd.Stage.Open(top)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01 and not stage.HasDefaultPrim()
    stage.GetPrimAtPath("/World/Objects/ball").GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.25, -0.2, 0.03))
    stage.GetPrimAtPath("/World/Objects/shelf").SetActive(False)
    top.Save()
    expected = DESK.replace("xyz: [0.2, -0.2, 0.03]", "xyz: [0.25, -0.2, 0.03]")
    expected = expected.replace(DESK[DESK.index("  shelf:\n") : DESK.index("  plate:\n")], "")
    assert import_usd(tmp_path / "top.usda", desk.document).text == expected


def test_a_stage_that_refers_to_ours_has_its_document(desk: Project, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(tmp_path / "room.usda"))
    UsdGeom.Xform.Define(stage, "/Room")
    stage.DefinePrim("/Room/Table").GetReferences().AddReference(str(desk.stage))
    stage.Save()
    assert import_usd(tmp_path / "room.usda", desk.document).text == DESK


def room(desk: Project, path: Path, unit: float | None, up: str, turn: float, scale: float, above: bool) -> Path:
    """A stage of some unit that refers to ours with a corrective transform, at the prim or at one above it."""
    from pxr import Gf, Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    if unit is not None:
        UsdGeom.SetStageMetersPerUnit(stage, unit)
    prims = [UsdGeom.Xform.Define(stage, "/Room"), UsdGeom.Xform.Define(stage, "/Room/Table")]
    prims[1].GetPrim().GetReferences().AddReference(str(desk.stage))
    corrected = prims[0] if above else prims[1]
    if turn:
        corrected.AddRotateXOp(opSuffix="unitsResolve").Set(turn)
    if scale != 1.0:
        corrected.AddScaleOp(opSuffix="unitsResolve").Set(Gf.Vec3f(scale))
    stage.Save()
    return path


@pytest.mark.parametrize("above", [False, True])
@pytest.mark.parametrize(
    ("unit", "up", "turn", "scale"),
    [(0.01, "Y", -90.0, 100.0), (None, "Y", -90.0, 100.0), (0.01, "Z", 0.0, 100.0), (1.0, "Y", -90.0, 1.0),
     (0.0254, "Y", -90.0, 39.3701), (0.01, "Y", 0.0, 1.0), (0.001, "Z", 0.0, 1.0)],
)  # fmt: skip
def test_a_stage_of_other_units_that_corrects_for_ours_changes_nothing(
    desk: Project, tmp_path: Path, unit: float | None, up: str, turn: float, scale: float, above: bool
) -> None:
    assert import_usd(room(desk, tmp_path / "room.usda", unit, up, turn, scale, above), desk.document).text == DESK


def test_edits_in_a_stage_of_other_units_are_those_of_the_scene(desk: Project, tmp_path: Path) -> None:
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    path = room(desk, tmp_path / "room.usda", 0.01, "Y", -90.0, 100.0, True)
    stage = Usd.Stage.Open(str(path))
    ball = stage.GetPrimAtPath("/Room/Table/Objects/ball")
    ball.GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.25, -0.2, 0.03))
    cube = UsdGeom.Cube.Define(stage, "/Room/Table/crate")  # turned and scaled with the room
    cube.CreateSizeAttr(0.2)
    cube.AddTranslateOp().Set(Gf.Vec3d(0.5, 0.2, 0.1))
    box = UsdGeom.Cube.Define(stage, "/Box")  # in centimeters and y up
    box.CreateSizeAttr(30)
    box.AddTranslateOp().Set(Gf.Vec3d(50, 15, 40))
    UsdPhysics.RigidBodyAPI.Apply(box.GetPrim())
    UsdPhysics.MassAPI.Apply(box.GetPrim()).CreateDensityAttr(0.0006)
    stage.Save()
    objects = read_stage(path).data["objects"]
    assert objects["ball"]["pose"] == {"xyz": (0.25, -0.2, 0.03), "rpy_deg": (10, 20, 30)}
    assert objects["crate"]["shape"] == {"box": (0.2, 0.2, 0.2)} and objects["crate"]["pose"]["xyz"] == (0.5, 0.2, 0.1)
    assert objects["box"]["shape"] == {"box": (0.3, 0.3, 0.3)} and objects["box"]["density"] == 600
    assert objects["box"]["pose"]["xyz"] == (0.5, -0.4, 0.15)
    assert objects["desk"] == read_stage(desk.stage).data["objects"]["desk"]


@pytest.mark.parametrize(("unit", "scale"), [(0.01, 50.0), (None, 0.01), (0.001, 100.0)])
def test_a_scale_that_fits_no_unit_is_refused(desk: Project, tmp_path: Path, unit: float | None, scale: float) -> None:
    with pytest.raises(StageError, match=r"/Room/Table: it is scaled by .* in a stage with a unit of"):
        read_stage(room(desk, tmp_path / "room.usda", unit, "Y", -90.0, scale, False))


def test_numbers_before_and_after_are_those_of_the_scene(desk: Project) -> None:
    """What is read without an edit lowers to the same scene: every file of it, byte for byte."""
    loaded = load_usd(desk.stage)
    assert not loaded.errors and loaded.path == desk.document
    assert compile_usd(lower(loaded)).files == compile_usd(desk.scene).files


def test_findings_stand_at_prims(desk: Project) -> None:
    from pxr import Gf

    stage = desk.edit()
    stage.GetPrimAtPath("/World/Objects/ball").GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.2, -0.2, 0.5))
    stage.GetPrimAtPath("/World/Objects/plate/base").GetAttribute("physics:mass").Set(40.0)
    stage.GetPrimAtPath("/World/Objects/cabinet/leaf").GetAttribute("physics:mass").Set(2.0)
    path = desk.save(stage)
    done = run("check", path, "--json")
    found = {(f["code"], f["file"], f["line"]) for f in done.json["findings"]}
    assert found == {
        ("SF402", f"{path}</World/Objects/plate>", 0),
        ("SF411", f"{path}</World/Objects/ball>", 0),
        ("SF421", f"{path}</World/Objects/cabinet/leaf>", 0),
    }
    assert done.code == 1
    text = run("check", path)
    assert text.one_line(f"{path}</World/Objects/cabinet/leaf>: warning[SF421] `physics:mass` changed from ")
    assert "3 warnings in 1 of 2 documents" in text.out


def test_commands_take_a_stage(desk: Project, tmp_path: Path) -> None:
    assert run("check", desk.stage).code == 0
    assert run("show", desk.stage, "--json").json == run("show", desk.document, "--json").json
    assert run("compile", desk.stage, "-t", "usd", "-t", "mjcf", "-o", tmp_path / "a").code == 0
    assert run("compile", desk.document, "-t", "usd", "-t", "mjcf", "-o", tmp_path / "b").code == 0
    for file in ("usd/scene.usda", "mjcf/scene.xml"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    done = run("render", desk.stage, "-c", "front", "--engine", "raycast", "-o", tmp_path / "a.png")
    assert done.code == 0 and (tmp_path / "a.png").stat().st_size > 1000


def test_diff_says_what_was_moved(desk: Project) -> None:
    from pxr import Gf

    same = run("diff", desk.document, desk.stage, "--format=json")
    assert same.json["documents"][0]["entries"] == []
    stage = desk.edit()
    stage.GetPrimAtPath("/World/Objects/ball").GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.2, -0.25, 0.03))
    done = run("diff", desk.document, desk.save(stage))
    assert "ball" in done.out and "moved 5.0 cm" in done.out and "1 moved" in done.out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no stage at all", "USD could not read the file as a stage"),
        ("#usda 1.0\n", "the stage was not compiled from a document"),
        (
            '#usda 1.0\ndef "World" (customData={dictionary simfoundry={string document="{"}}) {}\n',
            "was it edited by hand",
        ),
        (
            """#usda 1.0
            def "World" (customData = {dictionary simfoundry = {string document = '{"simfoundry": "scene/9"}'}}) {}
            """,
            "contains a `scene/9` document",
        ),
    ],
)
def test_files_without_a_document_are_findings(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.usda"
    path.write_text(text)
    done = run("check", path)
    assert done.code == 1 and message in done.err and "Traceback" not in done.err
    assert run("show", path).code == 2
    with pytest.raises(StageError, match=r"a\.usda: .*"):
        import_usd(path)


HOSTILE = [
    ("spec", '{"shape": {"box": 3}}'),
    ("spec", "[]"),
    ("spec", '{"pose": 1, "place": [], "joints": 2, "color": 5}'),
    ("built", '{"": {"at": [1]}}'),
    ("built", '{"": []}'),
    ("built", '{"base": {"physics:mass": "x", "at": 1}}'),
    ("built", '{"": {"at": [0,0,0,0,0,0,0,1,1,1]}}'),
    ("part", "objects"),
    ("part", "nothing.cup"),
    ("part", "materials.cup"),
    ("part", "cameras.cup"),
    ("part", "lights.cup"),
]


@pytest.mark.parametrize(("key", "value"), HOSTILE)
def test_metadata_that_somebody_spoilt_is_an_error_and_no_crash(desk: Project, key: str, value: str) -> None:
    stage = desk.edit()
    stage.GetPrimAtPath("/World/Objects/cup").SetCustomDataByKey(f"simfoundry:{key}", value)
    path = desk.save(stage)
    loaded = load(path)
    assert loaded.findings, "nothing is said of it"
    try:
        import_usd(path, desk.document)
    except (StageError, SpecError) as error:
        assert str(error)


def test_the_metadata_can_be_read_by_people(desk: Project) -> None:
    """One line a key, and a relation as it is written."""
    text = desk.stage.read_text(encoding="utf-8")
    assert ' "mass": {"value": 0.45, "range": [0.3, 0.6], "source": "vlm"},\n' in text
    assert '"OnTop(plate, desk)"' in text
    stage = open_stage(desk.stage)
    plate = stage.GetPrimAtPath("/World/Objects/plate")
    assert json.loads(plate.GetCustomDataByKey("simfoundry:spec"))["origin"] == {
        "capture": "monday",
        "fit_error": 0.002,
    }
    assert str(desk.stage.parent) not in text and str(desk.document.parent) not in text


def test_the_bytes_are_the_same_in_every_process(desk: Project) -> None:
    code = (
        "import sys; from pathlib import Path; from simfoundry.scene.lower import lower_file;"
        "from simfoundry.backends.usd import compile_usd;"
        "sys.stdout.buffer.write(compile_usd(lower_file(Path(sys.argv[1]))).files['scene.usda'])"
    )
    for seed in ("1", "2"):
        env = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(REPOSITORY)}
        done = subprocess.run([sys.executable, "-c", code, desk.document], capture_output=True, check=True, env=env)
        assert done.stdout == desk.stage.read_bytes()
