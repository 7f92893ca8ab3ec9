"""Variants of meshes, from a library, and from models."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from pydantic import BaseModel

from simfoundry.assets.mesh import open_edges, read_parts, weld
from simfoundry.cousins.objects.appearance import same_kind
from simfoundry.cousins.objects.generation import (
    ComponentNames,
    Generation,
    PictureVerdict,
    TopologyAnswer,
    Variations,
    fitted,
    picture_of,
    prompt,
)
from simfoundry.cousins.objects.item import ObjectAsset, item_of_mesh, lowered
from simfoundry.cousins.objects.meshes import deformed
from simfoundry.cousins.objects.retrieval import VariantLibrary, likeness
from simfoundry.cousins.objects.variants import variants
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.geometry.shapes import Capsule, tessellate
from simfoundry.models.contract import ModelError
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.images import ImageEstimate
from simfoundry.models.tasks.meshes import MeshEstimate, parse_glb
from simfoundry.scene.meshfile import obj_bytes
from simfoundry.scene.object_shapes import bounds
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.cousins import ObjectVariants
from tests.cousins.objects.test_rules import ASSETS, item

T = TypeVar("T", bound=BaseModel)


@pytest.fixture(scope="module")
def bean(tmp_path_factory: pytest.TempPathFactory) -> ObjectAsset:
    """A mesh of a capsule."""
    path = tmp_path_factory.mktemp("bean") / "bean.obj"
    path.write_bytes(obj_bytes(tessellate(Capsule(0.03, 0.06), 24)))
    return item_of_mesh(path, "bean", "toy", Material(density=500, friction=0.5, color=(0.8, 0.2, 0.2)))


def test_a_deformed_mesh_stays_closed_and_weighs_by_its_volume(bean: ObjectAsset, tmp_path: Path) -> None:
    for seed in range(5):
        spec, files, words = deformed(bean.spec, bean.files, np.random.default_rng(seed))
        assert words.startswith("deformed: x ")
        for name, data in files.items():
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(data)
        (part,) = read_parts(tmp_path / next(iter(files)))
        _, faces = weld(part.vertices, part.faces)
        assert open_edges(faces) == 0
        before = read_parts(bean.files["bean.obj"])[0]
        assert len(part.faces) == len(before.faces) and not np.allclose(part.vertices, before.vertices)
        thing = lowered(spec, tmp_path, "bean")
        assert thing.root.mass > 0


def test_variants_of_a_mesh_are_written_with_their_meshes(bean: ObjectAsset) -> None:
    found = variants(bean, ObjectVariants(count=2))
    assert len(found.accepted) == 2
    for variant in found.accepted:
        (name,) = (n for n in variant.files if n.endswith(".obj"))
        assert variant.spec.links["body"].parts["mesh"].mesh == name
        mass, low_high = variant.spec.links["body"].mass, variant.item.root.mass
        assert getattr(mass, "value", None) == pytest.approx(low_high)


# -- library ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> VariantLibrary:
    folder = tmp_path_factory.mktemp("library")
    for name in ("cup", "blue_cup", "orange_cup", "bowl", "cube"):
        (folder / f"{name}.asset.yaml").write_bytes((ASSETS / f"{name}.asset.yaml").read_bytes())
    (folder / "cups").mkdir()
    mesh = tessellate(Capsule(0.03, 0.06), 24)
    (folder / "cups" / "tall.obj").write_bytes(obj_bytes(mesh))
    lines = obj_bytes(mesh).splitlines(keepends=True)
    (folder / "cups" / "open.obj").write_bytes(b"".join(lines[:-3]))
    return VariantLibrary(folder)


def test_a_library_says_what_it_leaves_out(library: VariantLibrary) -> None:
    assert {e.item.name for e in library.entries} >= {"cup", "blue_cup", "orange_cup", "bowl", "cube", "tall"}
    assert list(library.left_out) == ["cups/open.obj"] and "not closed" in library.left_out["cups/open.obj"]


def test_a_library_ranks_by_kind_size_and_shape(library: VariantLibrary) -> None:
    cup = item("cup")
    ranked = library.ranked(cup, likeness(lowered(cup.spec, ASSETS, "cup")))
    names = [entry.item.name for _, _, entry in ranked]
    assert set(names[:2]) == {"blue_cup", "orange_cup"} and "cup" not in names  # itself is no variant
    assert all(a[0] <= b[0] for a, b in pairwise(ranked))
    factors = {entry.item.name: factor for _, factor, entry in ranked}
    assert factors["blue_cup"] == pytest.approx(1) and 0.5 <= factors["bowl"] <= 2


def test_retrieval_takes_what_is_of_the_kind_and_scales_it(library: VariantLibrary) -> None:
    axis = ObjectVariants(sources=("library",), count=3)
    found = variants(item("cup"), axis, sources={"library": library})
    assert {v.spec.category for v in found.accepted} == {"cup"} and len(found.accepted) == 2
    assert {"kind", "library"} >= set(found.reasons) - {"alike", "stands", "mass", "size"}
    assert any("`cube`, is a cube, not a cup" in one.reason.text for one in found.refused)
    assert same_kind("blue_cup", "tumbler") and not same_kind("cup", "bowl") and same_kind("wing_nut", "nut")


# -- models -----------------------------------------------------------------------------------------------------------

SAID = {
    "A": ComponentNames(components=["body", "rim"]),
    "B body": TopologyAnswer(yes=True),
    "B rim": TopologyAnswer(yes=False),
    "C body": Variations(geometry=["a wider body"], topology=["a loop handle"], visual=["a matte green glaze"]),
    "C rim": Variations(geometry=["a rim that flares outward"], topology=["a spout"], visual=["a golden edge"]),
}
"""Answers written by hand in the types of the prompts; no model was asked."""


@cache
def small() -> bytes:
    """A picture of a mug."""
    return picture_of(item("mug"), 48)


class Told:
    """A VLM that answers from :data:`SAID`, and finds every second picture unreasonable."""

    name = "told"

    def __init__(self) -> None:
        self.asked: list[str] = []

    def ask(self, prompt: str, pictures: Sequence[bytes], answer: type[T]) -> T:
        assert all(p.startswith(b"\x89PNG") for p in pictures)
        self.asked.append(prompt)
        given: Any
        if answer is PictureVerdict:
            good = sum("RealWorldReasonable" in text for text in self.asked) % 2 == 0
            given = PictureVerdict(
                real_world_reasonable=good, real_world_reason="melted", scene_reasonable=True, scene_reason="fits"
            )
        elif answer is ComponentNames:
            given = SAID["A"]
        else:
            letter = "B" if answer is TopologyAnswer else "C"
            given = SAID[f"{letter} {'rim' if 'rim' in prompt.split('list')[0] else 'body'}"]
        assert isinstance(given, answer)
        return given


class Painter:
    """Gives back the picture that it should edit."""

    def __init__(self) -> None:
        self.prompts: list[str] = []

    def edit_image(self, prompt: str, images: Sequence[Any], seed: int = 0) -> ImageEstimate:
        self.prompts.append(prompt)
        assert len(images) == 2
        return ImageEstimate(images[0], ModelIdentity(name="qwen-image-edit", version="1", licence="Apache-2.0"))


class Sculptor:
    """Makes a mesh of a cylinder-like capsule in units of its own, y up, as GLB files are."""

    def make_mesh(self, image: Any, texture: bool = True, faces: int = 20_000, seed: int = 0) -> MeshEstimate:
        import trimesh

        mesh = trimesh.creation.cylinder(radius=0.4 + 0.02 * (seed % 5), height=1.0, sections=24)
        mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
        data = mesh.export(file_type="glb")
        assert isinstance(data, bytes) and image.shape[2] == 4
        return MeshEstimate(data, parse_glb(data), ModelIdentity(name="trellis.2-4b", version="2", licence="MIT"))


def test_models_propose_edit_build_and_judge_as_the_paper_has_it() -> None:
    vlm, painter = Told(), Painter()
    source = Generation(vlm, painter, Sculptor(), small(), small())  # type: ignore[arg-type]
    cup = item("cup")
    axis = ObjectVariants(sources=("model",), changes=("geometry", "topology", "appearance"), count=2)
    found = variants(cup, axis, sources={"model": source})
    asked = [text.split("\n")[0][:40] for text in vlm.asked[:5]]
    assert asked[0].startswith("With the given object image, decompose") and asked[1].startswith("For the body of")
    assert "Topological" in vlm.asked[2] and "Topological" not in vlm.asked[4]  # B said no for the rim
    assert "'body'" in painter.prompts[0] and "Apply this geometry variation: a wider body." in painter.prompts[0]
    assert painter.prompts[0] == painter.prompts[1]  # the first picture was not reasonable, so it was asked for again
    assert [v.changed[0] for v in found.accepted][:1] == ["body, geometry: a wider body"]
    first = found.accepted[0]
    low, high = bounds(first.item)
    before_low, before_high = bounds(lowered(cup.spec, ASSETS, "cup"))
    assert low[2] == pytest.approx(0, abs=1e-6)
    assert np.prod(high - low) == pytest.approx(np.prod(before_high - before_low), rel=0.02)
    assert first.spec.materials["stuff"].density == 950
    assert first.spec.origin is not None
    stated = [(use.task, use.name, use.version, use.commercial) for use in first.spec.origin.models]
    assert stated == [
        ("propose", "told", "as served", "unknown"),
        ("edit", "qwen-image-edit", "1", "allowed"),
        ("mesh", "trellis.2-4b", "2", "conditional"),
    ]


def test_pictures_that_are_never_reasonable_are_a_reason() -> None:
    class Never(Told):
        def ask(self, prompt: str, pictures: Sequence[bytes], answer: type[T]) -> T:
            if answer is PictureVerdict:
                bad: Any = PictureVerdict(
                    real_world_reasonable=True, real_world_reason="", scene_reasonable=False, scene_reason="too shiny"
                )
                assert isinstance(bad, answer)
                return bad
            return super().ask(prompt, pictures, answer)

    source = Generation(Never(), Painter(), Sculptor(), small(), small())  # type: ignore[arg-type]
    refused = source(item("cup"), ObjectVariants(sources=("model",)), 0, 0)
    assert isinstance(refused, Reason) and refused.code == "picture"
    assert refused.text == "body, a wider body: none of 3 images was judged reasonable: too shiny"
    beyond = source(item("cup"), ObjectVariants(sources=("model",)), 0, 99)
    assert isinstance(beyond, Reason) and beyond.text.startswith("the model proposed only 4 changes")


def test_a_model_that_fails_is_a_reason_and_no_crash() -> None:
    class Silent:
        def edit_image(self, prompt: str, images: Sequence[Any], seed: int = 0) -> ImageEstimate:
            raise ModelError("the image model at http://here does not answer")

    source = Generation(Told(), Silent(), Sculptor(), small(), small())  # type: ignore[arg-type]
    made = source(item("cup"), ObjectVariants(sources=("model",)), 0, 0)
    assert made == Reason("model", "the image model at http://here does not answer")


def test_a_made_mesh_is_fitted_to_the_twin() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)) * [3, 2, 7] + 11
    low, high = np.array([-0.1, -0.2, 0.0]), np.array([0.1, 0.2, 0.3])
    out = fitted(points, low, high)
    assert out[:, 2].min() == pytest.approx(0) and np.allclose((out.min(0) + out.max(0))[:2], 0)
    assert np.prod(np.ptp(out, axis=0)) == pytest.approx(np.prod(high - low))


def test_prompts_are_those_of_the_paper_with_their_variables() -> None:
    with pytest.raises(Exception, match="component"):
        prompt("b_topology")
    text = prompt("d_edit", component="handle", dimension="visual", variation_description="a wooden handle")
    assert text.startswith("Modify the following component of the object: 'handle'.")
    assert "Apply this visual variation: a wooden handle." in text and "{" not in text
    assert prompt("e_verify").endswith("SceneReasonable: <yes/no>; SceneReason: <short reason>")


def test_the_picture_for_models_is_transparent_around_the_thing() -> None:
    from PIL import Image

    with Image.open(io.BytesIO(small())) as picture:
        alpha = np.asarray(picture)[..., 3]
    assert picture.mode == "RGBA" and alpha[0, 0] == 0 and alpha[24, 24] == 255 and 0.1 < (alpha > 0).mean() < 0.7
