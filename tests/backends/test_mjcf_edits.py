"""Builds that a person edited by hand: each edit counts, however the scene is opened."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.backends.mjcf.contacts import exact_model
from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.mjcf.reader import read_mjcf
from simfoundry.runtime.plugins import import_file
from simfoundry.scene.model import Scene
from tests.backends.test_mjcf_contacts import crowd, friction, load_files, pairs_of, with_material
from tests.scenes import box, cabinet, pose, scene_of, solid


def edited(scene: Scene, folder: Path, *changes: tuple[str, str], contacts: str = "exact") -> Path:
    compile_mjcf(scene, contacts=contacts).write(folder)
    text = (folder / "scene.xml").read_text()
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "scene.xml").write_text(text)
    return folder


def loaded(folder: Path) -> mujoco.MjModel:
    return import_file(folder / "load.py").load()[0]


def opened(folder: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))


@pytest.fixture
def desk() -> Scene:
    """A cup of ceramic and a block of rubber on a wooden desk, and a drawer."""
    cup = with_material(solid("cup", box(0.1, 0.1, 0.1), pose(0, 0, 0.05), friction=0.35), "ceramic")
    block = with_material(solid("block", box(0.1, 0.1, 0.1), pose(0.3, 0, 0.05), friction=0.9), "rubber")
    top = with_material(solid("desk", box(2, 2, 0.1), pose(0, 0, -0.05), friction=0.5, fixed=True), "wood")
    return scene_of(top, cup, block, cabinet())


@pytest.mark.parametrize("read", [loaded, opened])
def test_mass_pose_and_joint_can_be_edited_by_hand(
    desk: Scene, tmp_path: Path, read: Callable[[Path], mujoco.MjModel]
) -> None:
    text = compile_mjcf(desk).files["scene.xml"].decode()
    mass = next(line for line in text.split('<body name="block"')[1].splitlines() if "<inertial" in line)
    limit = next(line for line in text.splitlines() if 'name="cabinet.slide"' in line)
    folder = edited(
        desk,
        tmp_path / "build",
        (text[text.index('<body name="block"') :].split("\n")[0], '<body name="block" pos="0.4 0 0.05">'),
        (limit, limit.replace('damping="', 'damping="1')),
    )
    scene = folder / "scene.xml"
    head, tail = scene.read_text().split('<body name="block"')
    scene.write_text(
        head + '<body name="block"' + tail.replace(mass, '<inertial pos="0 0 0" mass="7" diaginertia="1 1 1" />', 1)
    )
    model = read(folder)
    assert model.body("block").mass[0] == 7 and model.body("block").pos.tolist() == [0.4, 0, 0.05]
    before = load_files(desk).dof_damping[load_files(desk).joint("cabinet.slide").dofadr[0]]
    assert np.ravel(model.dof_damping[model.joint("cabinet.slide").dofadr[0]])[0] > np.ravel(before)[0]


CERAMIC = ('<geom friction="0.35" />', '<geom friction="0.2" />')


def test_a_friction_edited_by_hand_counts_through_load(desk: Scene, tmp_path: Path) -> None:
    folder = edited(desk, tmp_path / "build", CERAMIC)
    assert friction(loaded(folder), "desk.shape", "cup.shape") == pytest.approx(math.sqrt(0.2 * 0.5))
    assert friction(loaded(folder), "block.shape", "cup.shape") == pytest.approx(math.sqrt(0.2 * 0.9))
    assert friction(loaded(folder), "block.shape", "desk.shape") == pytest.approx(math.sqrt(0.5 * 0.9))


def test_contacts_are_written_anew_for_whoever_opens_the_scene(desk: Scene, tmp_path: Path) -> None:
    folder = edited(desk, tmp_path / "build", CERAMIC)
    assert friction(opened(folder), "desk.shape", "cup.shape") == pytest.approx(math.sqrt(0.35 * 0.5))
    subprocess.run([sys.executable, folder / "load.py", "--contacts"], check=True, cwd=tmp_path, capture_output=True)
    assert friction(opened(folder), "desk.shape", "cup.shape") == pytest.approx(math.sqrt(0.2 * 0.5))
    same = tmp_path / "same"
    compile_mjcf(desk).write(same)
    before = (same / "contacts.xml").read_text()
    subprocess.run([sys.executable, same / "load.py", "--contacts"], check=True, cwd=tmp_path, capture_output=True)
    assert (same / "contacts.xml").read_text() == before


@pytest.mark.parametrize("read", [loaded, opened])
def test_a_friction_edited_by_hand_counts_under_native_contacts(
    desk: Scene, tmp_path: Path, read: Callable[[Path], mujoco.MjModel]
) -> None:
    folder = edited(
        desk, tmp_path / "build", ('<geom friction="0.35" />', '<geom friction="0.8" />'), contacts="native"
    )
    assert friction(read(folder), "desk.shape", "cup.shape") == 0.8


def test_the_friction_of_one_geom_can_be_edited(desk: Scene, tmp_path: Path) -> None:
    text = compile_mjcf(desk).files["scene.xml"].decode()
    line = next(line for line in text.splitlines() if 'name="cup.shape"' in line)
    folder = edited(desk, tmp_path / "build", (line, line.replace("<geom ", '<geom friction="0.1" ')))
    assert friction(loaded(folder), "desk.shape", "cup.shape") == pytest.approx(math.sqrt(0.1 * 0.5))


def rewritten(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(folder / "load.py"), "--contacts"]
    return subprocess.run(command, check=False, cwd=folder.parent, capture_output=True, text=True)


def with_children(desk: Scene, folder: Path, *geoms: str) -> Path:
    """The desk's build, with elements added by hand to the body of the cup."""
    text = compile_mjcf(desk).files["scene.xml"].decode()
    line = next(line for line in text.splitlines() if 'name="cup.shape"' in line)
    return edited(desk, folder, (line, "\n".join([line, *geoms])))


def test_geoms_without_a_name_have_no_pairs_and_are_told(desk: Scene, tmp_path: Path) -> None:
    nameless = '<geom class="rubber" type="sphere" size="0.02" pos="0 0 0.2" />'
    folder = with_children(desk, tmp_path / "build", nameless, f'<body pos="0 0 0.4">{nameless}</body>')
    pairs = opened(folder).npair
    answer = rewritten(folder)
    assert answer.returncode == 0 and opened(folder).npair == pairs
    assert answer.stdout.splitlines()[1] == (
        "geoms without a name have no pairs; name those in the following bodies: cup, (no name)"
    )
    model = loaded(folder)
    assert model.npair > pairs  # in memory, each has its own


def touching(model: mujoco.MjModel, a: str, b: str) -> bool:
    """Whether two geoms touch where the model puts them."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    met = {frozenset(model.geom(int(g)).name for g in contact.geom) for contact in data.contact}
    return frozenset((a, b)) in met


WELDED = '<body name="handle"><geom name="grip" class="rubber" type="sphere" size="0.05" />{}</body>'
RING = '<body name="ring"><geom name="hoop" class="wood" type="sphere" size="0.05" /></body>'
HINGED = WELDED.format('<joint name="turn" /><inertial mass="1" pos="0 0 0" diaginertia="1 1 1" />' + RING)


@pytest.mark.parametrize("child", [WELDED.format(""), HINGED], ids=["welded", "hinged"])
def test_pairs_leave_out_what_mujoco_itself_does_not_collide(desk: Scene, tmp_path: Path, child: str) -> None:
    folder = with_children(desk, tmp_path / "build", child)
    text = (folder / "scene.xml").read_text()
    (folder / "scene.xml").write_text(re.sub("<keyframe>.*</keyframe>", "", text, flags=re.DOTALL))
    assert rewritten(folder).returncode == 0
    spec = mujoco.MjSpec.from_file(str(folder / "scene.xml"))
    rules = import_file(folder / "contact_rules.py")
    memory = import_file(folder / "load.py").read_scene(rules)
    rules.make_exact(memory)
    for model in (spec.compile(), memory.compile()):
        assert not touching(model, "grip", "cup.shape") and not touching(model, "hoop", "cup.shape")
        assert not touching(model, "hoop", "grip")
        assert "grip" in {name for pair in pairs_of(model) for name in pair}


@pytest.mark.parametrize("mask", ['contype="2" conaffinity="2"', 'contype="0" conaffinity="0"'])
def test_pairs_obey_masks_edited_by_hand(desk: Scene, tmp_path: Path, mask: str) -> None:
    text = compile_mjcf(desk).files["scene.xml"].decode()
    line = next(line for line in text.splitlines() if 'name="block.shape"' in line)
    moved = line.replace("<geom ", f'<geom {mask} pos="-0.3 0 0" ')
    folder = edited(desk, tmp_path / "build", (line, moved))
    assert rewritten(folder).returncode == 0
    for model in (loaded(folder), opened(folder)):
        assert touching(model, "cup.shape", "desk.shape")
        assert not touching(model, "block.shape", "cup.shape") and not touching(model, "block.shape", "desk.shape")


def test_masks_edited_by_hand_outlive_proxies() -> None:
    files = dict(compile_mjcf(crowd(4, 1)).files)
    name = b'name="thing_0_0.part_0"'
    files["scene.xml"] = files["scene.xml"].replace(name, name + b' contype="2" conaffinity="2"')
    model = exact_model(files)
    assert (model.geom("thing_0_0.part_0").contype, model.geom("thing_0_0.part_0").conaffinity) == (2, 2)
    assert not any("thing_0_0.part_0" in pair for pair in pairs_of(model))


def test_a_build_may_include_files_and_use_folders_of_its_owner(desk: Scene, tmp_path: Path) -> None:
    mesh = '<asset><mesh name="mine" file="mine/tetra.obj" /></asset>'
    geom = '<geom name="mine" type="mesh" mesh="mine" pos="0 0 3" />'
    folder = edited(desk, tmp_path / "build", ("<worldbody>", f'{mesh}<include file="more.xml" /><worldbody>{geom}'))
    (folder / "more.xml").write_text('<mujoco><worldbody><body name="extra" /></worldbody></mujoco>')
    (folder / "assets/mine").mkdir(parents=True)
    (folder / "assets/mine/tetra.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    for model in (loaded(folder), opened(folder)):
        assert model.body("extra").name == "extra" and model.nmesh == 1
    assert rewritten(folder).returncode == 0


def test_contacts_are_not_written_into_a_native_build(desk: Scene, tmp_path: Path) -> None:
    folder = edited(desk, tmp_path / "build", contacts="native")
    answer = rewritten(folder)
    assert answer.returncode == 1 and "compile without the option `contacts: native`" in answer.stderr
    assert not (folder / "contacts.xml").exists()
    (folder / "contacts.xml").write_text("<mujoco />")  # a file that the scene does not include
    assert friction(loaded(folder), "desk.shape", "cup.shape") == 0.5


def test_a_free_body_starts_where_its_body_was_edited_to_be(desk: Scene, tmp_path: Path) -> None:
    """Its pose is in the keyframe too, which cannot leave it out."""
    text = compile_mjcf(desk).files["scene.xml"].decode()
    line = text[text.index('<body name="block"') :].split("\n")[0]
    folder = edited(desk, tmp_path / "build", (line, '<body name="block" pos="0.4 0.1 0.05" quat="0 0 0 1">'))
    data = import_file(folder / "load.py").load()[1]
    assert data.body("block").xpos.tolist() == [0.4, 0.1, 0.05]
    assert data.joint("cabinet.slide").qpos[0] == 0.07  # the keyframe still says what joints there are
    imported = read_mjcf(folder / "scene.xml", ImportOptions())
    block = next(body for body in imported.bodies if body.name == "block")
    assert block.X_WO.p.tolist() == [0.4, 0.1, 0.05] and block.X_WO.q.tolist() == [0, 0, 0, 1]
