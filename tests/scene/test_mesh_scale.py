"""Meshes scaled by another factor along each axis: mass, hulls, visuals, variants, and what a stage says of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from simfoundry.assets import mass
from simfoundry.assets.cache import Cache
from simfoundry.assets.mesh_summary import mesh_facts
from simfoundry.backends.usd import compile_usd
from simfoundry.frontends.usd.compiled.reading import read_spec
from simfoundry.scene.lower import lower_file
from simfoundry.scene.object_shapes import bounds
from tests.assets.meshes import blob, block, obj

FACTORS = (1.0, 0.5, 2.0)


def write(folder: Path, extra: str = "", scale: str = "[1, 0.5, 2]") -> Path:
    vertices, faces = block((0.1, 0.2, 0.3), (0.02, 0.0, 0.01))
    (folder / "it.obj").write_text(obj(vertices, faces))
    path = folder / "a.scene.yaml"
    path.write_text(
        "simfoundry: scene/1\nname: a\nobjects:\n"
        f"  it: {{asset: it.obj, scale: {scale}, density: 500, pose: {{xyz: [0, 0, 1]}}{extra}}}\n"
    )
    return path


def test_mass_bounds_and_visual_are_scaled_alike(tmp_path: Path) -> None:
    item = lower_file(write(tmp_path)).object("it")
    low, high = bounds(item)
    assert high - low == pytest.approx([0.1, 0.1, 0.6])
    expected = mass.box(np.array([0.1, 0.1, 0.6]))
    assert item.root.mass == pytest.approx(500 * expected.volume)
    assert item.root.com == pytest.approx([0.02, 0.0, 0.02])
    assert item.root.inertia == pytest.approx(500 * expected.inertia)
    visual = item.root.visuals[0].geometry
    assert np.ptp(visual.vertices, axis=0) == pytest.approx([0.1, 0.1, 0.6])  # type: ignore[union-attr]


def test_the_summary_scales_moments_as_the_mesh_does(tmp_path: Path) -> None:
    vertices, faces = blob(np.random.default_rng(4))
    (tmp_path / "it.obj").write_text(obj(vertices, faces))
    ours = mesh_facts(tmp_path / "it.obj", Cache(tmp_path / "cache")).solid(FACTORS, of_hull=False)
    exact = mass.mesh(np.round(vertices, 9) * FACTORS, faces)
    assert ours.volume == pytest.approx(exact.volume, rel=1e-6)
    assert ours.com == pytest.approx(exact.com, abs=1e-6)
    assert ours.inertia == pytest.approx(exact.inertia, rel=1e-5, abs=1e-9)


def test_z_is_up_for_files_with_y_up(tmp_path: Path) -> None:
    """A glTF file is turned upright before it is scaled."""
    path = write(tmp_path)
    upright = trimesh.creation.box(extents=[0.1, 0.3, 0.2])  # y up
    (tmp_path / "it.glb").write_bytes(upright.export(file_type="glb"))
    path.write_text(path.read_text().replace("it.obj", "it.glb"))
    low, high = bounds(lower_file(path).object("it"))
    assert high - low == pytest.approx([0.1, 0.1, 0.6])


def test_variants_have_their_own_scale(tmp_path: Path) -> None:
    path = write(tmp_path, ", variants: {tall: {scale: [1, 1, 3]}, small: {scale: 0.5}}")
    item = lower_file(path).object("it")
    sizes = {v.variant: np.subtract(*reversed(bounds(v))) for v in item.variants}
    assert sizes["tall"] == pytest.approx([0.1, 0.2, 0.9]) and sizes["small"] == pytest.approx([0.05, 0.1, 0.15])


def test_a_stage_scales_a_mesh_along_its_axes(tmp_path: Path) -> None:
    from pxr import Gf, Usd, UsdGeom

    compile_usd(lower_file(write(tmp_path, scale="1"))).write(tmp_path / "usd")
    stage = Usd.Stage.Open(str(tmp_path / "usd" / "scene.usda"))
    UsdGeom.Xformable(stage.GetPrimAtPath("/World/Objects/it")).AddScaleOp().Set(Gf.Vec3f(1, 2, 1))
    found = read_spec(stage)
    assert found is not None and found.data["objects"]["it"]["scale"] == (1.0, 2.0, 1.0)
