"""The meshes in a folder, prepared for registration and cached by their content."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.errors import LEAST_VOLUME, MeshError, no_volume, not_closed
from simfoundry.assets.mesh import merged, open_edges, read_mesh, weld
from simfoundry.assets.mesh_summary import file_digest
from simfoundry.capture.findings import NOT_FOLLOWED, CaptureFinding
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.errors import SimfoundryError
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.spec.diagnostics import SpecError

MESHES, ASSET = (".obj", ".glb", ".gltf", ".stl", ".ply"), ".asset.yaml"

# Maximum number of models in a library: a first look at each takes 30 ms for each object.
MAX_MODELS = 1000

# Stems that say nothing about a model, which is then named after its folder, as in the YCB and the GSO data sets.
PLAIN_STEMS = frozenset({"textured", "model", "mesh", "object", "visual", "nontextured", "textured_simple", "scene"})

# Words in the names of files that contain convex parts for simulators rather than models.
PARTS = ("coacd", "vhacd", "collision", "convex", "hull")

# Largest diagonal of a model [m]: nothing on a table that is in view is larger, so that another unit is likely.
MAX_DIAMETER = 3.0

# Start of a cached entry that states why a model cannot be used, so that it is not read again.
REASON = b"!"

# Version of the cached files; change it if :class:`MeshTemplate` or how it is made changes.
CACHED = "cad-template-2"


@dataclass(frozen=True)
class CadModel:
    """A mesh of a library.

    Attributes:
        name: Its name, a word of the language.
        path: Its file: a mesh, or an asset document.
        digest: Digest of the content of the file.
    """

    name: str
    path: Path
    digest: str


@dataclass(frozen=True, eq=False)
class CadLibrary:
    """A folder of models with which objects are compared.

    Attributes:
        folder: The folder.
        models: The models in it.
        scale: Length of one unit of the mesh files [m].
        cache: Keeps prepared meshes, or None to prepare them again.
    """

    folder: Path
    models: tuple[CadModel, ...]
    scale: float = 1.0
    cache: Cache | None = None
    templates: dict[str, MeshTemplate | str] = field(default_factory=dict, repr=False)

    @cached_property
    def digest(self) -> str:
        """A digest of all models, on which the results of a capture depend."""
        return key_of(f"{self.scale!r}", *(f"{m.name}={m.digest}" for m in self.models))

    def named(self, name: str) -> CadModel:
        """Return the model called ``name``, which must be in the library."""
        return next(model for model in self.models if model.name == name)

    def mesh(self, model: CadModel) -> Mesh:
        """Read a model, in meters.

        Raises:
            SimfoundryError: If it cannot be read.
        """
        try:
            return asset_mesh(model.path) if model.path.name.endswith(ASSET) else file_mesh(model.path, self.scale)
        except (OSError, MeshError, SpecError) as error:
            raise SimfoundryError(f"the CAD model {model.path} cannot be read: {error}") from error

    def template(self, model: CadModel) -> MeshTemplate | None:
        """Return a model that is prepared for a registration, or None if its file cannot be used.

        Its mesh is the simplified one, so that nothing else needs to be read again.
        """
        found = self._prepared(model)
        return None if isinstance(found, str) else found

    def findings(self) -> tuple[CaptureFinding, ...]:
        """Return a finding for each file that cannot be used."""
        text, hint = (
            "the CAD model {} was not used: {}",
            "repair the mesh, state `scale`, or remove it from the library",
        )
        reasons = ((m.path.relative_to(self.folder), self._prepared(m)) for m in self.models)
        return tuple(
            CaptureFinding(NOT_FOLLOWED, text.format(file, reason), hint)
            for file, reason in reasons
            if isinstance(reason, str)
        )

    def _prepared(self, model: CadModel) -> MeshTemplate | str:
        """Return a model that is prepared, or the reason why it cannot be used."""
        if model.digest not in self.templates:
            key = key_of(CACHED, model.digest, f"{self.scale!r}")
            data = None if self.cache is None else self.cache.get(key)
            if data is None:
                data = self._made(model)
                if self.cache is not None:
                    self.cache.put(key, data)
            is_reason = data.startswith(REASON)
            self.templates[model.digest] = data.removeprefix(REASON).decode() if is_reason else unpacked(data)
        return self.templates[model.digest]

    def _made(self, model: CadModel) -> bytes:
        """Return a prepared model, or why it cannot be used, as it is cached."""
        try:
            template = MeshTemplate.of(_solid(self.mesh(model), model.path.name))
        except SimfoundryError as error:
            return REASON + str(error.__cause__ or error).splitlines()[0].encode()
        except MeshError as error:
            return REASON + error.message.encode()
        if template.diameter > MAX_DIAMETER:
            return REASON + f"{model.path.name} is {template.diameter:.3g} m across, more than a table".encode()
        return packed(template)


def open_library(folder: Path, scale: float = 1.0, cache: Cache | None = None) -> CadLibrary:
    """List the models in a folder and the folders below it.

    Raises:
        SimfoundryError: The folder does not exist, or contains no models or too many.
    """
    folder = folder.resolve()
    if not folder.is_dir():
        raise SimfoundryError(f"the CAD library {folder} is not a folder; state a folder that contains meshes")
    files = list(_files(folder))
    if not files:
        kinds = ", ".join((*MESHES, ASSET))
        raise SimfoundryError(f"the CAD library {folder} contains no model; it may contain {kinds}")
    if len(files) > MAX_MODELS:
        raise SimfoundryError(
            f"the CAD library {folder} contains more than {MAX_MODELS} models; state a smaller folder"
        )
    names: dict[str, int] = {}
    models = []
    for path in files:
        name = model_name(path, folder)
        names[name] = names.get(name, 0) + 1
        models.append(CadModel(name if names[name] == 1 else f"{name}_{names[name]}", path, _content(path)))
    return CadLibrary(folder, tuple(models), scale, cache)


def _content(path: Path) -> str:
    """Return a digest of a model: of its file, and for an asset of all meshes in its folder, which it may use."""
    if not path.name.endswith(ASSET):
        return file_digest(path)
    used = sorted(p for p in path.parent.rglob("*") if p.suffix.lower() in MESHES and p.is_file())
    return key_of(*(file_digest(p) for p in (path, *used)))


def model_name(path: Path, folder: Path) -> str:
    """Return the name of a model: that of its file, or of the folder of the file if the file's says nothing.

    Numbers in front, as in the YCB data set, are left out.
    """
    stem = path.name.removesuffix(ASSET).split(".")[0]
    if stem.lower() in PLAIN_STEMS:
        inside = [part for part in path.relative_to(folder).parts[:-1] if part.lower() not in PLAIN_STEMS]
        words = [part for part in inside if part.lower() not in ("meshes", "google_16k", "poisson", "tsdf")]
        stem = (words or inside or [folder.resolve().name])[-1]
    return plain_name(stem.lstrip("0123456789_- ") or stem)


def file_mesh(path: Path, scale: float) -> Mesh:
    """Read a mesh file; its texture is kept if it has a single part."""
    parts = read_mesh(path, scale)
    if len(parts) == 1:
        (part,) = parts
        return Mesh(frozen_array(part.vertices), part.faces, part.uv, part.texture)
    vertices, faces = merged(parts)
    return Mesh(frozen_array(vertices), np.ascontiguousarray(faces, np.int32))


def asset_mesh(path: Path) -> Mesh:
    """Return the visible surface of an asset, with its joints at zero."""
    from simfoundry.capture.outputs.overlay import object_surface
    from simfoundry.scene.lower import PASSES, Lowering
    from simfoundry.spec.load import load

    text = f"simfoundry: scene/1\nname: one\nobjects:\n  it: {{asset: {json.dumps(path.name)}}}\n"
    loaded = load(path.with_name("one.scene.yaml"), text=text)  # a scene beside it, which is never written
    if loaded.errors:
        raise SpecError(loaded.errors)
    (item,) = Lowering(loaded, draft=True).run(PASSES).objects
    vertices, faces = object_surface(item)
    return Mesh(frozen_array(vertices), faces)


def _solid(mesh: Mesh, name: str) -> Mesh:
    """Return a mesh if a simulator can use it.

    Raises:
        MeshError: Its surface is not closed, or contains no volume.
    """
    vertices, faces = weld(mesh.vertices, mesh.faces)
    gaps = open_edges(faces)
    if gaps:
        raise not_closed(name, gaps)
    if mass.mesh(vertices, faces).volume < LEAST_VOLUME:
        raise no_volume(name)
    return mesh


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files of models in the order of their paths. A folder with an asset document has no other models."""
    paths = sorted(p for p in folder.rglob("*") if p.is_file() and "/." not in f"/{p.relative_to(folder).as_posix()}")
    assets = {p.parent for p in paths if p.name.endswith(ASSET)}
    taken: set[tuple[Path, str]] = set()
    for path in paths:
        if path.name.endswith(ASSET):
            yield path
        elif path.suffix.lower() in MESHES and not (assets & {path.parent, *path.parents}):
            stem = path.stem.lower()
            # The same mesh in several formats is one model.
            if not any(word in stem for word in PARTS) and (path.parent, stem) not in taken:
                taken.add((path.parent, stem))
                yield path


def packed(template: MeshTemplate) -> bytes:
    """Return a template with its simplified mesh only, as a NumPy archive."""
    stream = io.BytesIO()
    colors = np.zeros((0, 3)) if template.colors is None else template.colors
    np.savez(
        stream, vertices=template.vertices, faces=template.faces, points=template.points, normals=template.normals,
        sides=template.sides, center=template.center, diameter=np.array(template.diameter),
        silhouettes=np.array(template.silhouettes), area=np.array(template.area), colors=colors,
    )  # fmt: skip
    return stream.getvalue()


def unpacked(data: bytes) -> MeshTemplate:
    """Return the template that an archive contains."""
    with np.load(io.BytesIO(data), allow_pickle=False) as a:
        low, high = (float(v) for v in a["silhouettes"])
        mesh = Mesh(frozen_array(a["vertices"]), a["faces"])
        colors = frozen_array(a["colors"]) if len(a["colors"]) else None
        return MeshTemplate(mesh, mesh.vertices, mesh.faces, a["points"], a["normals"], a["sides"], a["center"],
                            float(a["diameter"]), (low, high), float(a["area"]), colors)  # fmt: skip
