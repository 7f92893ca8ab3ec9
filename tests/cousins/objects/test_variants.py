"""Variants end to end: tried, refused or written, read back, and put in the place of their twin."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from simfoundry.cousins.objects.generation import SourceSetup
from simfoundry.cousins.objects.item import ObjectAsset, item_of, item_of_asset, lowered
from simfoundry.cousins.objects.procedural import Draft
from simfoundry.cousins.objects.variants import Variants, procedural, variants, weighed, write
from simfoundry.cousins.recipe.candidate import ImpossibleError
from simfoundry.cousins.recipe.variant_pool import made_for, prepare
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.shapes import Mesh
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.lower import lower
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load, load_kind
from simfoundry.spec.models.cousins import ObjectAxis, ObjectVariants
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_yaml, write_tree
from tests.conftest import REPOSITORY
from tests.cousins.objects.test_checks import needs
from tests.cousins.objects.test_rules import CHANGES

AXIS = ObjectVariants(changes=CHANGES, count=3)


@pytest.fixture(scope="module")
def task() -> Loaded:
    return load_kind(REPOSITORY / "specs" / "tasks" / "cup_in_bowl.task.yaml", "task/1")


@pytest.fixture(scope="module")
def scene(task: Loaded) -> Loaded:
    assert isinstance(task.spec, TaskSpec)
    used = task.used(task.spec.scene)
    assert used is not None
    return used


@pytest.fixture(scope="module")
def bowl(scene: Loaded) -> ObjectAsset:
    return item_of(scene, "bowl")


@pytest.fixture(scope="module")
def bowls(bowl: ObjectAsset) -> Variants:
    return variants(bowl, AXIS, needs("cup_in_bowl", "bowl"), seed=5)


def test_variants_are_sound_canonical_and_distinct(bowls: Variants, tmp_path: Path) -> None:
    assert len(bowls.accepted) == 3 and not bowls.lacks
    for one, other in combinations(bowls.accepted, 2):
        assert one.likeness.apart(other.likeness).distance >= 1
    for variant in bowls.accepted:
        path = write(variant, tmp_path)
        read = load(path)
        assert not read.all_findings() and read.spec is not None
        assert path.read_text() == to_yaml(read.spec)
        assert path.name == f"{read.spec.name}.asset.yaml" and read.spec.name.startswith("bowl_")
        assert variant.distance >= 1 and variant.changed


def test_the_same_call_gives_the_same_documents_and_another_seed_others(bowl: ObjectAsset, bowls: Variants) -> None:
    one = AXIS.model_copy(update={"count": 1})
    again = variants(bowl, one, needs("cup_in_bowl", "bowl"), seed=5).accepted[0]
    assert to_yaml(again.spec) == to_yaml(bowls.accepted[0].spec)
    other = variants(bowl, one, needs("cup_in_bowl", "bowl"), seed=6).accepted[0]
    assert other.name != again.name


def test_what_is_refused_says_why_with_numbers() -> None:
    ball = item_of(load_kind(REPOSITORY / "specs" / "scenes" / "clear_table.scene.yaml", "scene/1"), "baseball")
    found = variants(ball, ObjectVariants(changes=("geometry",), count=2))
    assert len(found.accepted) < 2  # balls for one game do not differ by 6% twice
    assert found.reasons.keys() <= {"alike", "size"} and sum(found.reasons.values()) == len(found.refused)
    alike = next(one.reason for one in found.refused if one.reason.code == "alike")
    assert alike.text.startswith("it is too similar to another") and alike.numbers["size"] < 0.06


def test_a_swapped_scene_checks_and_lowers(scene: Loaded, task: Loaded, tmp_path: Path) -> None:
    assert isinstance(scene.spec, SceneSpec) and isinstance(task.spec, TaskSpec)
    (tmp_path / "simfoundry.yaml").touch()
    for name in ("scenes", "assets"):
        (tmp_path / name).mkdir()
        for file in (REPOSITORY / "specs" / name).glob("*.yaml"):
            (tmp_path / name / file.name).write_bytes(file.read_bytes())
    axis = ObjectAxis(objects={"bowl": AXIS.model_copy(update={"count": 2})})
    folder = tmp_path / "out" / "assets"
    records = prepare(axis, scene, [task.spec], 5, folder)
    assert len(records["bowl"]["accepted"]) == 2
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert prepare(axis, scene, [task.spec], 5, folder) == records
    assert before == {path: path.stat().st_mtime_ns for path in folder.iterdir()}  # nothing was made again


def test_variants_fill_a_variant_set(scene: Loaded, bowls: Variants, tmp_path: Path) -> None:
    assert isinstance(scene.spec, SceneSpec)
    paths = {v.name: write(v, tmp_path / "assets").relative_to(tmp_path).as_posix() for v in bowls.accepted}
    more = {"variants": {name: {"asset": path} for name, path in paths.items()}}
    shapes = {"shape": {"box": (1.0, 1.0, 0.1)}, "fixed": True, "mass": 3.0}
    data = {
        "simfoundry": "scene/1",
        "name": "set",
        "objects": {
            "table": shapes,
            "bowl": {"shape": {"sphere": 0.05}, "mass": 0.4, "place": {"on": "table"}, **more},
        },
    }
    path = tmp_path / "set.scene.yaml"
    path.write_text(write_tree(plain_tree(data), SceneSpec))
    found = lower(load_kind(path, "scene/1")).object("bowl")
    assert {v.variant for v in found.variants} == {v.name for v in bowls.accepted}


def test_a_shape_of_a_scene_varies_too(tmp_path: Path) -> None:
    path = tmp_path / "box.scene.yaml"
    path.write_text(
        "simfoundry: scene/1\nname: box\nmaterials:\n  wood: {density: 650, friction: 0.5, color: [0.2, 0.4, 0.7]}\n"
        "objects:\n  cube: {shape: {box: [0.05, 0.05, 0.05]}, material: wood, scale: 1, pose: {xyz: [0, 0, 0.025]}}\n"
    )
    read = load_kind(path, "scene/1")
    assert isinstance(read.spec, SceneSpec)
    found = variants(item_of(read, "cube"), ObjectVariants(count=2))
    assert len(found.accepted) == 2


def test_what_cannot_be_is_said_with_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SIMFOUNDRY_IMAGES_URL", "SIMFOUNDRY_IMAGES_MODEL", "SIMFOUNDRY_MESHES_URL"):
        monkeypatch.delenv(name, raising=False)

    def asked(**kw: object) -> ObjectAxis:
        return ObjectAxis(objects={"cube": ObjectVariants.model_validate({"count": 1, **kw})})

    table = load_kind(REPOSITORY / "specs" / "scenes" / "clear_table.scene.yaml", "scene/1")
    with pytest.raises(
        ImpossibleError,
        match=r"all 25 candidates for variants of `cube` were rejected: rules \(25 times\); for example: no rule",
    ):
        made_for(asked(components=("handle",)), table, [], 0, tmp_path, SourceSetup(table.path))
    with pytest.raises(
        ImpossibleError, match=r"source `model`, which needs models .* --vlm.*IMAGES_URL.*IMAGES_MODEL.*MESHES_URL"
    ):
        made_for(asked(sources=("model",)), table, [], 0, tmp_path, SourceSetup(table.path))
    with pytest.raises(SimfoundryError, match="is not a folder"):
        made_for(asked(sources=("library",)), table, [], 0, tmp_path, SourceSetup(table.path, tmp_path / "nowhere"))
    assert list(made_for(asked(), table, [], 0, tmp_path, SourceSetup(table.path))) == ["cube"]


def test_a_recipe_without_its_library_is_found() -> None:
    path, twin = REPOSITORY / "specs" / "cousins" / "r.cousins.yaml", "../scenes/clear_table.scene.yaml"
    text = f"simfoundry: cousins/1\nname: r\ntwin: {twin}\nobject: {{objects: {{cup: {{sources: [library]}}}}}}\n"
    found = load(path, text=text).findings
    assert [f.message for f in found if "library" in f.message] == [
        "variants of `cup` come from a library, but no library is given"
    ]


def test_variants_are_made_anew_where_the_library_has_changed(tmp_path: Path) -> None:
    table = load_kind(REPOSITORY / "specs" / "scenes" / "cup_in_bowl.scene.yaml", "scene/1")
    axis = ObjectAxis(objects={"cup": ObjectVariants(count=1, sources=("library",))})
    library, out = tmp_path / "library", tmp_path / "out"
    library.mkdir()
    text = (REPOSITORY / "specs" / "assets" / "cup.asset.yaml").read_text()
    (library / "other.asset.yaml").write_text(text.replace("[0.93, 0.93, 0.9]", "[0.1, 0.3, 0.8]"))
    given = SourceSetup(table.path, library)
    (first,) = made_for(axis, table, [], 0, out, given)["cup"]
    before = (out / "cup.variants.json").read_bytes()
    assert made_for(axis, table, [], 0, out, given)["cup"] == (first,)
    assert (out / "cup.variants.json").read_bytes() == before, "nothing is made twice"
    (library / "other.asset.yaml").write_text(text.replace("[0.93, 0.93, 0.9]", "[0.9, 0.9, 0.1]"))
    (other,) = made_for(axis, table, [], 0, out, given)["cup"]
    assert other != first and json.loads(before)["key"] != json.loads((out / "cup.variants.json").read_text())["key"]
    plain = ObjectAxis(objects={"cup": ObjectVariants(count=1)})
    rules = made_for(plain, table, [], 0, tmp_path / "rules", given)["cup"]
    (library / "more.txt").write_text("what rules make does not depend on a library")
    record = (tmp_path / "rules" / "cup.variants.json").read_bytes()
    assert made_for(plain, table, [], 0, tmp_path / "rules", given)["cup"] == rules
    assert (tmp_path / "rules" / "cup.variants.json").read_bytes() == record


@pytest.mark.slow  # 2 s
def test_a_variant_is_a_twin_itself_and_keeps_its_picture(tmp_path: Path) -> None:
    """What is seen of it is a textured mesh, and shapes collide: they change together, and the texture comes along."""
    spec = item_of_asset(load(REPOSITORY / "specs" / "assets" / "mug.asset.yaml"))
    draft = next(d for k in range(20) if "body with" in " ".join((d := procedural(spec, AXIS, 0, k)).changed))  # type: ignore[union-attr]
    assert isinstance(draft, Draft)
    folder = tmp_path / "first"
    for name, data in draft.files.items():
        write_atomically(folder / name, data)
    (folder / "mug.asset.yaml").write_text(to_yaml(weighed(draft.spec, spec.spec, {}, {})))
    twin = item_of_asset(load(folder / "mug.asset.yaml"))
    (again,) = variants(twin, AXIS.model_copy(update={"count": 1})).accepted
    path = write(again, tmp_path / "second")
    read = load(path)
    assert not read.errors, read.errors
    links = [lowered(d.spec, p.parent, "mug").links[0] for d, p in ((twin, folder / "x"), (again, path))]
    seen_as = [[v.geometry for v in link.visuals if isinstance(v.geometry, Mesh)] for link in links]
    pictures = [[mesh.texture for mesh in meshes if mesh.texture] for meshes in seen_as]
    assert pictures[0] and pictures[0] == pictures[1]
    spans = []
    for link in links:
        seen = max(float(np.ptp(v.geometry.vertices[:, 2])) for v in link.visuals if isinstance(v.geometry, Mesh))
        hulls = [c.geometry.vertices for c in link.colliders if isinstance(c.geometry, Mesh)]
        spans.append(float(np.ptp(np.concatenate(hulls)[:, 2])) / seen)
    assert spans[0] == pytest.approx(spans[1], rel=1e-3)
