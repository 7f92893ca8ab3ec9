"""Read OBJ files as this package writes them, with one texture.

A captured scene has such a file for each object, and the general reader imports 600 modules, which takes 0.3 s.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.mass import Array

# Nothing is matched twice, so that large files of others take little time and memory.
_NUMBER = rb"-?+\d[\d.]*+(?:e[-+]?+\d++)?+"
_NAME = rb"[\w.-]+"

# The material that :func:`simfoundry.scene.meshfile.obj_with_material` writes, and the file that refers to it. Each
# corner has the same number in both lists, so that no vertex has to be divided.
_MATERIAL = re.compile(rb"newmtl skin\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd (%s\.png)\n" % _NAME)
_OBJ = re.compile(
    rb"mtllib (%(name)s)\n((?:v %(number)s %(number)s %(number)s\n)++)((?:vt %(number)s %(number)s\n)++)"
    rb"usemtl skin\n((?:f (\d++)/\5 (\d++)/\6 (\d++)/\7\n)++)" % {b"name": _NAME, b"number": _NUMBER}
)


class TexturedObj(NamedTuple):
    """The content of an OBJ file with one texture.

    Attributes:
        vertices: Positions in the file's unit, shape (n, 3).
        faces: Vertex indices of the triangles, shape (m, 3).
        uv: Texture coordinates with v up, shape (n, 2).
        image: The texture, an image of Pillow.
    """

    vertices: Array
    faces: NDArray[np.int64]
    uv: Array
    image: Any


def read_textured_obj(path: Path, most_pixels: int) -> TexturedObj | None:
    """Return the content of an OBJ file, or None if it is damaged, or is not one that this package would write.

    The result is also None if its texture has more than ``most_pixels`` pixels.
    """
    from PIL import Image

    if path.suffix != ".obj":
        return None
    try:
        found = _OBJ.fullmatch(path.read_bytes())
        material = None if found is None else _MATERIAL.fullmatch((path.parent / found[1].decode()).read_bytes())
        if found is None or material is None:
            return None
        vertices, uv = _numbers(found[2], b"v ", 3), _numbers(found[3], b"vt ", 2)
        corners = np.array(found[4].replace(b"f ", b"").replace(b"/", b" ").split(), dtype=np.int64)
        faces = corners.reshape(-1, 3, 2)[..., 0] - 1
        if len(uv) != len(vertices) or not np.array_equal(np.unique(faces), np.arange(len(vertices))):
            return None
        image = Image.open(path.parent / material[1].decode())
        if image.width * image.height > most_pixels:
            return None
        image.load()
    except (OSError, ValueError, OverflowError, SyntaxError, Image.DecompressionBombError):
        return None
    return TexturedObj(vertices, faces, uv, image)


def _numbers(lines: bytes, start: bytes, columns: int) -> Array:
    """Return the numbers in lines that begin with ``start``, shape (lines, columns)."""
    return np.array(lines.replace(start, b"").split(), dtype=np.float64).reshape(-1, columns)
