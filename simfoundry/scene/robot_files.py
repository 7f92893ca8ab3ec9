"""Locate the files of a robot model and the files that they reference."""

from __future__ import annotations

import hashlib
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from simfoundry.scene.robot_packages import NoModelError, described_model, menagerie_model
from simfoundry.spec.files import FileError, located, packaged_model

_TEXTURES = re.compile(r"^\s*(?:map_\w+|bump|disp|norm)\s+(?:-\S+\s+\S+\s+)*(\S.*?)\s*$", re.MULTILINE)
_MATERIALS = re.compile(r"^mtllib\s+(\S.*?)\s*$", re.MULTILINE)
_IMAGES = re.compile(r"<init_from>\s*([^<]+?)\s*</init_from>")


def find_model(reference: str, document: Path, suffix: str, fetch: bool = True) -> Path:
    """Return the file that ``reference`` in ``document`` names.

    A reference is a path, ``pkg:package/path``, ``menagerie:robot/path`` or ``robot_descriptions:name``. ``suffix``
    (``.xml``, ``.urdf``) selects one of a description's files. The last two kinds come from packages that download a
    robot on first use; without ``fetch`` nothing is downloaded. Raises :class:`NoModelError`.
    """
    packaged = packaged_model(reference)
    if packaged is not None:
        package, name, path = packaged
        if package == "menagerie":
            return menagerie_model(name, path, fetch)
        return described_model(name, path, suffix, fetch)
    try:
        target = located(reference, document)
    except FileError as error:
        raise NoModelError(f"{error}; {error.hint}", is_known=False) from None
    if not target.is_file():
        raise NoModelError(f"there is no file `{reference}`")
    return target


def digest(files: list[Path]) -> str:
    """Sixteen hex digits that identify the content of files, in the given order."""
    total = hashlib.sha256()
    for file in files:
        total.update(hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()[:16]


def model_files(file: Path) -> list[Path]:
    """Return a model's file and every file that it needs, each once, in the order of their references.

    Raises :class:`NoModelError` if one is missing or the model cannot be read.
    """
    files = list(dict.fromkeys(_needed(file)))
    for needed in files:
        if not needed.is_file():
            raise NoModelError(f"{file.name} needs {needed.name}, but {needed} does not exist")
    return files


def _needed(file: Path) -> Iterator[Path]:
    yield file
    match file.suffix.lower():
        case ".urdf":
            for name in urdf_meshes(file.read_text(encoding="utf-8")):
                mesh = urdf_mesh(file, name)
                yield mesh
                yield from companions(mesh)
        case ".xml" | ".mjcf":
            yield from _mjcf_files(file)
        case _:  # a USD layer: its folder, which is moved as a whole
            yield from sorted(p for p in file.parent.rglob("*") if p.is_file() and p != file)


def _mjcf_files(file: Path) -> Iterator[Path]:
    """Included files, meshes, height fields and textures."""
    try:
        root = ET.parse(file).getroot()
    except (ET.ParseError, OSError) as error:
        raise NoModelError(f"{file.name} cannot be read: {error}") from None
    folders = {"mesh": "", "texture": "", "hfield": ""}
    for compiler in root.iter("compiler"):
        assets = compiler.get("assetdir", "")
        folders["mesh"] = folders["hfield"] = compiler.get("meshdir", assets) or folders["mesh"]
        folders["texture"] = compiler.get("texturedir", assets) or folders["texture"]
    for element in root.iter():
        name = element.get("file")
        if name is None:
            continue
        if element.tag == "include":
            yield from _needed((file.parent / name).resolve())
        elif element.tag in folders:
            yield (file.parent / folders[element.tag] / name).resolve()


def urdf_meshes(text: str) -> list[str]:
    """File names in a URDF, each once: meshes and textures."""
    return list(dict.fromkeys(re.findall(r"""\bfilename\s*=\s*["']([^"']+)["']""", text)))


def urdf_mesh(urdf: Path, name: str) -> Path:
    """Return the file that ``name`` refers to in a URDF: relative to it, or `package://` below a parent folder."""
    if name.startswith("file://"):
        return Path(name.removeprefix("file://")).resolve()
    if not name.startswith("package://"):
        return (urdf.parent / name).resolve()
    path = name.removeprefix("package://")
    inner = path.partition("/")[2]
    for folder in urdf.parents:
        for candidate in (folder / path, folder / inner):
            if inner and candidate.is_file():
                return candidate.resolve()
    return (urdf.parent / path).resolve()


def companions(mesh: Path) -> Iterator[Path]:
    """Return the materials and textures that a mesh file references."""
    if not mesh.is_file() or mesh.suffix.lower() not in (".obj", ".dae"):
        return
    text = mesh.read_text(encoding="utf-8", errors="replace")
    if mesh.suffix.lower() == ".dae":
        images = [(mesh.parent / name).resolve() for name in _IMAGES.findall(text)]
        yield from (image for image in images if image.is_file())
        return
    for name in _MATERIALS.findall(text):
        library = (mesh.parent / name).resolve()
        if library.is_file():
            yield library
            pictures = _TEXTURES.findall(library.read_text(encoding="utf-8", errors="replace"))
            yield from (p for p in ((library.parent / n).resolve() for n in pictures) if p.is_file())
