"""What is kept of a mesh file is what lowering finds in it, and is found without opening it again."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from simfoundry.assets import convex
from simfoundry.assets import mesh_summary as module
from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import MAX_BYTES, MeshError
from simfoundry.assets.mesh_summary import MeshFacts, measure, mesh_facts
from simfoundry.lint.lints import lint
from simfoundry.scene.lower import lower
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load
from tests.assets.coarse import COARSE
from tests.assets.meshes import blob, block, obj
from tests.conftest import REPOSITORY

BAD = REPOSITORY / "tests" / "spec" / "bad" / "meshes"
MESHES = ("cube.obj", "open.obj", "flat.obj", "empty.obj", "nan.obj", "points.obj", "millimeters.obj", "not_a_mesh.stl")
FIELDS = (
    "",
    "solid: hull, ",
    "collision: none, ",
    "collision: hull, ",
    "scale: 0.001, ",
    "scale: [1, 0.5, 2], ",
    "scale: [0.001, 0.002, 0.003], solid: hull, ",
    "solid: hull, collision: none, ",
)


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(tmp_path / "cache"))
    module._facts.cache_clear()


def scene(folder: Path, mesh: str, fields: str) -> Path:
    (folder / "simfoundry.yaml").touch()
    (folder / mesh).write_bytes((BAD / mesh).read_bytes())
    path = folder / "desk.scene.yaml"
    path.write_text(f"simfoundry: scene/1\nname: desk\nobjects:\n  cup: {{asset: {mesh}, {fields}mass: 0.2}}\n")
    return path


@pytest.mark.parametrize("fields", FIELDS)
@pytest.mark.parametrize("mesh", MESHES)
def test_a_check_finds_what_lowering_finds(
    mesh: str, fields: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex, "FUNCTION", COARSE)
    path = scene(tmp_path, mesh, fields)
    try:
        lower(load(path))
        expected = []
    except SpecError as error:
        expected = error.diagnostics
    for _ in range(2):  # measured, then from the cache
        assert list(lint(load(path))) == expected


def test_a_visual_needs_no_volume(tmp_path: Path) -> None:
    path = scene(tmp_path, "open.obj", "")
    text = path.read_text().replace("asset: open.obj", "shape: {sphere: 0.1}, visual: open.obj")
    path.write_text(text)
    assert lint(load(path)) == ()
    path.write_text(text.replace("mass", "scale: 1000, mass"))
    assert [d.code for d in lint(load(path))] == ["SF303"]


def test_a_part_of_an_asset_is_checked_where_it_is_written(tmp_path: Path) -> None:
    path = scene(tmp_path, "open.obj", "")
    asset = tmp_path / "cup.asset.yaml"
    asset.write_text("simfoundry: asset/1\nname: cup\nlinks:\n  body: {mass: 1, parts: {it: {mesh: open.obj}}}\n")
    path.write_text("simfoundry: scene/1\nname: desk\nobjects:\n  cup: {asset: cup.asset.yaml}\n")
    for document in (path, asset):
        (d,) = lint(load(document))
        assert (d.code, Path(d.file).name, d.path) == ("SF302", "cup.asset.yaml", "links.body.parts.it")


def test_facts_survive_the_cache(tmp_path: Path) -> None:
    path = tmp_path / "it.obj"
    path.write_text(obj(*block((0.1, 0.2, 0.3), (1, 2, 3))))
    cache = Cache(tmp_path / "store")
    first = mesh_facts(path, cache)
    module._facts.cache_clear()
    assert mesh_facts(path, cache) == first == measure(path)
    assert first.size() == pytest.approx(0.3)
    assert (first.triangles, first.gaps) == (12, 0)
    assert first.volume == pytest.approx(0.006)
    assert first.hull_volume == pytest.approx(0.006)
    assert np.array(first.hull).mean(axis=0) == pytest.approx([1, 2, 3])
    assert len(first.hull) == 8


def test_a_mesh_that_is_not_convex_says_so(tmp_path: Path) -> None:
    path = tmp_path / "it.obj"
    path.write_text(obj(*blob(np.random.default_rng(1))))
    facts = measure(path)
    assert 0 < facts.volume < 0.9 * facts.hull_volume
    assert facts.gaps == 0
    assert len(facts.hull) <= 64


def test_another_content_is_measured_anew(tmp_path: Path) -> None:
    path, cache = tmp_path / "it.obj", Cache(tmp_path / "store")
    path.write_text(obj(*block((0.1, 0.1, 0.1))))
    assert mesh_facts(path, cache).size() == pytest.approx(0.1)
    path.write_text(obj(*block((0.1, 0.1, 0.25))))
    assert mesh_facts(path, cache).size() == pytest.approx(0.25)


def test_a_damaged_entry_is_measured_anew(tmp_path: Path) -> None:
    path, cache = tmp_path / "it.obj", Cache(tmp_path / "store")
    path.write_text(obj(*block((0.1, 0.1, 0.1))))
    facts = mesh_facts(path, cache)
    (entry,) = [p for p in (tmp_path / "store").rglob("*") if p.is_file()]
    for damage in (b"", b"{", b"[]", b'{"size": 1}', b'{"hull": [[1, 2]]}', b"\xff"):
        entry.write_bytes(damage)
        module._facts.cache_clear()
        assert mesh_facts(path, cache) == facts


def test_a_file_beyond_all_bounds_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "it.stl"
    with path.open("wb") as stream:
        stream.truncate(MAX_BYTES + 1)
    with pytest.raises(MeshError) as caught:
        mesh_facts(path)
    assert (caught.value.code, caught.value.message) == ("SF301", "it.stl has 256 MiB; the limit is 256 MiB")
    with pytest.raises(MeshError) as caught:
        mesh_facts(tmp_path / "absent.stl")
    assert caught.value.code == "SF301"


@pytest.mark.parametrize("scale", [1.0, 0.001, 1000.0])
def test_the_volume_goes_with_the_cube_of_the_scale(scale: float) -> None:
    thin = MeshFacts((1.0, 0.5, 0.2), 12, 0, 2e-10, 1.0, ((0.0, 0.0, 0.0),))
    fault = thin.fault("it.obj", scale, "exact", "auto")
    expected = {1.0: None, 0.001: "SF301", 1000.0: "SF303"}[scale]
    assert (fault.code if fault is not None else None) == expected


def test_a_second_check_reads_no_mesh(tmp_path: Path) -> None:
    path = scene(tmp_path, "cube.obj", "")
    code = (
        "import sys; from pathlib import Path\n"
        "from simfoundry.lint.lints import lint; from simfoundry.spec.load import load\n"
        f"lint(load(Path({str(path)!r})))\n"
        "print(*sorted({'numpy', 'trimesh', 'scipy'} & set(sys.modules)))"
    )
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY)
        for _ in range(2)
    ]
    assert [r.stdout.split() for r in runs] == [["numpy", "scipy", "trimesh"], ["numpy"]]
