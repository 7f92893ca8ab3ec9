"""Where robots' models are found, and what happens where they are not."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from simfoundry.backends import compile_scene
from simfoundry.errors import SimfoundryError
from simfoundry.scene.lower import lower_file
from simfoundry.scene.robot import ModelFormat
from simfoundry.scene.robot_files import NoModelError, find_model, model_files
from simfoundry.spec.models.robot_file import OWN_ROBOTS, find_robot, read_robot_file, robot_names
from tests.cli.command import run
from tests.conftest import PACKAGE, REPOSITORY

SPECS = sorted((REPOSITORY / "specs" / "scenes").glob("*.scene.yaml"))
WITH_ROBOTS = [path for path in SPECS if path.name.split(".")[0] in ("droid", "yam")]

PLAIN = """\
<robot name="plain">
  <link name="base"/>
  <link name="tip"><visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="tip"/><limit lower="-1" upper="1" effort="5" velocity="1"/>
  </joint>
</robot>
"""

OBJ = "mtllib tip.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """A URDF whose mesh has materials and a texture."""
    (tmp_path / "pack" / "meshes").mkdir(parents=True)
    (tmp_path / "pack" / "urdf").mkdir()
    urdf = tmp_path / "pack" / "urdf" / "plain.urdf"
    urdf.write_text(PLAIN.format(mesh="package://pack/meshes/tip.obj"))
    (tmp_path / "pack" / "meshes" / "tip.obj").write_text(OBJ)
    (tmp_path / "pack" / "meshes" / "tip.mtl").write_text("newmtl a\nmap_Kd tip.png\n")
    (tmp_path / "pack" / "meshes" / "tip.png").write_bytes(b"png")
    return urdf


@pytest.mark.parametrize("name", robot_names())
def test_what_is_known_of_a_robot_and_its_models_agree(name: str) -> None:
    models, known = read_robot_file(PACKAGE / "robots" / f"{name}.yaml"), find_robot(name)
    assert known is not None
    described = [m for m in (models.mjcf, models.urdf, models.usd) if m is not None]
    assert described
    for model in described:
        assert set(model.links) == set(known.links)
        assert [f"joint{k}" for k in range(1, len(model.joints) + 1)] == list(known.home)
        assert model.gripper is not None
        assert set(model.gripper.follow) <= {*model.gripper.joints, *model.gripper.follow}
        assert next(iter(model.gripper.joints)) not in model.gripper.follow


def test_a_model_names_all_its_files(plain: Path) -> None:
    assert [path.name for path in model_files(plain)] == ["plain.urdf", "tip.obj", "tip.mtl", "tip.png"]
    (plain.parent.parent / "meshes" / "tip.obj").unlink()
    with pytest.raises(NoModelError, match=r"plain.urdf references tip.obj, but .*tip.obj does not exist"):
        model_files(plain)


def test_models_of_packages_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "robot.xml").write_text("<mujoco/>")
    (tmp_path / "robot" / "hand.xml").write_text("<mujoco/>")
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    package, module = ModuleType("robot_descriptions"), ModuleType("robot_descriptions.toy_mj_description")
    package.__path__ = []
    module.__dict__.update(PACKAGE_PATH=str(tmp_path / "robot"), MJCF_PATH=str(tmp_path / "robot" / "robot.xml"))
    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    monkeypatch.setitem(sys.modules, "robot_descriptions.toy_mj_description", module)
    document = tmp_path / "a.scene.yaml"
    toy = "robot_descriptions:toy_mj_description"
    assert find_model(toy, document, ".xml") == (tmp_path / "robot" / "robot.xml").resolve()
    assert find_model(f"{toy}/hand.xml", document, ".xml") == (tmp_path / "robot" / "hand.xml").resolve()
    with pytest.raises(NoModelError, match="is outside `robot_descriptions:toy_mj_description`"):
        find_model(f"{toy}/../secret.xml", document, ".xml")
    with pytest.raises(NoModelError, match="has no urdf file"):
        find_model(toy, document, ".urdf")
    with pytest.raises(
        NoModelError, match="`robot_descriptions` does not provide `tin_description`; update the package"
    ):
        find_model("robot_descriptions:tin_description", document, ".xml")


YAM = "menagerie:i2rt_yam/yam.xml"


def test_models_of_menagerie_are_found_and_never_fetched_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco_menagerie", reason="the extra `robots` is not installed")
    document = tmp_path / "a.scene.yaml"
    monkeypatch.setenv("MENAGERIE_ROOT", "")
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("MENAGERIE_BASE_URL", (tmp_path / "site").as_uri())
    with pytest.raises(
        NoModelError, match=r"has not been downloaded; run `python -m mujoco_menagerie prefetch i2rt_yam`"
    ):
        find_model(YAM, document, ".xml", fetch=False)
    assert not (tmp_path / "cache").exists()
    with pytest.raises(NoModelError, match=r"could not download `i2rt_yam`: file://.*not found"):
        find_model(YAM, document, ".xml")
    with pytest.raises(
        NoModelError, match=r"does not provide `i2rt_yan`: Unknown robot 'i2rt_yan'\. Did you mean 'i2rt_yam'\?"
    ):
        find_model("menagerie:i2rt_yan", document, ".xml")
    (tmp_path / "models" / "i2rt_yam").mkdir(parents=True)
    model = tmp_path / "models" / "i2rt_yam" / "yam.xml"
    model.write_text("<mujoco/>")
    (tmp_path / "models" / "secret.xml").write_text("<mujoco/>")
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path / "models"))
    assert find_model(YAM, document, ".xml", fetch=False) == model.resolve()
    assert find_model("menagerie:i2rt_yam", document, ".xml") == model.resolve()
    with pytest.raises(NoModelError, match="is outside `menagerie:i2rt_yam`"):
        find_model("menagerie:i2rt_yam/../secret.xml", document, ".xml")
    with pytest.raises(NoModelError, match=r"`menagerie:i2rt_yam` has no file hand\.xml"):
        find_model("menagerie:i2rt_yam/hand.xml", document, ".xml")


def test_what_failed_to_be_fetched_is_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    menagerie = pytest.importorskip("mujoco_menagerie", reason="the extra `robots` is not installed")
    monkeypatch.setenv("MENAGERIE_ROOT", "")
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "cache"))
    tried: list[str] = []

    def offline(_cache: object, robot: Any, _progress: object = None) -> Path:
        tried.append(robot.name)
        raise menagerie.DownloadError("no network")

    monkeypatch.setattr(menagerie.Cache, "resolve", offline)
    for _ in range(3):
        with pytest.raises(NoModelError, match="could not download `i2rt_yam`: no network"):
            find_model(YAM, tmp_path / "a.scene.yaml", ".xml")
    assert tried == ["i2rt_yam"]


def test_the_reason_of_a_package_that_is_here_says_more(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco_menagerie", reason="the extra `robots` is not installed")
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    monkeypatch.delenv(OWN_ROBOTS, raising=False)
    scene = lower_file(WITH_ROBOTS[0])
    (reason,) = [left.reason for left in scene.left_out if left.path.startswith("robots.")]
    assert reason.startswith("no model found: mujoco-menagerie could not download `franka_emika_panda`")


def test_descriptions_are_not_cloned_unasked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site" / "robot_descriptions"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "_repositories.py").write_text(
        "from types import SimpleNamespace\nREPOSITORIES = {'toys': SimpleNamespace(cache_path='toys')}\n"
    )
    (package / "toy_mj_description.py").write_text(
        "import os\ndef _clone_to_cache(name, commit=None):\n"
        "    assert os.environ['GIT_ALLOW_PROTOCOL'] == 'none'\n    print('Cloning')\n"
        f"    return {str(tmp_path / 'clones' / 'toys')!r}\n"
        "REPOSITORY_PATH = _clone_to_cache(\n    'toys')\nPACKAGE_PATH = REPOSITORY_PATH\n"
        "MJCF_PATH = os.path.join(REPOSITORY_PATH, 'toy.xml')\n"
    )
    for name in [name for name in sys.modules if name.partition(".")[0] == "robot_descriptions"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "clones"))
    monkeypatch.delenv("GIT_ALLOW_PROTOCOL", raising=False)
    toy = "robot_descriptions:toy_mj_description"
    with pytest.raises(
        NoModelError, match="has not been downloaded; run `robot_descriptions pull toy_mj_description`, or"
    ):
        find_model(toy, tmp_path / "a.scene.yaml", ".xml", fetch=False)
    (tmp_path / "clones" / "toys" / ".git").mkdir(parents=True)
    (tmp_path / "clones" / "toys" / "toy.xml").write_text("<mujoco/>")
    try:
        assert find_model(toy, tmp_path / "a.scene.yaml", ".xml", fetch=False).name == "toy.xml"
    finally:
        for name in [name for name in sys.modules if name.partition(".")[0] == "robot_descriptions"]:
            del sys.modules[name]
    assert "GIT_ALLOW_PROTOCOL" not in os.environ


@pytest.fixture
def without_models(monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("mujoco_menagerie", "robot_descriptions"):  # as if they were not installed
        monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delenv(OWN_ROBOTS, raising=False)


@pytest.mark.parametrize("path", WITH_ROBOTS, ids=lambda path: path.name.split(".")[0])
@pytest.mark.usefixtures("without_models")
def test_a_scene_compiles_without_the_models_of_its_robots(path: Path) -> None:
    scene = lower_file(path)
    assert scene.robots == ()
    for target in ("mjcf", "pybullet", "urdf", "usd"):
        losses = {loss.path: loss.reason for loss in compile_scene(scene, target).losses}
        robots = {"droid": ["arm"], "yam": ["left", "right"]}[scene.name]
        for robot in robots:
            reason = "no model found: install the robot models with `pip install 'simfoundry[robots]'`"
            assert losses[f"robots.{robot}"].startswith(reason)
        carried = [path for path in losses if path.startswith("cameras.")]
        assert len(carried) == len(robots)


def test_show_tells_robots_what_they_carry_and_what_is_left_out(
    own_models: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    droid = str(REPOSITORY / "specs" / "scenes" / "droid.scene.yaml")
    monkeypatch.setenv(OWN_ROBOTS, str(own_models))
    shown = run("show", droid).out.splitlines()
    assert "robot arm  franka_robotiq  mjcf" in shown
    assert "camera wrist  1280 x 720  on arm.hand" in shown
    assert not any(line.startswith("without") for line in shown)
    monkeypatch.delenv(OWN_ROBOTS)
    for package in ("mujoco_menagerie", "robot_descriptions"):
        monkeypatch.setitem(sys.modules, package, None)
    shown = run("show", droid).out.splitlines()
    assert (
        "without robots.arm: no model found: install the robot models with `pip install 'simfoundry[robots]'`" in shown
    )


@pytest.mark.usefixtures("without_models")
def test_strict_compiles_want_the_models(tmp_path: Path) -> None:
    scene = str(WITH_ROBOTS[0])
    assert run("compile", scene, "-t", "urdf", "-o", str(tmp_path / "a")).code == 0
    assert run("compile", scene, "-t", "urdf", "-o", str(tmp_path / "b"), "--strict").code == 1
    report = json.loads((tmp_path / "a" / "loss.json").read_text())
    assert any("no model found" in loss["reason"] for loss in report["urdf"]["losses"])


def test_a_scene_names_its_own_robot(plain: Path, tmp_path: Path) -> None:
    scene = tmp_path / "own.scene.yaml"
    text = "simfoundry: scene/1\nname: own\nrobots:\n  bot:\n    model: {urdf: pack/urdf/plain.urdf}\n"
    scene.write_text(text + "    joints: {turn: 0.25}\n    reach: 0.4\n")
    robot = lower_file(scene).robot("bot")
    native = robot.models[ModelFormat.URDF]
    assert (robot.reach, robot.opening, robot.start(native)) == (0.4, None, {"turn": 0.25})
    before = native.digest
    (plain.parent.parent / "meshes" / "tip.png").write_bytes(b"another")
    assert lower_file(scene).robot("bot").models[ModelFormat.URDF].digest != before


@pytest.mark.usefixtures("plain")
def test_an_unknown_joint_of_an_own_robot_is_named(tmp_path: Path) -> None:
    scene = tmp_path / "own.scene.yaml"
    text = "simfoundry: scene/1\nname: own\nrobots:\n  bot:\n    model: {urdf: pack/urdf/plain.urdf}\n"
    scene.write_text(text + "    joints: {elbow: 0.25}\n")
    done = run("compile", str(scene), "-t", "urdf", "-o", str(tmp_path / "out"))
    assert done.code == 2
    assert "robot `bot`: plain.urdf has no joint `elbow`; available joints: turn" in (done.out + done.err)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(OWN_ROBOTS, str(tmp_path / "nowhere"))
    with pytest.raises(SimfoundryError, match=r"SIMFOUNDRY_ROBOTS is set to .*nowhere, but this folder does not exist"):
        lower_file(WITH_ROBOTS[0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "mjcf: {file: a.xml, arms: 2}",
            "mjcf.arms: Extra inputs are not permitted; see docs/robots.md for the format",
        ),
        ("mjcf: [", "is not a valid robot file"),
        ("- 1", "the file: Input should be an object"),
    ],
)
def test_a_faulty_robot_file_is_explained(
    text: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "yam.yaml").write_text(text)
    monkeypatch.setenv(OWN_ROBOTS, str(tmp_path))
    done = run("compile", str(REPOSITORY / "specs/scenes/yam.scene.yaml"), "-t", "urdf", "-o", str(tmp_path / "out"))
    assert done.code == 2
    assert said in (done.out + done.err)
    assert "Traceback" not in (done.out + done.err)


def test_an_own_model_stands_in_for_the_known_one(own_models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(OWN_ROBOTS, str(own_models))
    robot = lower_file(REPOSITORY / "specs" / "scenes" / "yam.scene.yaml").robot("left")
    assert robot.models[ModelFormat.MJCF].file.parent.name == "i2rt_yam_menagerie"
    assert robot.models[ModelFormat.URDF].file.name == "yam.urdf"
    assert (robot.reach, robot.opening) == (0.70, 0.076)
