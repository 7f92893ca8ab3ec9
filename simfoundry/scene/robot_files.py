"""Locate the files of a robot model and all files they reference, including in packages that download robots."""

from __future__ import annotations

import hashlib
import importlib
import os
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from functools import lru_cache
from importlib.util import find_spec
from io import StringIO
from pathlib import Path

from simfoundry.runtime.extras import install_line, is_installed
from simfoundry.spec.files import FileError, located, packaged_model

_TEXTURES = re.compile(r"^\s*(?:map_\w+|bump|disp|norm)\s+(?:-\S+\s+\S+\s+)*(\S.*?)\s*$", re.MULTILINE)
_MATERIALS = re.compile(r"^mtllib\s+(\S.*?)\s*$", re.MULTILINE)
_IMAGES = re.compile(r"<init_from>\s*([^<]+?)\s*</init_from>")


def find_model(reference: str, document: Path, suffix: str, fetch: bool = True) -> Path:
    """Return the file that ``reference`` in ``document`` refers to.

    A reference is a path, ``pkg:package/path``, ``menagerie:robot/path`` or ``robot_descriptions:name``. The last two
    are resolved by packages that download a robot on first use; nothing is downloaded unless ``fetch`` is set.
    ``suffix`` (``.xml`` or ``.urdf``) selects one of a description's files.

    Raises:
        NoModelError: If the file is not available.
    """
    if (packaged := packaged_model(reference)) is not None:
        package, name, path = packaged
        is_menagerie = package == "menagerie"
        return _menagerie_model(name, path, fetch) if is_menagerie else _described_model(name, path, suffix, fetch)
    try:
        target = located(reference, document)
    except FileError as error:
        raise NoModelError(f"{error}; {error.hint}", is_known=False) from None
    if not target.is_file():
        raise NoModelError(f"`{reference}` does not exist")
    return target


def digest(files: list[Path]) -> str:
    """Return sixteen hexadecimal digits that identify the content of the files in the given order."""
    total = hashlib.sha256()
    for file in files:
        total.update(hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()[:16]


def model_files(file: Path) -> list[Path]:
    """Return a model file and all files that it references, without duplicates and in order of reference.

    Raises:
        NoModelError: If a file is missing or the model cannot be read.
    """
    try:
        files = list(dict.fromkeys(_needed(file, set())))
    except UnicodeDecodeError:
        raise NoModelError(f"{file.name} could not be read: it is not UTF-8 text") from None
    for needed in files:
        if not needed.is_file():
            raise NoModelError(f"{file.name} references {needed.name}, but {needed} does not exist")
    return files


def _needed(file: Path, seen: set[Path]) -> Iterator[Path]:
    """Yield a model file and the files that it references, except files that were already ``seen`` in a cycle."""
    if file in seen:
        return
    seen.add(file)
    yield file
    match file.suffix.lower():
        case ".urdf":
            for name in urdf_meshes(file.read_text(encoding="utf-8")):
                yield (mesh := urdf_mesh(file, name))
                yield from companions(mesh)
        case ".xml" | ".mjcf":
            yield from _mjcf_files(file, seen)
        case _:  # a USD layer references its folder, which is copied as a whole
            yield from sorted(p for p in file.parent.rglob("*") if p.is_file() and p != file)


def _mjcf_files(file: Path, seen: set[Path]) -> Iterator[Path]:
    """Yield the files that an MJCF model references: included files, meshes, height fields and textures."""
    try:
        root = ET.parse(file).getroot()
    except (ET.ParseError, OSError) as error:
        raise NoModelError(f"{file.name} could not be read: {error}") from None
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
            yield from _needed((file.parent / name).resolve(), seen)
        elif element.tag in folders:
            yield (file.parent / folders[element.tag] / name).resolve()


def urdf_meshes(text: str) -> list[str]:
    """Return the names of the meshes and textures in a URDF, without duplicates."""
    return list(dict.fromkeys(re.findall(r"""\bfilename\s*=\s*["']([^"']+)["']""", text)))


def urdf_mesh(urdf: Path, name: str) -> Path:
    """Return the file that ``name`` refers to in a URDF.

    The name is a relative path, or a `package://` reference to a file below a parent folder.
    """
    if name.startswith("file://"):
        return Path(name.removeprefix("file://")).resolve()
    if not name.startswith("package://"):
        return (urdf.parent / name).resolve()
    path = name.removeprefix("package://")
    inner = path.partition("/")[2]
    candidates = [folder / end for folder in urdf.parents for end in (path, inner) if inner]
    return next((file for file in candidates if file.is_file()), urdf.parent / path).resolve()


def companions(mesh: Path) -> Iterator[Path]:
    """Yield the material and texture files that a mesh file references."""
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


_SOURCE = re.compile(r"_?clone_to_cache\(\s*[\"']([^\"']+)[\"']")
_ATTRIBUTE = {".urdf": "URDF_PATH", ".xml": "MJCF_PATH"}

_DESCRIPTIONS = "robot_descriptions"


class NoModelError(Exception):
    """Raised for a missing model. The message is a clause that states what is missing and how to fix the problem.

    ``is_known`` is False if the package that may provide the model is not installed. In that case, an error from
    another source is more informative.
    """

    def __init__(self, message: str, is_known: bool = True) -> None:
        super().__init__(message)
        self.is_known = is_known


def _menagerie_model(name: str, path: str | None, fetch: bool) -> Path:
    """Return a file of the robot ``name`` in MuJoCo Menagerie, which is ``path`` or, by default, the robot's model.

    If ``fetch`` is set, the official package downloads robots that are not in its cache (several megabytes). Otherwise,
    such robots are treated as missing.

    Raises:
        NoModelError: If the file is not available.
    """
    if not is_installed("mujoco_menagerie"):
        raise NoModelError(f"install the robot models with `{install_line('robots')}`", is_known=False)
    import mujoco_menagerie

    try:
        robot = mujoco_menagerie.get(name)
        cache = mujoco_menagerie.Cache()
        if cache.root is None and not cache.is_cached(robot) and not fetch:
            command = f"python -m mujoco_menagerie prefetch {name}"
            raise NoModelError(
                f"the model has not been downloaded; run `{command}`, or use the robot once while online"
            )
        folder = _fetch(name, str(cache.dir), str(cache.root or ""))
        if isinstance(folder, Exception):
            raise folder
    except mujoco_menagerie.UnknownRobotError as error:
        raise NoModelError(f"mujoco-menagerie does not provide `{name}`: {_line(error)}; update the package") from None
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise NoModelError(f"mujoco-menagerie could not download `{name}`: {_line(error)}") from None
    return _inside(folder, path or robot.entry(robot.default_model).file, f"menagerie:{name}")


@lru_cache(maxsize=64)
def _fetch(name: str, cache: str, root: str) -> Path | Exception:
    """Return the folder of a robot, or the error if the download failed.

    A failed download is not retried in this process because each attempt takes seconds.
    """
    import mujoco_menagerie

    try:
        return Path(mujoco_menagerie.Cache(cache, root=root).resolve(mujoco_menagerie.get(name)))
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        return error


def _described_model(name: str, path: str | None, suffix: str, fetch: bool) -> Path:
    """Return a file of a description in the robot_descriptions package, which is ``path`` or the file with ``suffix``.

    The package clones the description's repository on first use. If ``fetch`` is not set, a description that has not
    been cloned is treated as missing.

    Raises:
        NoModelError: If the file is not available.
    """
    if not is_installed(_DESCRIPTIONS):
        raise NoModelError(f"install the robot models with `pip install {_DESCRIPTIONS}`", is_known=False)
    module_name = f"{_DESCRIPTIONS}.{name}"
    try:
        if fetch:
            module = importlib.import_module(module_name)
        else:
            _need_cloned(name)
            with _offline():
                module = importlib.import_module(module_name)
    except ModuleNotFoundError:
        raise NoModelError(f"`{_DESCRIPTIONS}` does not provide `{name}`; update the package") from None
    except NoModelError:
        raise
    except Exception as error:  # git raises various errors without a network
        raise NoModelError(f"`{_DESCRIPTIONS}` could not download `{name}`: {_line(error)}") from None
    if path is not None:
        return _inside(Path(module.PACKAGE_PATH), path, f"{_DESCRIPTIONS}:{name}")
    if (found := getattr(module, _ATTRIBUTE.get(suffix, "USD_PATH"), None)) is None:
        raise NoModelError(f"`{_DESCRIPTIONS}:{name}` has no {suffix.lstrip('.')} file")
    return _inside(Path(found).parent, Path(found).name, f"{_DESCRIPTIONS}:{name}")


def _need_cloned(name: str) -> None:
    """Check that the repository of a description has been cloned.

    The package itself cannot determine this without cloning. Therefore, the repository name is read from the module's
    source code, and the folder name is read from a table in the package.

    Raises:
        NoModelError: If the repository has not been cloned.
    """
    if f"{_DESCRIPTIONS}.{name}" in sys.modules:
        return
    spec = find_spec(f"{_DESCRIPTIONS}.{name}")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(name)
    named = _SOURCE.search(Path(spec.origin).read_text(encoding="utf-8"))
    table = importlib.import_module(f"{_DESCRIPTIONS}._repositories").REPOSITORIES
    folder = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")).expanduser()
    if named is None or not (folder / table[named[1]].cache_path / ".git").exists():
        command = f"{_DESCRIPTIONS} pull {name}"
        raise NoModelError(f"the model has not been downloaded; run `{command}`, or use the robot once while online")


@contextmanager
def _offline() -> Iterator[None]:
    """Prevent git from using the network or printing messages while an already cloned description is imported."""
    before = os.environ.get("GIT_ALLOW_PROTOCOL")
    os.environ["GIT_ALLOW_PROTOCOL"] = "none"
    try:
        with redirect_stdout(StringIO()):
            yield
    finally:
        if before is None:
            del os.environ["GIT_ALLOW_PROTOCOL"]
        else:
            os.environ["GIT_ALLOW_PROTOCOL"] = before


def _inside(folder: Path, path: str, name: str) -> Path:
    target = (folder / path).resolve()
    if not target.is_relative_to(folder.resolve()):
        raise NoModelError(f"`{path}` is outside `{name}`")
    if not target.is_file():
        raise NoModelError(f"`{name}` has no file {path}")
    return target


def _line(error: Exception) -> str:
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__
