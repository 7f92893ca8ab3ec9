"""Captioned montages and overlays of images for reports and documentation."""

from __future__ import annotations

import colorsys
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.runtime.files import MARK, write_atomically

Image = NDArray[np.uint8]  # An sRGB image, uint8, shape (h, w, 3)

PAPER = (255, 255, 255)
INK = (38, 42, 48)


def side_by_side(panels: Sequence[tuple[str, Image]], height: int | None = None, columns: int | None = None) -> Image:
    """Arrange panels ``(caption, image)`` in rows of ``columns`` (by default, in a single row), with captions on top.

    All images are scaled to the same height [px], by default that of the smallest image, preserving aspect ratios.
    """
    if not panels:
        raise ValueError("a montage requires at least one image")
    row_height = min(image.shape[0] for _, image in panels) if height is None else height
    per_row = len(panels) if columns is None else max(1, columns)
    cells = [_captioned(caption, _scaled(image, row_height)) for caption, image in panels]
    gap = max(4, row_height // 60)
    rows = [_joined(cells[k : k + per_row], gap, axis=1) for k in range(0, len(cells), per_row)]
    width = max(row.shape[1] for row in rows)
    rows = [_joined([row, _blank(row.shape[0], width - row.shape[1])], 0, axis=1) for row in rows]
    inside = _joined(rows, gap, axis=0)
    page = _blank(inside.shape[0] + 2 * gap, inside.shape[1] + 2 * gap)
    page[gap:-gap, gap:-gap] = inside
    return page


def overlay(color: Image, objects: NDArray[np.int32], alpha: float = 0.45) -> Image:
    """Tint and outline each object in an image with its own color.

    The color of an object depends only on its label, so it is the same in every image.

    Args:
        color: The image to draw on.
        objects: Object labels, shape (h, w); 0 is the background.
        alpha: Opacity of the tint.
    """
    if objects.shape != color.shape[:2]:
        raise ValueError(f"the labels have shape {objects.shape}, but the image has shape {color.shape[:2]}")
    labels, index = np.unique(objects, return_inverse=True)
    palette = np.array([label_color(int(k)) if k > 0 else (0, 0, 0) for k in labels], dtype=np.float64)
    tint = palette[index.reshape(objects.shape)]
    strength = np.where(objects > 0, alpha, 0.0)[..., None]
    out = color * (1 - strength) + tint * strength
    outline = _outline(objects)
    out[outline] = tint[outline]
    return np.asarray(np.rint(out), dtype=np.uint8)


def label_color(label: int) -> tuple[int, int, int]:
    """Return a bright color for a positive label; consecutive labels are far apart on the color wheel."""
    r, g, b = colorsys.hsv_to_rgb((label * 0.6180339887) % 1.0, 0.72 + 0.2 * (label % 2), 0.95)
    return round(255 * r), round(255 * g), round(255 * b)


def png_bytes(image: Image) -> bytes:
    """Encode an image as PNG; equal images give equal bytes."""
    from PIL import Image as Pillow
    from PIL.PngImagePlugin import PngInfo

    buffer, info = io.BytesIO(), PngInfo()
    info.add_text("Software", MARK)
    Pillow.fromarray(image).save(buffer, format="PNG", compress_level=9, pnginfo=info)
    return buffer.getvalue()


def save_png(path: Path, image: Image) -> None:
    """Save an image as a PNG file, creating the folder if necessary."""
    write_atomically(path, png_bytes(image))


def _outline(objects: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return a mask of the object pixels with a horizontal or vertical neighbor that has a different label."""
    differs = np.zeros(objects.shape, dtype=np.bool_)
    down, across = objects[1:] != objects[:-1], objects[:, 1:] != objects[:, :-1]
    differs[1:] |= down
    differs[:-1] |= down
    differs[:, 1:] |= across
    differs[:, :-1] |= across
    return differs & (objects > 0)


def _captioned(caption: str, image: Image) -> Image:
    """Return the image with a caption above it; the text is scaled down if it is wider than the image."""
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    h, w = image.shape[:2]
    size = max(11.0, h / 20)
    band = round(size * 1.7)
    strip = Pillow.new("RGB", (w, band), PAPER)
    draw = ImageDraw.Draw(strip)
    wide = draw.textlength(caption, font=ImageFont.load_default(size))
    size = max(7.0, size * min(1.0, (w - 4) / max(wide, 1.0)))
    draw.text((2, band / 2), caption, fill=INK, font=ImageFont.load_default(size), anchor="lm")
    return np.concatenate([np.asarray(strip, dtype=np.uint8), image], axis=0)


def _scaled(image: Image, height: int) -> Image:
    from PIL import Image as Pillow

    h, w = image.shape[:2]
    if h == height:
        return image
    size = (max(1, round(w * height / h)), height)
    return np.asarray(Pillow.fromarray(image).resize(size, Pillow.Resampling.LANCZOS), dtype=np.uint8)


def _blank(height: int, width: int) -> Image:
    return np.full((height, width, 3), PAPER, dtype=np.uint8)


def _joined(images: Sequence[Image], gap: int, axis: int) -> Image:
    """Concatenate images along an axis with a gap between them; all other dimensions must be equal."""
    parts: list[Image] = []
    for image in images:
        if parts and gap:
            parts.append(_blank(image.shape[0], gap) if axis == 1 else _blank(gap, image.shape[1]))
        parts.append(image)
    return np.concatenate(parts, axis=axis)
