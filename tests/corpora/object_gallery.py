"""One picture of all variants: a row for each object, the twin first, drawn by the ray caster."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from simfoundry.cousins.objects.generation import picture_of
from simfoundry.cousins.objects.item import ObjectAsset
from simfoundry.cousins.objects.variants import Variants, write

CELL = 112
PAPER = (238, 239, 242)


def draw(path: Path, rows: list[tuple[str, ObjectAsset, Variants]]) -> None:
    """Write the picture as a PNG."""
    from tempfile import TemporaryDirectory

    columns = 1 + max(len(found.accepted) for _, _, found in rows)
    sheet = Image.new("RGB", (columns * CELL, len(rows) * CELL), PAPER)
    for row, (name, twin, found) in enumerate(rows):
        sheet.paste(_cell(twin), (0, row * CELL))
        for k, variant in enumerate(found.accepted):
            with TemporaryDirectory() as folder:
                write(variant, Path(folder))
                files = {file: Path(folder) / file for file in variant.files}
                item = ObjectAsset(name, twin.category, variant.spec, variant.name, files)
                sheet.paste(_cell(item), ((k + 1) * CELL, row * CELL))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)


def _cell(item: ObjectAsset) -> Image.Image:
    with Image.open(io.BytesIO(picture_of(item, CELL))) as picture:
        paper = Image.new("RGBA", picture.size, (*PAPER, 255))
        paper.alpha_composite(picture)
        return Image.fromarray(np.asarray(paper.convert("RGB")))
