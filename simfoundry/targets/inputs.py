"""Hashes of everything that a build depends on. Identical inputs and software produce byte-identical builds.

Names are relative to the project, so the record is the same on every machine.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import simfoundry
from simfoundry.runtime.files import shipped
from simfoundry.scene.robot import lower_robot
from simfoundry.scene.robot_files import NoModelError, companions
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.robot_file import own_folder
from simfoundry.spec.models.scene import SceneSpec, variant_names, variant_of
from simfoundry.spec.yaml.write import to_data
from simfoundry.targets.find import Target

# The libraries that affect the content of the files.
LIBRARIES = (
    *("coacd", "fast-simplification", "mapbox-earcut", "mujoco", "numpy"),
    *("pillow", "scipy", "shapely", "trimesh", "usd-core"),
)

_PACKAGE = Path(simfoundry.__file__).parent


def record(loaded: Loaded, targets: Iterable[Target]) -> dict[str, Any]:
    """Return the names and SHA-256 hashes of all inputs for building a valid scene.

    ``documents`` are hashed by content, ignoring comments. ``files`` contains meshes with their materials and textures,
    ``robots`` contains robot models or the reasons why they are missing, and ``targets`` contains profiles.
    """
    spec = loaded.spec
    assert isinstance(spec, SceneSpec)
    used = [loaded, *_used(loaded)]
    return {
        "software": software(),
        "scene": _named(loaded.path, loaded.root),
        "documents": {_named(d.path, loaded.root): _hash(to_data(d.spec)) for d in used if d.spec is not None},
        "files": {_named(path, loaded.root): _of_file(path) for d in used for path in _files(d)},
        "robots": {name: _of_robot(name, robot, loaded.path) for name, robot in spec.robots.items()},
        "targets": {target.name: _of_target(target) for target in targets},
    }


@cache
def software() -> dict[str, str]:
    """Return the versions of this package and of the libraries that affect the content of the files.

    In a checkout, where any file may be edited, the package version includes a hash of the files.
    """
    found = {"simfoundry": simfoundry.__version__}
    if (_PACKAGE.parent / "pyproject.toml").is_file():
        folders = (_PACKAGE, shipped("targets"))
        files = [p for f in folders for p in sorted(f.rglob("*")) if p.is_file() and "__pycache__" not in p.parts]
        total = hashlib.sha256(b"".join(hashlib.sha256(p.read_bytes()).digest() for p in files))
        found["simfoundry"] += f"+{total.hexdigest()[:16]}"
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


def _used(loaded: Loaded) -> Iterator[Loaded]:
    for used in loaded.uses.values():
        yield used
        yield from _used(used)


def _files(loaded: Loaded) -> Iterator[Path]:
    """Yield the meshes, splats and images named in a document, along with the files that they reference."""
    for reference in _references(loaded.spec):
        path = loaded.file(reference)
        yield path
        yield from companions(path)


def _references(spec: object) -> Iterator[str]:
    if isinstance(spec, SceneSpec | AssetSpec):
        yield from (material.texture for material in spec.materials.values() if material.texture is not None)
    if isinstance(spec, AssetSpec):
        yield from (part.mesh for link in spec.links.values() for part in link.parts.values() if part.mesh is not None)
    if not isinstance(spec, SceneSpec):
        return
    for item in spec.objects.values():
        for one in (item, *(variant_of(item, name) for name in variant_names(item))):
            yield from (f for f in (one.asset, one.visual) if f is not None and not is_document(f))
    yield from (light.texture for light in spec.lights.values() if light.texture is not None)
    if spec.background is not None:
        yield spec.background.mesh or spec.background.splat or ""


def _named(path: Path, root: Path) -> str:
    """Return a path relative to the project or, for a file in an installed package, relative to site-packages."""
    resolved = path.resolve()
    if resolved.is_relative_to(root):
        return resolved.relative_to(root).as_posix()
    inside = [parent for parent in resolved.parents if parent.name in ("site-packages", "dist-packages")]
    return f"pkg:{resolved.relative_to(inside[0]).as_posix()}" if inside else resolved.name


def _of_file(path: Path) -> str:
    """Return the hash of a file. A missing file is not an error here, because it is reported where the file is used."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return "absent"


def _of_robot(name: str, spec: RobotSpec, document: Path) -> str:
    """Return a hash of a robot's models and user-defined description, or the reason why no model is available."""
    folder = own_folder()
    own = [_of_file(p) for p in sorted(folder.glob("*.yaml"))] if folder is not None else []
    try:
        models = lower_robot(name, spec, document).models
    except NoModelError as error:
        return f"no model: {error}"
    return _hash([own, [[str(native.format), native.file.name, native.digest] for native in models.values()]])


def _of_target(target: Target) -> str:
    loader = None if target.loader is None else _of_file(target.loader)
    return _hash([loader, target.profile.model_dump(mode="json")])


def _hash(data: object) -> str:
    return hashlib.sha256(json.dumps(data, ensure_ascii=False, sort_keys=True, default=list).encode()).hexdigest()
