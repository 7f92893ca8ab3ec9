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

PAPER = 255  # White, the value of all three channels
INK = (38, 42, 48)


def side_by_side(panels: Sequence[tuple[str, Image]], height: int | None = None, columns: int | None = None) -> Image:
    """Arrange images with captions in rows.

    Args:
        panels: The caption and the image of each panel.
        height: The height that all images are scaled to [px], preserving aspect ratios; by default, the height of the
            smallest image.
        columns: The number of panels in a row; by default, all panels are in one row.
    """
    if not panels:
        raise ValueError("a montage requires at least one image")
    row_height = min(image.shape[0] for _, image in panels) if height is None else height
    per_row = len(panels) if columns is None else max(1, columns)
    gap = max(4, row_height // 60)
    cells = [_padded(_captioned(caption, _scaled(image, row_height)), gap, gap) for caption, image in panels]
    rows = [np.concatenate(cells[k : k + per_row], axis=1) for k in range(0, len(cells), per_row)]
    width = max(row.shape[1] for row in rows)
    page = np.concatenate([_padded(row, 0, width - row.shape[1]) for row in rows])
    return np.pad(page, ((gap, 0), (gap, 0), (0, 0)), constant_values=PAPER)


def overlay(color: Image, objects: NDArray[np.int32], alpha: float = 0.45) -> Image:
    """Tint and outline each object in an image with its own color.

    The color of an object depends only on its label, so it is the same in every image.

    Args:
        color: The image to draw on.
        objects: Object labels as an array of shape (h, w), where 0 is the background.
        alpha: Opacity of the tint.
    """
    if objects.shape != color.shape[:2]:
        raise ValueError(f"the labels have shape {objects.shape}, but the image has shape {color.shape[:2]}")
    palette = np.zeros((int(objects.max(initial=0)) + 1, 3))
    for k in np.unique(objects[objects > 0]):
        palette[k] = label_color(int(k))
    tint = palette[objects]
    strength = np.where(objects > 0, alpha, 0.0)[..., None]
    out = color * (1 - strength) + tint * strength
    outline = _outline(objects)
    out[outline] = tint[outline]
    return np.asarray(np.rint(out), dtype=np.uint8)


def label_color(label: int) -> tuple[int, int, int]:
    """Return a bright color for a positive label. Consecutive labels are far apart on the color wheel."""
    r, g, b = colorsys.hsv_to_rgb((label * 0.6180339887) % 1.0, 0.72 + 0.2 * (label % 2), 0.95)
    return round(255 * r), round(255 * g), round(255 * b)


def png_bytes(image: Image, level: int = 9) -> bytes:
    """Encode an image as PNG. Identical images produce identical bytes."""
    from PIL import Image as Pillow
    from PIL.PngImagePlugin import PngInfo

    buffer, info = io.BytesIO(), PngInfo()
    info.add_text("Software", MARK)
    Pillow.fromarray(image).save(buffer, format="PNG", compress_level=level, pnginfo=info)
    return buffer.getvalue()


def save_png(path: Path, image: Image, level: int = 9) -> None:
    """Save an image as a PNG file, creating the folder if necessary."""
    write_atomically(path, png_bytes(image, level))


def _outline(objects: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return a mask of the object pixels that have a horizontal or vertical neighbor with a different label."""
    near = np.pad(objects, 1, mode="edge")
    around = np.stack([near[:-2, 1:-1], near[2:, 1:-1], near[1:-1, :-2], near[1:-1, 2:]])
    return np.asarray((around != objects).any(axis=0) & (objects > 0), dtype=np.bool_)


def _captioned(caption: str, image: Image) -> Image:
    """Return the image with a caption above it. The caption is scaled down if it is wider than the image."""
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    h, w = image.shape[:2]
    size = max(11.0, h / 20)
    band = round(size * 1.7)
    strip = Pillow.new("RGB", (w, band), (PAPER, PAPER, PAPER))
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


def _padded(image: Image, bottom: int, right: int) -> Image:
    """Return the image with white margins at the bottom and on the right, whose widths are in pixels."""
    return np.pad(image, ((0, bottom), (0, right), (0, 0)), constant_values=PAPER)
