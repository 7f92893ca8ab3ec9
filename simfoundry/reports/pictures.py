"""Images of a scene before and after a change, from the same camera, with the changed objects outlined."""

from __future__ import annotations

import colorsys
import io
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import frozen_array
from simfoundry.render.raycast import raycast
from simfoundry.render.views import overview, shrunk
from simfoundry.runtime.files import MARK
from simfoundry.scene.bodies import GRAY
from simfoundry.scene.model import Camera, Scene, SceneObject

WIDTH, HEIGHT = 640, 480  # Default and maximum image size [px]; two images fit side by side on a page 1320 px wide

RIM = 4  # Outline width of a changed object [px]; narrower outlines vanish when the page scales down an image

GOLDEN = (5**0.5 - 1) / 2  # Step between hues: multiples of the golden ratio stay far apart for any number of hues

Tint = tuple[float, float, float]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Tag:
    """The position of an object in an image.

    Attributes:
        name: The name of the object.
        x: The horizontal center of the object, as a fraction of the image width.
        y: The top of the object, as a fraction of the image height.
    """

    name: str
    x: float
    y: float


@dataclass(frozen=True, eq=False)
class Picture:
    """An image as PNG bytes, with its size [px] and a tag for each visible object that changed."""

    png: bytes
    width: int
    height: int
    tags: tuple[Tag, ...]


def picture(
    scene: Scene, camera: Camera, colors: Mapping[str, tuple[int, int, int]], tints: Mapping[str, Tint] | None = None
) -> Picture:
    """Render ``scene`` from ``camera``, outlining the objects in ``colors`` in their color (sRGB bytes).

    Objects that are not in ``colors`` are shown in their tint (sRGB, 0 to 1).
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
    """Return a pale tint for each name.

    The tints are as distinct as possible and depend only on the names and their order.
    """
    hues = {name: k * GOLDEN % 1.0 for k, name in enumerate(dict.fromkeys(names))}
    return {name: colorsys.hls_to_rgb(hue, 0.68, 0.42) for name, hue in hues.items()}


def _tinted(item: SceneObject, tint: Tint | None) -> SceneObject:
    """Return an object with its default-gray parts tinted. Fixed objects remain gray because they are background."""
    if tint is None or item.fixed:
        return item
    rgba, links = frozen_array((*tint, 1.0)), []
    for link in item.links:
        visuals = tuple(replace(v, rgba=rgba) if tuple(v.rgba) == GRAY else v for v in link.visuals)
        links.append(replace(link, visuals=visuals))
    return replace(item, links=tuple(links))


def common_camera(scenes: Iterable[Scene], chosen: Iterable[Camera | None]) -> Camera:
    """Return the first chosen camera, scaled down if necessary, or a view of all objects if no camera is chosen."""
    camera = next((camera for camera in chosen if camera is not None), None)
    if camera is not None:
        return shrunk(camera, WIDTH, HEIGHT)
    return overview([scene for scene in scenes if scene.objects], WIDTH, HEIGHT)


def _outline(image: Image, seen: NDArray[np.int32], label: int, color: tuple[int, int, int]) -> None:
    """Outline an object in place, without drawing over other objects whose visible area is smaller."""
    from scipy.ndimage import binary_dilation

    mask = seen == label
    disc = np.hypot(*np.mgrid[-RIM : RIM + 1, -RIM : RIM + 1]) <= RIM
    near = binary_dilation(mask, disc)
    area = np.bincount(seen.ravel())
    area[0] = seen.size  # the background counts as larger than any object
    image[near & ~mask & (area[seen] >= area[label])] = np.array(color, dtype=np.uint8)


def _png(image: Image) -> bytes:
    from PIL import Image as Pillow

    out = io.BytesIO()
    Pillow.fromarray(image).save(out, format="PNG", optimize=True)
    return out.getvalue()


FONT = 0.024  # Font size as a fraction of the image width: about 15 px when two images are side by side on a wide page

LONGEST = 24  # Maximum length of a name [characters], about a third of the image width; longer names are truncated

# Character width of the widest common fonts, total padding of a name, height of a label, and minimum gap between two
# labels, all as fractions of the font size.
_LETTER, _PADDING, _LINE, _GAP = 0.64, 1.0, 1.5, 0.2

# Size of the font that is drawn into images, as a fraction of FONT; Pillow's letters are wider than those of browsers.
SHARE_OF_FONT = 0.9

# Horizontal shifts of a label as fractions of its width; less than 0.5, so that the line to its object starts below it.
_ASIDE = (0.0, -0.25, 0.25, -0.45, 0.45)


@dataclass(frozen=True)
class Label:
    """A label in an image, and the line that connects it to its object.

    All values are fractions of the image size.

    Attributes:
        name: The name of the object.
        x: The horizontal center of the label.
        y: The lower edge of the label.
        width: The width of the label.
        height: The height of the label.
        thing_x: The horizontal position of the end of the line at the object.
        thing_y: The vertical position of the end of the line at the object.
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
        """Return the name, truncated if it is long."""
        return self.name if len(self.name) <= LONGEST else f"{self.name[: LONGEST - 1]}…"

    def meets(self, other: Label) -> bool:
        """Return True if two labels overlap."""
        return (
            abs(self.x - other.x) < (self.width + other.width) / 2
            and self.y - self.height < other.y
            and other.y - other.height < self.y
        )


def place_labels(tags: Sequence[Tag], aspect: float) -> list[Label]:
    """Return a label for each tag, above its object if there is space. Labels that do not fit are omitted.

    ``aspect`` is the width of the image divided by its height.
    """
    placed: list[Label] = []
    for tag in sorted(tags, key=lambda t: (-t.y, t.x, t.name)):  # objects in front keep their labels close
        free = (label for label in _candidates(tag, aspect) if not any(map(label.meets, placed)))
        placed += itertools.islice(free, 1)
    return placed


def _candidates(tag: Tag, aspect: float) -> Iterator[Label]:
    """Yield possible labels inside the image, starting with those nearest to the object.

    Labels above the object come before labels below it.
    """
    height = (_LINE + _GAP) * FONT * aspect
    width = (_LETTER * min(len(tag.name), LONGEST) + _PADDING + _GAP) * FONT
    above, below = int(max(tag.y, 0) / height), int(max(1 - tag.y, 0) / height)
    for step in (*range(above), *range(-1, -below, -1)):
        y = tag.y - (step + 0.25) * height
        for aside in _ASIDE:
            x = min(max(tag.x + aside * width, width / 2), 1 - width / 2)
            if height <= y <= 1:
                yield Label(tag.name, x, y, width, height, tag.x, tag.y)


def labelled_png(shown: Picture, labels: Sequence[Label], color: Callable[[str], tuple[int, int, int]]) -> bytes:
    """Return an image as PNG bytes with its labels drawn in, in the color (sRGB bytes) for each name.

    The image has a palette of 256 colors, which makes the file about three times smaller.
    """
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont
    from PIL.PngImagePlugin import PngInfo

    image = Pillow.open(io.BytesIO(shown.png)).convert("RGB")
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(FONT * shown.width * SHARE_OF_FONT)
    for label in labels:
        x, y = label.thing_x * shown.width, label.y * shown.height
        draw.line((x, y, x, label.thing_y * shown.height), fill=color(label.name), width=1)
    for label in labels:
        left, right = ((label.x + side * label.width / 2) * shown.width for side in (-1, 1))
        bottom = label.y * shown.height
        top = bottom - _LINE * FONT * shown.width
        draw.rectangle((left, top, right, bottom), fill=color(label.name))
        draw.text(((left + right) / 2, (top + bottom) / 2), label.text, fill="white", font=font, anchor="mm")
    out, info = io.BytesIO(), PngInfo()
    info.add_text("Software", MARK)
    image.quantize(256, dither=Pillow.Dither.NONE).save(out, format="PNG", optimize=True, pnginfo=info)
    return out.getvalue()
