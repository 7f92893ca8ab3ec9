"""The masks of objects as files that people edit: `masks.png`, in colors, and `masks.yaml`, with names."""

from __future__ import annotations

import colorsys
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simfoundry.capture.segment.masks import Labels
from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.validate import validate
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.models.base import Model, Name
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import read

M = TypeVar("M", bound=Model)

MASKS, MASK_NAMES = "masks.png", "masks.yaml"

# Largest number that a palette image can contain; with more objects, the image has 16 bits per pixel and no colors.
PALETTE_MAX = 255

# Maximum number of objects in the masks of a person, as in `decomposition`; an image with more is no image of masks.
OBJECTS_MAX = 200

# Fraction of a turn between the hues of successive numbers: the golden ratio keeps any few of them apart.
HUE_STEP = 0.618034

HEADER = """\
# Names of the objects by their numbers in masks.png. Edit either file and run `simfoundry capture` again: your edits
# are kept, and only what depends on them is computed again. Delete a file to undo your edits of it.
"""


class MaskNames(Model):
    """The names of objects by their numbers in a mask image."""

    names: dict[Name, Annotated[int, Field(ge=1, le=65535)]] = Field({}, description="Number of each object, by name.")


def palette() -> NDArray[np.uint8]:
    """Return the color of each number, shape (256, 3). The background is black, and all colors differ."""
    rows = [(0, 0, 0)]
    for k in range(1, PALETTE_MAX + 1):
        r, g, b = colorsys.hsv_to_rgb((k * HUE_STEP) % 1.0, 0.55 + 0.15 * (k % 4), 1.0 - 0.2 * (k // 4 % 3))
        rows.append((round(255 * r), round(255 * g), round(255 * b)))
    return np.array(rows, dtype=np.uint8)


def mask_image(labels: Labels) -> bytes:
    """Return the numbers of objects, shape (h, w), as a PNG image whose pixel values are the numbers."""
    from PIL import Image

    stream = io.BytesIO()
    if int(labels.max()) <= PALETTE_MAX:
        image = Image.fromarray(labels.astype(np.uint8)).convert("L")
        image = image.copy()
        image.putpalette(palette().ravel().tolist())
    else:
        image = Image.fromarray(labels.astype(np.uint16))
    image.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def names_text(names: Mapping[str, int]) -> bytes:
    """Return the names of objects by their numbers as a YAML document."""
    lines = [f"  {name}: {k}\n" for name, k in sorted(names.items(), key=lambda item: item[1])]
    return (HEADER + ("names:\n" + "".join(lines) if lines else "names: {}\n")).encode()


def read_masks(path: Path, size: tuple[int, int]) -> Labels:
    """Read a mask image that a person may have edited.

    Args:
        path: An image with numbers, or with the colors of :func:`palette`, to which some programs convert it.
        size: Expected height and width [px].

    Returns:
        The number of the object at each pixel, shape (h, w), with 0 for the background.

    Raises:
        SimfoundryError: The image cannot be read, has another size, or contains colors that are not in the palette.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            if image.size != (size[1], size[0]):
                found, wanted = (f"{w} x {h} pixels" for w, h in (image.size, (size[1], size[0])))
                raise SimfoundryError(f"{path} has {found}, but the color image has {wanted}; scale it back")
            pixels: NDArray[Any] = np.array(image.convert("RGB") if image.mode == "RGBA" else image)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise SimfoundryError(f"{path} could not be read as an image of masks: {error}") from None
    if pixels.ndim == 2 and pixels.dtype.kind in "bui" and int(pixels.max()) <= 65535:
        return _checked(path, pixels.astype(np.int32))
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise SimfoundryError(f"{path} has pixels of type {pixels.dtype}; save it as an indexed or 16-bit image")
    code = pixels.astype(np.int32) @ np.array([65536, 256, 1], dtype=np.int32)
    known = palette().astype(np.int32) @ np.array([65536, 256, 1], dtype=np.int32)
    order = np.argsort(known)
    at = order[np.searchsorted(known[order], code).clip(0, PALETTE_MAX)]
    foreign = known[at] != code
    if foreign.any():
        row, column = (int(v[0]) for v in np.nonzero(foreign))
        color = "#{:02x}{:02x}{:02x}".format(*pixels[row, column])
        raise SimfoundryError(
            f"{path} has the color {color} at the pixel [{column}, {row}], which stands for no object; paint without "
            "smooth edges, in colors of the palette of the image"
        )
    return _checked(path, np.asarray(at, dtype=np.int32))


def _checked(path: Path, labels: Labels) -> Labels:
    count = len(np.unique(labels[labels > 0]))
    if count > OBJECTS_MAX:
        raise SimfoundryError(f"{path} contains {count} objects; at most {OBJECTS_MAX} can be stated")
    return labels


def read_mask_names(path: Path) -> dict[str, int]:
    """Read the names of objects by their numbers.

    Raises:
        SpecError: The file is invalid. The error contains all findings.
    """
    return dict(read_model(MaskNames, path).names)


def read_model(model: type[M], path: Path) -> M:
    """Read a YAML file as a model.

    Raises:
        SpecError: The file is invalid. The error contains all findings.
    """
    try:
        document = read(path)
        if document.data is None:  # only comments, or nothing
            return model()
        spec, findings = validate(model, document)
    except YamlError as error:
        raise SpecError([Diagnostic("SF002", Severity.ERROR, error.message, str(path), error.line)]) from None
    if spec is None:
        raise SpecError(findings)
    return spec
