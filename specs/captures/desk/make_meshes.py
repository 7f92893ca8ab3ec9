"""Makes the textured meshes of this scene: ``python specs/captures/desk/make_meshes.py``. The same files every time.

They are only looked at: what weighs and touches are the shapes in ``desk.scene.yaml``.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from simfoundry.assets.solids import prism_mesh
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.meshfile import obj_with_material

HERE = Path(__file__).parent
DESK = np.array([[-0.45, -0.3], [0.35, -0.3], [0.45, -0.2], [0.45, 0.3], [-0.45, 0.3]])

Picture = NDArray[np.uint8]


def png(picture: Picture | Image.Image) -> bytes:
    """A picture as PNG."""
    image = Image.fromarray(picture) if isinstance(picture, np.ndarray) else picture
    stream = io.BytesIO()
    image.save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def wood(width: int, height: int) -> Picture:
    """Planks along x with a grain that runs along them, seams between."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    plank = (y * 5 / height).astype(int)
    shade = rng.uniform(-14, 14, 5)[plank]
    wave = sum(
        amplitude * np.sin(x * fx + y * fy + rng.uniform(0, 6.28, 5)[plank])
        for amplitude, fx, fy in ((5, 0.006, 0.35), (4, 0.011, 0.8), (3, 0.023, 1.7), (3, 0.004, 0.13))
    )
    seam = np.where((y * 5 / height) % 1 < 0.012, -45.0, 0.0)
    tone = np.round(shade + wave + seam)
    base = np.array([176.0, 132.0, 88.0])
    return np.clip(base + tone[..., None] * np.array([1.0, 0.9, 0.75]), 0, 255).astype(np.uint8)


def lettered(size: tuple[int, int], ground: str, paint: Callable[[ImageDraw.ImageDraw, int, int], None]) -> Image.Image:
    """A plain ground with something painted on it."""
    image = Image.new("RGB", size, ground)
    paint(ImageDraw.Draw(image), *size)
    return image


def word(draw: ImageDraw.ImageDraw, text: str, center: tuple[float, float], size: float, fill: str) -> None:
    """A word in the font that Pillow brings."""
    draw.text(center, text, fill=fill, font=ImageFont.load_default(size), anchor="mm")


def cereal_front(draw: ImageDraw.ImageDraw, w: int, h: int) -> None:
    """A bowl of rings under a name."""
    draw.ellipse((0.1 * w, 0.5 * h, 0.9 * w, 1.1 * h), fill="#f4e6c8")
    for k in range(9):
        x, y = w * (0.22 + 0.14 * (k % 5)), h * (0.62 + 0.13 * (k // 5) + 0.03 * (k % 2))
        draw.ellipse((x - 0.05 * w, y - 0.05 * w, x + 0.05 * w, y + 0.05 * w), outline="#b8781e", width=max(2, w // 30))
    draw.rectangle((0, 0.1 * h, w, 0.36 * h), fill="#f6d743")
    word(draw, "HOOPS", (w / 2, 0.23 * h), 0.2 * w, "#9c1410")


def box_mesh(size: tuple[float, float, float], faces: dict[str, Image.Image], ground: str) -> Mesh:
    """A box whose sides carry pictures, by the direction that a side faces; the others are plain."""
    side = 256
    atlas = Image.new("RGB", (side * 3, side * 2), ground)
    names = ("-x", "+x", "-y", "+y", "-z", "+z")
    for k, name in enumerate(names):
        if name in faces:
            atlas.paste(faces[name].resize((side, side)), (side * (k % 3), side * (k // 3)))
    x, y, z = (v / 2 for v in size)
    corners = {  # bottom left, bottom right, top right, top left, seen from outside
        "-x": [(-x, y, -z), (-x, -y, -z), (-x, -y, z), (-x, y, z)],
        "+x": [(x, -y, -z), (x, y, -z), (x, y, z), (x, -y, z)],
        "-y": [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z)],
        "+y": [(x, y, -z), (-x, y, -z), (-x, y, z), (x, y, z)],
        "-z": [(-x, y, -z), (x, y, -z), (x, -y, -z), (-x, -y, -z)],
        "+z": [(-x, y, z), (-x, -y, z), (x, -y, z), (x, y, z)],
    }
    vertices, uv, triangles = [], [], []
    for k, name in enumerate(names):
        left, right = (k % 3 + 0.01) / 3, (k % 3 + 0.99) / 3
        bottom, top = 1 - (k // 3 + 0.99) / 2, 1 - (k // 3 + 0.01) / 2
        start = 4 * k
        vertices += corners[name]
        uv += [(left, bottom), (right, bottom), (right, top), (left, top)]
        triangles += [(start, start + 1, start + 2), (start, start + 2, start + 3)]
    index = np.array(triangles, dtype=np.int32)
    return Mesh(frozen_array(vertices), index, frozen_array(uv), png(atlas))


def can_mesh(radius: float, height: float, label: Image.Image, sides: int = 48) -> Mesh:
    """A can with a label around it, its seam on the far side, and a gray lid and base."""
    angle = np.arange(sides + 1) / sides * 2 * np.pi
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    u = np.arange(sides + 1) / sides
    vertices, uv, triangles = [], [], []
    for z, v in ((-height / 2, 0.3), (height / 2, 1.0)):
        vertices += [(*p, z) for p in ring]
        uv += [(s, v) for s in u]
    n = sides + 1
    for k in range(sides):
        triangles += [(k, k + 1, n + k + 1), (k, n + k + 1, n + k)]
    for z, turn in ((-height / 2, -1), (height / 2, 1)):
        start = len(vertices)
        vertices += [(0.0, 0.0, z), *((*p, z) for p in ring)]
        uv += [(0.5, 0.14), *((0.5 + 0.04 * np.cos(a), 0.14 + 0.08 * np.sin(a)) for a in angle)]
        triangles += [(start, start + 1 + k, start + 2 + k)[::turn] for k in range(sides)]
    picture = Image.new("RGB", (1024, 512), "#c9cbcd")
    picture.paste(label.resize((1024, 358)), (0, 0))
    return Mesh(frozen_array(vertices), np.array(triangles, dtype=np.int32), frozen_array(uv), png(picture))


def soup_label(draw: ImageDraw.ImageDraw, w: int, h: int) -> None:
    """Two bands with the name on both sides of the can."""
    draw.rectangle((0, 0, w, 0.45 * h), fill="#b3201c")
    draw.rectangle((0, 0.43 * h, w, 0.49 * h), fill="#d9b44a")
    for k in range(4):
        word(draw, "TOMATO", (w * (k + 0.5) / 4, 0.23 * h), 0.16 * h, "#ffffff")
        word(draw, "soup", (w * (k + 0.5) / 4, 0.72 * h), 0.2 * h, "#b3201c")


def book_cover(draw: ImageDraw.ImageDraw, w: int, h: int) -> None:
    """A frame and a title."""
    draw.rectangle((0.06 * w, 0.06 * h, 0.94 * w, 0.94 * h), outline="#e8dfc6", width=max(2, w // 60))
    word(draw, "SCENES", (w / 2, 0.3 * h), 0.16 * w, "#e8dfc6")


def meshes() -> dict[str, Mesh]:
    """Every textured mesh of the scene by name."""
    vertices, faces = prism_mesh(DESK, 0.03)
    uv = (vertices[:, :2] - DESK.min(axis=0)) / np.ptp(DESK, axis=0)
    front = lettered((256, 344), "#c8241c", cereal_front)
    cover = lettered((256, 256), "#22457f", book_cover)
    label = lettered((1024, 358), "#f3efe4", soup_label)
    return {
        "desk": Mesh(frozen_array(vertices), faces, frozen_array(uv), png(wood(900, 600))),
        "cereal": box_mesh((0.065, 0.16, 0.215), {"-x": front, "+x": front}, "#c8241c"),
        "book": box_mesh((0.15, 0.21, 0.032), {"+z": cover}, "#22457f"),
        "soup": can_mesh(0.034, 0.102, label),
    }


if __name__ == "__main__":
    for name, mesh in meshes().items():
        for path, data in obj_with_material(mesh, name).items():
            (HERE / "meshes").mkdir(exist_ok=True)
            (HERE / "meshes" / path).write_bytes(data)
