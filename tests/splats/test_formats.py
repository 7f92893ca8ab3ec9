"""Splat files: round trips that are exact to the precision of each format, and files that are not what they claim."""

from __future__ import annotations

import gzip
import json
import math
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from simfoundry.assets.errors import MeshError
from simfoundry.geometry.frames import Pose, matrix_from_quat, quat_from_rpy, rotations
from simfoundry.geometry.similarity import Similarity
from simfoundry.splats.files import read_splat, splat_bytes
from simfoundry.splats.gaussians import GaussianSplat
from simfoundry.splats.harmonics import harmonic_basis
from simfoundry.splats.spz import spz_bytes
from tests.splats.random_splats import random_splat

splats = st.builds(random_splat, st.integers(1, 40), st.integers(0, 3), st.integers(0, 2**32 - 1))
few = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def again(splat: GaussianSplat, path: Path) -> GaussianSplat:
    path.write_bytes(splat_bytes(splat, path.name))
    return read_splat(path)


def apart(one: GaussianSplat, two: GaussianSplat) -> np.ndarray:
    """Return the angles between the rotations of two splats [rad]; q and -q are the same rotation."""
    turn = rotations(one.rotations.astype(np.float64)).transpose(0, 2, 1) @ rotations(two.rotations.astype(np.float64))
    sine = np.linalg.norm(turn - turn.transpose(0, 2, 1), axis=(1, 2)) / math.sqrt(8)
    return np.asarray(np.arctan2(sine, (np.trace(turn, axis1=1, axis2=2) - 1) / 2))


@few
@given(splat=splats)
def test_ply_keeps_single_precision(splat: GaussianSplat, tmp_path: Path) -> None:
    found = again(splat, tmp_path / "a.ply")
    np.testing.assert_array_equal(found.positions, splat.positions)
    np.testing.assert_array_equal(found.harmonics, splat.harmonics)
    np.testing.assert_allclose(found.rotations, splat.rotations, rtol=0, atol=1.2e-7)
    np.testing.assert_allclose(found.scales, splat.scales, rtol=2e-6)  # the logarithm has 24 bits
    np.testing.assert_allclose(found.opacities, splat.opacities, rtol=2e-6)
    ends = (splat.opacities == 0) | (splat.opacities == 1)
    np.testing.assert_array_equal(found.opacities[ends], splat.opacities[ends])


@few
@given(splat=splats, suffix=st.sampled_from([".glb", ".usda", ".usdc"]))
def test_gltf_and_usd_keep_every_bit(splat: GaussianSplat, suffix: str, tmp_path: Path) -> None:
    found = again(splat, tmp_path / f"a{suffix}")
    for name in ("positions", "scales", "opacities", "harmonics"):
        np.testing.assert_array_equal(getattr(found, name), getattr(splat, name), err_msg=name)
    np.testing.assert_allclose(found.rotations, splat.rotations, rtol=0, atol=1.2e-7)  # normalized once more


@few
@given(splat=splats, version=st.sampled_from([2, 3]))
def test_spz_is_exact_to_its_steps(splat: GaussianSplat, version: int, tmp_path: Path) -> None:
    (tmp_path / "a.spz").write_bytes(spz_bytes(splat, version))  # type: ignore[arg-type]
    found = read_splat(tmp_path / "a.spz")
    fraction = min(20, math.floor(math.log2((2**23 - 1) / np.abs(splat.positions).max())))
    np.testing.assert_allclose(found.positions, splat.positions, rtol=0, atol=0.502 / 2**fraction)
    seen = splat.scales > 4.6e-5
    np.testing.assert_allclose(np.log(found.scales[seen]), np.log(splat.scales[seen]), rtol=0, atol=0.5001 / 16)
    np.testing.assert_allclose(found.opacities, splat.opacities, rtol=0, atol=0.5001 / 255)
    np.testing.assert_allclose(found.harmonics[:, 0], splat.harmonics[:, 0], rtol=0, atol=0.5001 / 255 / 0.15)
    # Steps of 1/127.5 near w = 0 turn a quaternion by up to 15 degrees in version 2; 9 bits and a sign do not.
    assert apart(found, splat).max() < math.radians(0.35 if version == 3 else 16.0)
    (tmp_path / "b.spz").write_bytes(spz_bytes(found, version))  # type: ignore[arg-type]
    twice = read_splat(tmp_path / "b.spz")
    for name in ("positions", "scales", "opacities", "harmonics"):  # which are all at steps now
        np.testing.assert_array_equal(getattr(twice, name), getattr(found, name), err_msg=name)
    # If the two largest components are almost equal, the other one may be left out the second time.
    assert apart(twice, found).max() < math.radians(0.35 if version == 3 else 1e-4)


@pytest.mark.parametrize("degree", [0, 3])
def test_spz_version_4_has_the_values_of_version_3_in_streams(degree: int, tmp_path: Path) -> None:
    zstandard = pytest.importorskip("zstandard")
    three = spz_bytes(random_splat(50, degree, 0), 3)
    body = gzip.decompress(three)
    sizes = [50 * size for size in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1))]
    at = np.cumsum([16, *sizes])
    streams = [zstandard.compress(body[a:b]) for a, b in pairwise(at)]
    # Header, table of sizes, and streams, as in the README of nianticlabs/spz.
    head = body[:4] + struct.pack("<I", 4) + body[8:15] + struct.pack("<BI12x", len(streams), 32)
    table = b"".join(struct.pack("<QQ", len(one), size) for one, size in zip(streams, sizes, strict=True))
    (tmp_path / "four.spz").write_bytes(head + table + b"".join(streams))
    (tmp_path / "three.spz").write_bytes(three)
    four, same = (read_splat(tmp_path / f"{name}.spz") for name in ("four", "three"))
    for name in ("positions", "scales", "rotations", "opacities", "harmonics"):
        np.testing.assert_array_equal(getattr(four, name), getattr(same, name))
    damaged = bytearray(head + table + b"".join(streams))
    damaged[len(head + table)] ^= 0xFF
    (tmp_path / "four.spz").write_bytes(damaged)
    with pytest.raises(MeshError, match="compressed data is damaged"):
        read_splat(tmp_path / "four.spz")
    (tmp_path / "four.spz").write_bytes(head[:14] + b"\2" + head[15:] + table + b"".join(streams))
    with pytest.raises(MeshError, match="extensions, which are not supported"):
        read_splat(tmp_path / "four.spz")


def test_spz_has_the_bytes_that_its_format_defines(tmp_path: Path) -> None:
    """Values of one Gaussian, computed by hand from Niantic's description, along its y-up axes."""
    smallest = 0b11 << 30 | (0 << 9 | 361) << 20 | (1 << 9 | 0) << 10 | (1 << 9 | 255)  # xyz; w is the largest
    body = struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 0, 12, 0, 0)
    body += (4096).to_bytes(3, "little") + (-2048).to_bytes(3, "little", signed=True) + (1).to_bytes(3, "little")
    body += bytes([128, 255, 0, 128, 160, 96, 112]) + smallest.to_bytes(4, "little")
    (tmp_path / "a.spz").write_bytes(gzip.compress(body))
    found = read_splat(tmp_path / "a.spz")
    np.testing.assert_allclose(found.positions, [[1.0, -1 / 4096, -0.5]], atol=1e-7)  # y up became z up
    assert found.opacities[0] == pytest.approx(128 / 255)
    np.testing.assert_allclose(found.harmonics[0, 0], [0.5 / 0.15, -0.5 / 0.15, (128 / 255 - 0.5) / 0.15], rtol=1e-6)
    np.testing.assert_allclose(found.scales, np.exp([[0.0, -4.0, -3.0]]), rtol=1e-6)
    x, z = 361 / 511 * math.sqrt(0.5), -255 / 511 * math.sqrt(0.5)
    turn = matrix_from_quat(np.array([math.sqrt(1 - x * x - z * z), x, 0.0, z]))
    quarter = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from y up to z up
    np.testing.assert_allclose(matrix_from_quat(found.rotations[0].astype(float)), quarter @ turn, atol=1e-6)


@few
@given(splat=splats, rpy=st.tuples(*[st.floats(-3, 3)] * 3), scale=st.floats(0.01, 50))
def test_a_moved_splat_looks_the_same_from_a_moved_camera(
    splat: GaussianSplat, rpy: tuple[float, float, float], scale: float
) -> None:
    S_AF = Similarity(Pose.of((0.3, -2.0, 1.1), quat_from_rpy(*rpy)), scale)
    moved = splat.moved(S_AF)
    np.testing.assert_allclose(moved.positions, S_AF.apply(splat.positions.astype(float)), rtol=1e-5, atol=1e-5 * scale)
    axes = rotations(splat.rotations.astype(float)) * splat.scales[:, None]
    other = rotations(moved.rotations.astype(float)) * moved.scales[:, None]
    np.testing.assert_allclose(other, scale * S_AF.X_AB.rotation @ axes, rtol=0, atol=2e-5 * scale)
    d = np.random.default_rng(0).normal(size=(len(splat), 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    colors = np.einsum("nk,nkc->nc", harmonic_basis(d, splat.degree), splat.harmonics)
    turned = np.einsum("nk,nkc->nc", harmonic_basis(d @ S_AF.X_AB.rotation.T, splat.degree), moved.harmonics)
    np.testing.assert_allclose(turned, colors, rtol=0, atol=1e-5)


def test_the_basis_has_the_signs_of_the_trainers() -> None:
    """Values at one direction, from appendix A of KHR_gaussian_splatting."""
    x, y, z = np.array([2.0, -3.0, 6.0]) / 7
    expected = [
        0.282094791773878, -0.488602511902920 * y, 0.488602511902920 * z, -0.488602511902920 * x,
        1.092548430592079 * x * y, -1.092548430592079 * y * z, 0.315391565252520 * (2 * z * z - x * x - y * y),
        -1.092548430592079 * x * z, 0.546274215296040 * (x * x - y * y), -0.590043589926644 * y * (3 * x * x - y * y),
        2.890611442640554 * x * y * z, -0.457045799464466 * y * (4 * z * z - x * x - y * y),
        0.373176332590115 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.457045799464466 * x * (4 * z * z - x * x - y * y),
        1.445305721320277 * z * (x * x - y * y), -0.590043589926644 * x * (x * x - 3 * y * y),
    ]  # fmt: skip
    np.testing.assert_allclose(harmonic_basis(np.array([[x, y, z]]), 3)[0], expected, rtol=1e-12)


def test_equal_splats_have_equal_bytes() -> None:
    for suffix in (".ply", ".spz", ".glb", ".usda", ".usdc"):
        one, two = (splat_bytes(random_splat(20, 2, 5), f"a{suffix}") for _ in range(2))
        assert one == two, suffix


def test_glb_nodes_place_their_splats(tmp_path: Path) -> None:
    splat = random_splat(5, 1, 1)
    data = splat_bytes(splat, "a.glb")
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    # Two copies below a node that turns by 90 degrees about y and scales by 2; y is up.
    tree["nodes"] = [
        {"children": [1, 2], "scale": [2, 2, 2], "rotation": [0, math.sqrt(0.5), 0, math.sqrt(0.5)]},
        {"mesh": 0}, {"mesh": 0, "translation": [0, 1, 0]},
    ]  # fmt: skip
    (tmp_path / "a.glb").write_bytes(with_json(data, tree))
    found = read_splat(tmp_path / "a.glb")
    assert len(found) == 10
    x, y, z = splat.positions.T
    # z, y, -x in glTF's axes, twice as large; then y up becomes z up: (z, x, y).
    expected = 2 * np.stack([z, x, y], axis=1)
    both = sorted(map(tuple, np.concatenate([expected, expected + [0, 0, 2]])))
    np.testing.assert_allclose(sorted(map(tuple, found.positions)), both, atol=1e-5)


def test_usd_units_and_axes_are_converted(tmp_path: Path) -> None:
    splat = random_splat(4, 0, 2)
    text = splat_bytes(splat, "a.usda").decode()
    text = text.replace("metersPerUnit = 1", "metersPerUnit = 0.01").replace('upAxis = "Z"', 'upAxis = "Y"')
    (tmp_path / "a.usda").write_text(text)
    found = read_splat(tmp_path / "a.usda")
    x, y, z = splat.positions.T
    np.testing.assert_allclose(found.positions, 0.01 * np.stack([x, -z, y], axis=1), rtol=1e-6)
    np.testing.assert_allclose(found.scales, 0.01 * splat.scales, rtol=1e-6)


def test_ply_may_be_text_or_big_endian(tmp_path: Path) -> None:
    splat = random_splat(6, 1, 3, extremes=False)
    data = splat_bytes(splat, "a.ply")
    end = data.index(b"end_header\n") + len(b"end_header\n")
    head, rows = data[:end], np.frombuffer(data[end:], "<f4").reshape(6, -1)
    lines = "\n".join(" ".join(repr(float(v)) for v in row) for row in rows)
    (tmp_path / "text.ply").write_bytes(head.replace(b"binary_little_endian", b"ascii") + lines.encode())
    (tmp_path / "big.ply").write_bytes(head.replace(b"little", b"big") + rows.astype(">f4").tobytes())
    (tmp_path / "a.ply").write_bytes(data)
    expected = read_splat(tmp_path / "a.ply")
    for name in ("text.ply", "big.ply"):
        for values, wanted in zip(vars(read_splat(tmp_path / name)).values(), vars(expected).values(), strict=True):
            np.testing.assert_array_equal(values, wanted)


def with_json(data: bytes, tree: dict[str, object]) -> bytes:
    size = struct.unpack_from("<I", data, 12)[0]
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = struct.pack("<II", len(text), 0x4E4F534A) + text + data[20 + size :]
    return struct.pack("<4sII", b"glTF", 2, 12 + len(rest)) + rest


def edited(change: Callable[[dict[str, object]], object]) -> bytes:
    data = splat_bytes(random_splat(3, 0, 0), "a.glb")
    tree = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    change(tree)
    return with_json(data, tree)


def spz_head(version: int, count: int, degree: int = 0, fraction: int = 12) -> bytes:
    return struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, fraction, 0, 0)


PLY, SPZ, GLB = (splat_bytes(random_splat(3, 0, 0), f"a{suffix}") for suffix in (".ply", ".spz", ".glb"))
USD = splat_bytes(random_splat(3, 0, 0), "a.usda").decode()
REFERENCE = USD.replace('Splat "splat"\n', 'Splat "splat" (references = @/etc/passwd@)\n')

HOSTILE: dict[str, tuple[str, bytes, str]] = {
    "no ply": ("a.ply", b"no ply", "no PLY header"),
    "empty": ("a.ply", b"", "no PLY header"),
    "short ply": ("a.ply", PLY[:-1], "ends before its last Gaussian"),
    "promised": ("a.ply", PLY.replace(b"vertex 3", b"vertex 4000000"), "ends before its last Gaussian"),
    "too many": ("a.ply", PLY.replace(b"vertex 3", b"vertex 99999999999"), "must have 1 to 5000000"),
    "none": ("a.ply", PLY.replace(b"vertex 3", b"vertex 0"), "has 0 Gaussians"),
    "compressed": ("a.ply", PLY.replace(b"float opacity", b"float packed_color"), "`opacity` is missing"),
    "mesh": ("a.ply", PLY.replace(b"property float x", b"property list uchar int x"), "lists"),
    "twice": ("a.ply", PLY.replace(b"float ny", b"float nx"), "same name"),
    "odd type": ("a.ply", PLY.replace(b"property float x", b"property quad x"), "cannot be understood"),
    "not a number": ("a.ply", PLY[:-4] + np.float32(np.nan).tobytes(), "non-finite"),
    "overflow": ("a.ply", PLY[:-32] + np.float32(99.0).tobytes() * 4 + PLY[-16:], "non-finite"),
    "bare body": ("a.spz", gzip.decompress(SPZ)[16:], "damaged"),
    "zip bomb": ("a.spz", gzip.compress(spz_head(3, 2) + bytes(10**7)), ""),
    "claims": ("a.spz", gzip.compress(spz_head(3, 4_000_000)), "ends before its last Gaussian"),
    "billions": ("a.spz", gzip.compress(spz_head(3, 2**32 - 1)), "must have 1 to 5000000"),
    "version 1": ("a.spz", gzip.compress(spz_head(1, 3)), "version 1"),
    "version 5": ("a.spz", spz_head(5, 3) + bytes(16), "version 5"),
    "version 4 in gzip": ("a.spz", gzip.compress(spz_head(4, 3)), "version 4"),
    "version 4 cut": ("a.spz", spz_head(4, 3), "ends in its header"),
    "version 4 without streams": ("a.spz", spz_head(4, 3) + bytes(16), "0 streams"),
    "version 4 far away": ("a.spz", spz_head(4, 3)[:-1] + b"\6" + b"\xff" * 4 + bytes(12), "6 streams"),
    "version 4 claims": ("a.spz", spz_head(4, 3)[:-1] + b"\6 " + bytes(15 + 96), "size of 3 Gaussians"),
    "degree": ("a.spz", gzip.compress(spz_head(3, 1, 9)), "degree 9"),
    "fraction": ("a.spz", gzip.compress(spz_head(3, 1, 0, 99)), "99 bits"),
    "other gzip": ("a.spz", gzip.compress(b"hello, this is no splat"), "not an SPZ file"),
    "cut gzip": ("a.spz", SPZ[:40], "ends before its last Gaussian"),
    "no glb": ("a.glb", b"glTF" + bytes(30), "not a GLB file"),
    "cut glb": ("a.glb", GLB[:-20], "binary chunk is damaged"),
    "list": ("a.glb", with_json(GLB, []), "does not describe a glTF"),  # type: ignore[arg-type]
    "no extension": ("a.glb", edited(lambda t: t.pop("extensionsUsed")), "does not use the extension"),
    "no scene": ("a.glb", edited(lambda t: t.pop("scenes")), "does not describe a glTF"),
    "loop": ("a.glb", edited(lambda t: t["nodes"][0].update(children=[0])), "contain themselves"),  # type: ignore[index]
    "sheared": ("a.glb", edited(lambda t: t["nodes"][0].update(scale=[1, 2, 1])), "scaled unevenly"),  # type: ignore[index]
    "negative": ("a.glb", edited(lambda t: t["accessors"][1].update(count=-5)), "beyond the data"),  # type: ignore[index]
    "counts": ("a.glb", edited(lambda t: t["accessors"][0].update(count=10**6)), "another count"),  # type: ignore[index]
    "huge view": ("a.glb", edited(lambda t: t["accessors"][2].update(count=10**9)), "beyond the data"),  # type: ignore[index]
    "float count": ("a.glb", edited(lambda t: t["accessors"][0].update(count=1.5)), "not a number"),  # type: ignore[index]
    "offset": ("a.glb", edited(lambda t: t["accessors"][0].update(byteOffset=-4)), "beyond the data"),  # type: ignore[index]
    "uri": ("a.glb", edited(lambda t: t["buffers"][0].update(uri="/etc/passwd")), "outside the file"),  # type: ignore[index]
    "no usd": ("a.usda", b"#usda 9.9 nonsense", "not a USD file"),
    "reference": ("a.usda", REFERENCE.encode(), "single files"),
    "other prim": ("a.usda", USD.replace("ParticleField3DGaussianSplat", "Points").encode(), "has 0 Gaussians"),
    "short usd": ("a.usda", USD.replace("opacities = [", "opacities = [0.5, ").encode(), "wrong length"),
    "unit": ("a.usda", USD.replace("metersPerUnit = 1", "metersPerUnit = 0").encode(), "metersPerUnit"),
    "suffix": ("a.splat", PLY, "no suffix of a splat format"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_what_is_no_splat_is_one_sentence(case: str, tmp_path: Path) -> None:
    name, data, words = HOSTILE[case]
    (tmp_path / name).write_bytes(data)
    if case == "zip bomb":  # what follows the last Gaussian is never decompressed
        assert len(read_splat(tmp_path / name)) == 2
        return
    with pytest.raises(MeshError, match=words) as caught:
        read_splat(tmp_path / name)
    assert name in caught.value.message and "\n" not in caught.value.message and len(caught.value.message) < 220


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    for suffix in (".ply", ".spz", ".glb", ".usdc"):
        with pytest.raises(MeshError, match=f"lost{suffix} could not be read: No such file"):
            read_splat(tmp_path / f"lost{suffix}")
