"""Textures of materials and panoramas of dome lights, in every format and as engines show them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from simfoundry.assets.errors import MeshError
from simfoundry.assets.panorama import read_panorama
from simfoundry.backends import compile_scene
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Box, Mesh, Sphere
from simfoundry.lint.lints import lint
from simfoundry.scene.box_mapping import Texture, textured
from simfoundry.scene.lower import lower_file
from simfoundry.scene.meshfile import has_texture
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_scene

SCENE = """\
simfoundry: scene/1
name: looks
materials:
  oak: {density: 700, texture: oak.png, texture_size: 0.2}
  wax: {density: 900, texture: oak.png, color: [0.5, 1, 1]}
objects:
  desk: {fixed: true, shape: {box: [1, 0.6, 0.04]}, material: oak}
  candle: {shape: {cylinder: {radius: 0.03, height: 0.1}}, material: wax, pose: {xyz: [0, 0, 0.07]}}
  red: {shape: {sphere: 0.05}, material: oak, color: "#ff0000", pose: {xyz: [0.3, 0, 0.07]}}
lights:
  sky: {type: dome, texture: sky.SUFFIX}
"""


def picture() -> NDArray[np.uint8]:
    pixels = np.full((8, 16, 3), 200, dtype=np.uint8)
    pixels[0, 0] = (255, 0, 0)
    return pixels


def radiance(pixels: Array, encoded: bool) -> bytes:
    """A Radiance HDR file, in which each row is one literal run per channel, or not encoded."""
    height, width, _ = pixels.shape
    top = np.maximum(pixels.max(axis=2), 1e-9)
    exponent = np.ceil(np.log2(top * (256 / 255)))
    mantissa = np.floor(pixels * (256 / 2.0**exponent)[:, :, None])
    rgbe = np.concatenate([mantissa, exponent[:, :, None] + 128], axis=2).astype(np.uint8)
    body = b""
    for row in rgbe:
        if encoded:
            body += bytes((2, 2, width >> 8, width & 255))
            body += b"".join(bytes((width,)) + row[:, k].tobytes() for k in range(4))
        else:
            body += row.tobytes()
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width) + body


def exr(width: int, height: int) -> bytes:
    """The start of an OpenEXR file."""
    window = (0).to_bytes(8, "little") + (width - 1).to_bytes(4, "little") + (height - 1).to_bytes(4, "little")
    return b"\x76\x2f\x31\x01\x02\0\0\0" + b"dataWindow\0box2i\0\x10\0\0\0" + window + b"\0"


def sides() -> Array:
    """A panorama with a color for each of the directions x, y, -x, -y, a white top and a dim bottom."""
    pixels = np.zeros((32, 64, 3))
    turn = (np.pi - (np.arange(64) + 0.5) / 64 * 2 * np.pi) % (2 * np.pi)  # longitude, from x toward y
    for k, color in enumerate(([1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0])):
        pixels[:, np.abs((turn - k * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi) <= np.pi / 4] = color
    pixels[:10], pixels[-10:] = 1.0, 0.05
    return pixels


def lowered(folder: Path, suffix: str = "hdr", text: str = SCENE) -> Scene:
    (folder / "simfoundry.yaml").touch()
    Image.fromarray(picture()).save(folder / "oak.png")
    (folder / "sky.hdr").write_bytes(radiance(sides(), encoded=True))
    (folder / "sky.exr").write_bytes(exr(64, 32))
    Image.fromarray((sides() * 255).astype(np.uint8)).save(folder / "sky.png")
    (folder / "a.scene.yaml").write_text(text.replace("SUFFIX", suffix))
    return lower_file(folder / "a.scene.yaml")


def visual(scene: Scene, name: str) -> tuple[Mesh, Array]:
    (shown,) = scene.object(name).root.visuals
    assert isinstance(shown.geometry, Mesh) and has_texture(shown.geometry)
    return shown.geometry, shown.rgba


def test_materials_bring_their_texture_and_tint(tmp_path: Path) -> None:
    scene = lowered(tmp_path)
    desk, rgba = visual(scene, "desk")
    assert np.array(Image.open(io.BytesIO(desk.texture or b""))).tolist() == picture().tolist()
    assert rgba == pytest.approx([1, 1, 1, 1])
    assert desk.uv is not None and desk.uv.max(axis=0) == pytest.approx([1 / 0.2, 0.6 / 0.2])
    candle, rgba = visual(scene, "candle")
    assert rgba == pytest.approx([0.5, 1, 1, 1])
    assert candle.uv is not None and candle.uv.max() == pytest.approx(1)  # once along the longest side
    assert visual(scene, "red")[1] == pytest.approx([1, 0, 0, 1])
    (collider,) = scene.object("desk").root.colliders
    assert isinstance(collider.geometry, Box)  # the look changes nothing else


def test_an_image_is_not_mirrored_on_any_side() -> None:
    """Seen from outside, u and v turn counterclockwise on each face."""
    for geometry in (Box(frozen_array([0.3, 0.2, 0.1])), Sphere(0.1)):
        mesh = textured(geometry, Texture(b"png", 0.1))
        assert mesh.uv is not None
        a, b, c = (mesh.uv[mesh.faces[:, k]] for k in range(3))
        turning = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        assert (turning > 0).all() and mesh.uv.min() >= -1e-12


@pytest.mark.parametrize("target", ["mjcf", "usd", "urdf", "pybullet"])
def test_every_format_has_the_textures(target: str, tmp_path: Path) -> None:
    artifact = compile_scene(lowered(tmp_path), target)
    pictures = [name for name in artifact.files if name.endswith(".png") and "sky" not in name]
    assert len(pictures) == 1 and "texture" not in {loss.feature for loss in artifact.losses}
    lost = {loss.feature: loss.fidelity for loss in artifact.losses if loss.element == "sky"}
    assert lost.get("dome_textures") == {"mjcf": "approximated", "usd": None}.get(target, "dropped")


def test_a_stage_has_the_panorama_upright(tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdLux

    from simfoundry.frontends.usd.compiled.reading import read_spec

    compile_scene(lowered(tmp_path), "usd").write(tmp_path / "usd")
    stage = Usd.Stage.Open(str(tmp_path / "usd" / "scene.usda"))
    dome = UsdLux.DomeLight.Get(stage, "/World/Lights/sky")
    file = Path(dome.GetTextureFileAttr().Get().resolvedPath)
    assert file.read_bytes() == (tmp_path / "sky.hdr").read_bytes()
    matrix = UsdGeom.Xformable(dome).ComputeLocalToWorldTransform(0)
    # UsdLux: the center of the image is along +z, the top along +y, and longitude pi/2 along +x of the dome.
    seen = [tuple(matrix.TransformDir(axis)) for axis in ((0, 0, 1), (0, 1, 0), (1, 0, 0))]
    assert np.array(seen) == pytest.approx(np.array([(1, 0, 0), (0, 0, 1), (0, 1, 0)]), abs=1e-6)
    reading = read_spec(stage)
    assert reading is not None and reading.data == reading.before and not reading.notes


@pytest.mark.parametrize("suffix", ["hdr", "png"])
def test_mujoco_shows_the_panorama_around_the_scene(suffix: str, tmp_path: Path) -> None:
    import mujoco

    compile_scene(lowered(tmp_path, suffix), "mjcf").write(tmp_path / "mjcf")
    spec = mujoco.MjSpec.from_file(str(tmp_path / "mjcf" / "scene.xml"))
    model = spec.compile()
    sky = model.texture("sky").id
    assert model.tex_type[sky] == mujoco.mjtTexture.mjTEXTURE_SKYBOX
    start, side = int(model.tex_adr[sky]), int(model.tex_width[sky])
    faces = model.tex_data[start : start + 6 * side * side * 3].reshape(6, side, side, 3)
    # MuJoCo stores the faces right (x), left, up (z), down, front (-y), back.
    middles = [tuple((faces[k, side // 2, side // 2] > 127).astype(int)) for k in range(6)]
    assert middles == [(1, 0, 0), (0, 0, 1), (1, 1, 1), (0, 0, 0), (1, 1, 0), (0, 1, 0)]
    # The upper half of a face on the side ends in the white top, and the lower one in the dim bottom.
    assert faces[0, 0, side // 2].min() > 250 and faces[0, -1, side // 2].max() < 128


@pytest.mark.parametrize("encoded", [True, False])
def test_radiance_is_decoded(encoded: bool, tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).uniform(0, 20, (5, 16, 3))
    (tmp_path / "a.hdr").write_bytes(radiance(pixels, encoded))
    decoded = read_panorama(tmp_path / "a.hdr").pixels()
    assert decoded is not None
    assert np.abs(decoded - pixels).max() <= 20 / 128


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.hdr", b"#?RADIANCE\n", "not a Radiance HDR image"),
        ("a.hdr", b"#?RADIANCE\n\n-Y 4 +X 16\n" + b"\x02\x02\x00\x10\xff", "is truncated"),
        ("a.hdr", b"#?RADIANCE\n\n-Y 999999 +X 999999\n", "the limit is 8192 x 8192"),
        ("a.hdr", radiance(sides(), True)[:-7], "is truncated"),
        ("a.exr", b"\x76\x2f\x31\x01", "not a OpenEXR image"),
        ("a.exr", exr(100_000, 100_000), "the limit is 8192 x 8192"),
        ("a.png", b"no picture", "could not be read as an image"),
    ],
)
def test_bad_panoramas_are_told(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=message):
        read_panorama(tmp_path / name)


def test_check_reports_images_that_cannot_be_used(tmp_path: Path) -> None:
    lowered(tmp_path)
    (tmp_path / "oak.png").write_bytes(b"no picture")
    loaded = load_scene(tmp_path / "a.scene.yaml")
    assert ["oak.png could not be read as an image" in d.message and d.line == 4 for d in lint(loaded)][:1] == [True]
    (tmp_path / "oak.png").unlink()
    with pytest.raises(SpecError, match=r"a\.scene\.yaml:4:.*oak\.png"):
        lowered_again = load_scene(tmp_path / "a.scene.yaml")
        raise SpecError(lowered_again.errors)
