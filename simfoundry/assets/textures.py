"""Find missing or unreadable textures in mesh files.

To let checks start quickly, this module does not import numpy.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from simfoundry.assets.errors import MeshError
from simfoundry.spec.files import is_document

if TYPE_CHECKING:
    from simfoundry.spec.files import Loaded
    from simfoundry.spec.models.asset import AssetSpec
    from simfoundry.spec.models.scene import SceneSpec

# Number of bytes at the start of a mesh or material file to search for names; in an OBJ, they precede the vertices.
MAX_HEAD = 16 * 2**20

_MATERIAL_FILE = re.compile(rb"^\s*mtllib[ \t]+(.+?)\s*$", re.MULTILINE)
_COLOR_MAP = re.compile(rb"^\s*map_Kd[ \t]+(?:-\S+(?:[ \t]+[-+.\d]+)*[ \t]+)*(.+?)\s*$", re.MULTILINE)
_DAE_PICTURE = re.compile(rb"<init_from>\s*(?:<ref>)?\s*([^<]+?)\s*<")


def document_faults(loaded: Loaded, spec: SceneSpec | AssetSpec) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the document path and an error message for each unusable texture in a document's visual meshes."""
    known: dict[str, list[str]] = {}  # many objects may have the same mesh
    for place, reference in _meshes(spec):
        if reference not in known:
            known[reference] = texture_faults(loaded.file(reference), loaded.root)
        yield from ((place, fault) for fault in known[reference])


def _meshes(spec: SceneSpec | AssetSpec) -> Iterator[tuple[tuple[str, ...], str]]:
    from simfoundry.spec.models.scene import SceneSpec

    if isinstance(spec, SceneSpec):
        for name, item in spec.objects.items():
            key = "asset" if item.visual is None else "visual"
            reference = item.visual or item.asset
            if reference is not None and not is_document(reference):
                yield ("objects", name, key), reference
        return
    for link_name, link in spec.links.items():
        for name, part in link.parts.items():
            if part.mesh is not None and part.use != "collision":
                yield ("links", link_name, "parts", name), part.mesh


def texture_faults(path: Path, root: Path | None = None) -> list[str]:
    """Return an error message for each unusable texture in a mesh file.

    A texture is unusable if it is missing, unreadable, or outside the ``root`` folder. In that case, simulators would
    show the surface without a texture.
    """
    try:
        return list(dict.fromkeys(_faults(path, root)))
    except OSError:
        return []  # the mesh reader reports this


def _faults(path: Path, root: Path | None) -> Iterator[str]:
    for owner, name in _pictures(path):
        if name.startswith("data:"):
            continue
        plain = unquote(name.removeprefix("file://")).replace("\\", "/")
        file = owner.parent / plain
        message = f"{owner.name} refers to the texture {name}"
        if Path(plain).is_absolute() or (root is not None and not file.resolve().is_relative_to(root.resolve())):
            yield f"{message}, which is outside the project"
        elif not file.is_file():
            yield f"{message}, which does not exist"
        elif not _is_picture(file):
            yield f"{message}, which is not a readable image"


def _pictures(path: Path) -> Iterator[tuple[Path, str]]:
    """Yield the name of each texture or missing material file, together with the file that refers to it."""
    match path.suffix.lower():
        case ".obj":
            for found in _MATERIAL_FILE.findall(_head(path)):
                material = path.parent / _text(found)
                if material.is_file():
                    yield from ((material, _text(name)) for name in _COLOR_MAP.findall(_head(material)))
                else:
                    yield path, _text(found)  # the missing material file would list the textures
        case ".dae":
            names = map(_text, _DAE_PICTURE.findall(_head(path)))
            yield from ((path, name) for name in names if "." in name)  # names without a suffix are surface ids
        case ".gltf" | ".glb":
            images = gltf_tree(path, MAX_HEAD).get("images", [])
            uris = [image["uri"] for image in images if isinstance(image, dict) and isinstance(image.get("uri"), str)]
            yield from ((path, uri) for uri in uris)


def gltf_tree(path: Path, max_bytes: int) -> dict[str, Any]:
    """Return the JSON tree of a glTF or GLB file, or an empty tree if it is invalid or longer than ``max_bytes``."""
    with path.open("rb") as stream:
        head = stream.read(20)
        if head[:4] == b"glTF":
            text = stream.read(min(int.from_bytes(head[12:16], "little"), max_bytes))
        else:
            text = head + stream.read(max_bytes)
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(MAX_HEAD)


def _text(name: bytes) -> str:
    return name.decode("utf-8", errors="replace").strip('"')


def read_texture(path: Path) -> bytes:
    """Return the image of a material as PNG.

    Raises:
        MeshError: If the file is not an image or has too many pixels.
    """
    from PIL import Image

    from simfoundry.assets.mesh import texture_png

    try:
        with Image.open(path) as picture:
            return texture_png(path.name, picture)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split())[:120]
        message = f"{path.name} could not be read as an image: {reason}"
        raise MeshError("SF301", message, "export it again as PNG or JPEG") from None


def _is_picture(path: Path) -> bool:
    from PIL import Image

    try:
        with Image.open(path) as picture:
            picture.load()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False
    return True
