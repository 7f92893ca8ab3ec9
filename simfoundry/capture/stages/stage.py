"""The stages of a reconstruction, in order, with the code that each of them consists of."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import simfoundry
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import nearest

_CAPTURE = Path(__file__).parents[1]


# Suffixes of the files that decide what a stage does: modules, and the weights of small networks beside them.
CODE = (".py", ".npz", ".onnx")

# An import of modules of this package: the module, and the imported names.
_IMPORT = re.compile(r"^[ \t]*from simfoundry\.capture(?:\.([\w.]+))? import (\([^)]*\)|[^\n]+)", re.MULTILINE)


@dataclass(frozen=True)
class Stage:
    """A stage of a reconstruction.

    Attributes:
        name: Name of the stage, by which commands refer to it.
        task: The task of the stage, as it is shown to people.
        modules: Files and folders below ``simfoundry/capture`` that the stage consists of. The modules of this folder
            that they import belong to it, too.
        per_object: True if the stage runs once for each object, so that one object can be redone alone.
        is_optional: True if some runs do without the stage, such as one that asks a model.
    """

    name: str
    task: str
    modules: tuple[str, ...]
    per_object: bool = False
    is_optional: bool = False

    @property
    def files(self) -> tuple[Path, ...]:
        """All files with the code of the stage, sorted."""
        return _with_imports(tuple(_CAPTURE / module for module in self.modules))

    @cached_property
    def version(self) -> str:
        """The version of the stage, as 12 hex digits: results of another version of its code are stale."""
        h = hashlib.sha256(simfoundry.__version__.encode())
        for file in self.files:
            h.update(file.relative_to(_CAPTURE.parent).as_posix().encode() + b"\0" + _file_digest(file))
        return h.hexdigest()[:12]


# Each stage may use the results of those above it. The order is that in which they run and are listed.
STAGES = (
    Stage(
        "frames",
        "reads, checks and undistorts the images, and registers, computes or fuses their depth",
        ("frames/load.py", "frames/fusion.py"),
    ),
    Stage(
        "depth",
        "fills holes in the depth by a model that is configured for `complete_depth`",
        ("model_stages/depth.py",),
        is_optional=True,
    ),
    Stage("support", "finds the plane that supports the objects, its outline, and the world frame", ("segment",)),
    Stage(
        "read",
        "asks a model that is configured for `read_scene` what the objects are",
        ("scene_reading.py",),
        is_optional=True,
    ),
    Stage("segment", "finds the pixels of each object, and which object stands on which", ("segment",)),
    Stage(
        "masks",
        "takes the pixels of each object from a model that is configured for `segment`",
        ("model_stages/masks.py",),
        is_optional=True,
    ),
    Stage(
        "register",
        "registers the models of a CAD library, and corrects the pixels of the objects by them",
        ("cad",),
        is_optional=True,
    ),
    Stage(
        "shape",
        "fits a solid to each object: its geometry and its pose",
        ("reconstruct.py", "cad"),
        per_object=True,
    ),
    Stage(
        "remove",
        "removes the objects from the image, those in front first, and fills in what they hid",
        ("removal.py",),
    ),
    Stage(
        "inpaint",
        "fills in what the objects hid by a model that is configured for `inpaint`",
        ("model_stages/inpaint.py",),
        is_optional=True,
    ),
    Stage(
        "mesh",
        "asks a model that is configured for `mesh` for each object, and keeps the shape that fits the image best",
        ("model_stages/meshes.py",),
        per_object=True,
        is_optional=True,
    ),
    Stage(
        "refine",
        "refines the pose of each mesh by a model that is configured for `pose`",
        ("model_stages/meshes.py",),
        per_object=True,
        is_optional=True,
    ),
    Stage(
        "name",
        "names each object as stated, or after its color and shape",
        ("description/naming.py", "description/describe.py", "description/kinds.py"),
    ),
    Stage(
        "pose",
        "places the meshes, and takes the poses, that a person states",
        ("statements/stated.py",),
        per_object=True,
    ),
    Stage(
        "texture",
        "takes the colors of each object and of the support from the image",
        ("shapes/texture.py", "description/support_object.py"),
        per_object=True,
    ),
    Stage(
        "parts",
        "finds the parts that move and their joints by models that are configured for `parts` and `articulate`",
        ("model_stages/joints.py",),
        per_object=True,
        is_optional=True,
    ),
    Stage(
        "background",
        "makes a splat of the surroundings by a model that is configured for `splat`",
        ("model_stages/background.py",),
        is_optional=True,
    ),
    Stage("faults", "looks for faults of the depth image", ("doubts/depth_faults.py",)),
    Stage("doubts", "looks for signs in the image that the scene will be wrong", ("doubts/image_doubts.py",)),
    Stage(
        "settle",
        "brings all objects to rest in a simulation, and states their masses and materials",
        ("settling/standing.py", "description/kinds.py", "../worlds/settle.py", "../worlds/rest.py"),
    ),
    Stage(
        "pictures",
        "draws the scene at rest beside the image",
        ("outputs/pictures.py", "../render"),
    ),
)
STAGE_NAMES = tuple(stage.name for stage in STAGES)


def stage_index(name: str) -> int:
    """Return the position of the stage called ``name``.

    Raises:
        SimfoundryError: There is no such stage.
    """
    if name not in STAGE_NAMES:
        raise SimfoundryError(f"there is no stage `{name}`; {nearest(name, STAGE_NAMES)}")
    return STAGE_NAMES.index(name)


@cache
def _with_imports(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return the files and the code in the folders at ``paths``, with what they import from this package, sorted."""
    found, todo = set[Path](), [path.resolve() for path in paths]
    while todo:
        path = todo.pop()
        if path.is_dir():
            todo += (file for file in path.rglob("*") if file.suffix in CODE)
        elif path not in found:
            found.add(path)
            todo += _imported(path)
    return tuple(sorted(found))


@cache
def _imported(file: Path) -> tuple[Path, ...]:
    """Return the modules of this package that a module imports, also within functions."""
    text = file.read_text(encoding="utf-8") if file.suffix == ".py" else ""
    return tuple(found for match in _IMPORT.finditer(text) for found in _modules(match[1] or "", match[2]))


def _modules(package: str, names: str) -> Iterator[Path]:
    """Yield the files of a module, or those of the modules ``names`` in a package."""
    path = _CAPTURE.joinpath(*package.split("."))
    for each in (path, *(path / name for name in re.findall(r"\w+", names))):
        yield from (file for file in (each.with_suffix(".py"), each / "__init__.py") if file in _modules_here())


@cache
def _modules_here() -> frozenset[Path]:
    """Return all modules of this package."""
    return frozenset(_CAPTURE.rglob("*.py"))


@cache
def _file_digest(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).digest()
