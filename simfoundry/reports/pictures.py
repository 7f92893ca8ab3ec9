"""Pictures of a scene before and after a change, from one camera, with the changed objects outlined."""

from __future__ import annotations

import colorsys
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, frozen_array, look_at
from simfoundry.render.raycast import raycast
from simfoundry.render.surface import scene_surface
from simfoundry.scene.bodies import GRAY
from simfoundry.scene.model import Camera, Scene, SceneObject

WIDTH, HEIGHT = 640, 480  # Default and maximum size of a picture [px]: two fit side by side on a page of 1320 px

VIEW_DEG = 40.0  # Vertical field of view of the default camera [deg]: a wider one distorts upright objects at the edges

# Position of the default camera relative to the middle of the scene: behind the robot's right shoulder.
FROM = (-0.72, -0.62, 0.62)

# Margin of the default camera around the objects, as a factor on their radius; less would cut off outlines.
MARGIN = 1.08

RIM = 4  # Outline width of a changed object [px]; narrower outlines vanish when the page scales a picture down

GOLDEN = (5**0.5 - 1) / 2  # Step between hues: multiples of the golden ratio stay far apart for any number of hues

Tint = tuple[float, float, float]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Tag:
    """Position of an object in a picture: ``x`` of its middle and ``y`` of its top, as shares of width and height."""

    name: str
    x: float
    y: float


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture as PNG bytes, its size [px], and tags of the changed objects visible in it."""

    png: bytes
    width: int
    height: int
    tags: tuple[Tag, ...]


def picture(
    scene: Scene, camera: Camera, colors: Mapping[str, tuple[int, int, int]], tints: Mapping[str, Tint] | None = None
) -> Picture:
    """Render ``scene`` from ``camera``, with the objects in ``colors`` outlined in their color (sRGB bytes).

    Objects without their own color are shown in their tint (sRGB, 0 to 1).
    """
    painted = tuple(_tinted(item, (tints or {}).get(item.name)) for item in scene.objects)
    seen = raycast(replace(scene, objects=painted), camera, samples=2)
    image, tags = seen.color.copy(), []
    for index, item in enumerate(scene.objects):
        rows, columns = np.nonzero(seen.objects == index + 1)
        if item.name in colors and len(rows):
            _outline(image, seen.objects, index + 1, colors[item.name])
            tags.append(Tag(item.name, float(columns.mean()) / camera.width, float(rows.min()) / camera.height))
    return Picture(_png(image), camera.width, camera.height, tuple(tags))


def tints_of(names: Iterable[str]) -> dict[str, Tint]:
    """Return a pale tint for each name, in order, as different as possible; equal names give equal tints."""
    hues = {name: k * GOLDEN % 1.0 for k, name in enumerate(dict.fromkeys(names))}
    return {name: colorsys.hls_to_rgb(hue, 0.68, 0.42) for name, hue in hues.items()}


def _tinted(item: SceneObject, tint: Tint | None) -> SceneObject:
    """Return an object with its default-gray parts tinted; fixed objects stay gray, as a background."""
    if tint is None or item.fixed:
        return item
    rgba = frozen_array((*tint, 1.0))
    links = [
        replace(
            link,
            visuals=tuple(replace(v, rgba=rgba) if tuple(v.rgba) == GRAY else v for v in link.visuals),
        )
        for link in item.links
    ]
    return replace(item, links=tuple(links))


def common_camera(scenes: Iterable[Scene], chosen: Iterable[Camera | None]) -> Camera:
    """Return the first chosen camera, scaled down if needed; by default a view of everything in the scenes."""
    for camera in chosen:
        if camera is not None:
            return _shrunk(camera)
    return _overview([scene for scene in scenes if scene.objects])


def _shrunk(camera: Camera) -> Camera:
    scale = min(1.0, WIDTH / camera.width, HEIGHT / camera.height)
    width, height = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    x, y = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * x,
        fy=camera.fy * y,
        cx=(camera.cx + 0.5) * x - 0.5,  # pixel centers are integers
        cy=(camera.cy + 0.5) * y - 0.5,
    )


def _overview(scenes: list[Scene]) -> Camera:
    """Three-quarter view of the objects that are not fixed, or of all objects if all are fixed."""
    points = [p for scene in scenes for p in (_corners(scene, free=True),) if len(p)]
    points = points or [p for scene in scenes for p in (_corners(scene, free=False),) if len(p)]
    cloud = np.concatenate([np.zeros((0, 3)), *points]) if points else np.array([[-0.5] * 3, [0.5] * 3])
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    center, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 0.05)
    away = np.array(FROM) / np.linalg.norm(FROM)
    eye = center + away * MARGIN * radius / np.sin(np.radians(VIEW_DEG / 2))
    focal = HEIGHT / 2 / np.tan(np.radians(VIEW_DEG / 2))
    X_WC = look_at(eye, center)
    return Camera("overview", WIDTH, HEIGHT, float(focal), float(focal), (WIDTH - 1) / 2, (HEIGHT - 1) / 2, X_WC)


def _corners(scene: Scene, free: bool) -> Array:
    """Corners of the visible triangles [m, world], shape (n, 3), of all objects or of those that are not fixed."""
    surface = scene_surface(scene)
    wanted = np.array([not (free and item.fixed) for item in scene.objects], dtype=np.bool_)
    return np.asarray(surface.corners[wanted[surface.object]].reshape(-1, 3))


def _outline(image: Image, seen: NDArray[np.int32], label: int, color: tuple[int, int, int]) -> None:
    """Outline the object with a label, in place, but never over an object with a smaller visible area."""
    mask = seen == label
    h, w = mask.shape
    padded = np.pad(mask, RIM)
    near = np.zeros_like(mask)
    for dy in range(-RIM, RIM + 1):
        for dx in range(-RIM, RIM + 1):
            if dx * dx + dy * dy <= RIM * RIM:
                near |= padded[RIM + dy : RIM + dy + h, RIM + dx : RIM + dx + w]
    area = np.bincount(seen.ravel())
    area[0] = seen.size  # the background counts as larger than any object
    image[near & ~mask & (area[seen] >= area[label])] = np.array(color, dtype=np.uint8)


def _png(image: Image) -> bytes:
    from PIL import Image as Pillow

    out = io.BytesIO()
    Pillow.fromarray(image).save(out, format="PNG", optimize=True)
    return out.getvalue()


FONT = 0.024  # Font size as a fraction of the image width: 15 px if two images share a wide page

LONGEST = 24  # Length from which names are truncated with dots: a third of a picture's width

# Character width of the widest common fonts, padding of a name on both sides, height of a label, and least gap between
# two, all as shares of the font size.
_LETTER, _PADDING, _LINE, _GAP = 0.64, 1.0, 1.5, 0.2

# Sideways shifts of a label, as shares of its width; below 0.5, so that the line to its object starts under it.
_ASIDE = (0.0, -0.25, 0.25, -0.45, 0.45)


@dataclass(frozen=True)
class Label:
    """Label with its middle at ``x`` and its lower edge at ``y``, of size ``width`` and ``height``.

    A line goes down to the object ``thing`` at (``thing_x``, ``thing_y``). All values are shares of the picture.
    """

    name: str
    x: float
    y: float
    width: float
    height: float
    thing_x: float
    thing_y: float

    @property
    def text(self) -> str:
        """Name, shortened if it is long."""
        return self.name if len(self.name) <= LONGEST else f"{self.name[: LONGEST - 1]}…"

    def meets(self, other: Label) -> bool:
        """Return whether two labels overlap."""
        return (
            abs(self.x - other.x) < (self.width + other.width) / 2
            and self.y - self.height < other.y
            and other.y - other.height < self.y
        )


def place_labels(tags: Sequence[Tag], aspect: float) -> list[Label]:
    """Return a label for each tag, above its object if there is space; tags without space are left out.

    ``aspect`` is the width of the picture divided by its height.
    """
    placed: list[Label] = []
    for tag in sorted(tags, key=lambda t: (-t.y, t.x, t.name)):  # objects in front keep their labels close
        free = (label for label in _candidates(tag, aspect) if not any(map(label.meets, placed)))
        label = next(free, None)
        if label is not None:
            placed.append(label)
    return placed


def _candidates(tag: Tag, aspect: float) -> Iterator[Label]:
    """Yield positions of a label inside the picture, nearest first: above its object, then below."""
    height = (_LINE + _GAP) * FONT * aspect
    width = (_LETTER * min(len(tag.name), LONGEST) + _PADDING + _GAP) * FONT
    above, below = int(max(tag.y, 0) / height), int(max(1 - tag.y, 0) / height)
    for step in (*range(above), *range(-1, -below, -1)):
        y = tag.y - (step + 0.25) * height
        for aside in _ASIDE:
            x = min(max(tag.x + aside * width, width / 2), 1 - width / 2)
            if height <= y <= 1:
                yield Label(tag.name, x, y, width, height, tag.x, tag.y)
