"""Convert objects in a scene to asset documents, and lower asset documents to objects."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

from simfoundry.assets.cache import Cache
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.lower import lower
from simfoundry.scene.model import SceneObject
from simfoundry.scene.robot_files import companions
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.load import load
from simfoundry.spec.models.asset import AssetSpec, LinkSpec, PartSpec
from simfoundry.spec.models.base import BodySpec, Material
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec, variant_names, variant_of
from simfoundry.spec.models.shapes import CompoundShape
from simfoundry.spec.yaml.write import to_yaml

# Name of the single link in the asset of a shape or mesh.
LINK = "body"


@dataclass(frozen=True, eq=False)
class ObjectAsset:
    """An object represented as an asset document.

    Attributes:
        name: Name of the object in its scene, or of the asset.
        category: Category of the object.
        spec: Flattened asset document.
        source: Human-readable origin.
        files: Absolute paths of all files that the document refers to, keyed by the names used in the document.
    """

    name: str
    category: str
    spec: AssetSpec
    source: str
    files: Mapping[str, Path] = field(default_factory=lambda: MappingProxyType({}))


def item_of(scene: Loaded, name: str) -> ObjectAsset:
    """Return the object called ``name`` in a validated scene document.

    Raises:
        KeyError: The object does not exist.
    """
    assert isinstance(scene.spec, SceneSpec)
    if name not in scene.spec.objects:
        raise KeyError(f"no object {name!r}; available objects: {', '.join(scene.spec.objects) or 'none'}")
    written = scene.spec.objects[name]
    if variant_names(written):
        written = variant_of(written, written.variant or "default")
    if written.asset is not None and is_document(written.asset):
        used = scene.used(written.asset)
        assert used is not None and isinstance(used.spec, AssetSpec)
        item = item_of_asset(used)
        return replace(item, name=name, category=written.category or item.category)
    return _item_of_body(scene, name, written)


def item_of_asset(asset: Loaded) -> ObjectAsset:
    """Return the object defined by a validated asset document."""
    spec = asset.spec
    assert isinstance(spec, AssetSpec)
    meshes = [p.mesh for link in spec.links.values() for p in link.parts.values() if p.mesh is not None]
    files = {mesh: asset.file(mesh) for mesh in meshes}
    materials = _with_textures(spec.materials, asset, files)
    flat = spec.model_copy(update={"extends": None, "allow": {}, "conflicts": {}, "materials": materials})
    return ObjectAsset(spec.name, spec.category or spec.name, flat, spec.name, MappingProxyType(files))


def item_of_mesh(path: Path, name: str, category: str, material: Material, scale: float = 1.0) -> ObjectAsset:
    """Return an object that consists of a single mesh file.

    Args:
        path: Path of the mesh file.
        name: Name of the object.
        category: Category of the object.
        material: Material of the object.
        scale: Scale factor from the mesh's unit to meters.
    """
    links = {LINK: LinkSpec(material="stuff", parts={"mesh": PartSpec(mesh=path.name, scale=scale)})}
    spec = AssetSpec(simfoundry="asset/1", name=name, category=category, materials={"stuff": material}, links=links)
    return ObjectAsset(name, category, spec, path.name, MappingProxyType({path.name: path}))


def _item_of_body(scene: Loaded, name: str, written: ObjectSpec) -> ObjectAsset:
    """Convert a primitive or mesh in a scene to an asset with one link."""
    assert isinstance(scene.spec, SceneSpec)
    body = {key: getattr(written, key) for key in BodySpec.model_fields if key in written.model_fields_set}
    mesh = Path(written.asset or "")
    parts = {LINK: PartSpec(mesh=mesh.name, scale=written.scale)}
    if isinstance(written.shape, CompoundShape):
        pieces = written.shape.compound.items()
        parts = {n: PartSpec(shape=p.shape, pose=p.pose, material=p.material, color=p.color) for n, p in pieces}
    elif written.shape is not None:
        parts = {LINK: PartSpec(shape=written.shape)}
    files = {} if written.shape is not None else {mesh.name: scene.file(written.asset or "")}
    named = dict.fromkeys((written.material, *(part.material for part in parts.values())))
    used = {key: scene.spec.materials[key] for key in named if key is not None}
    used = _with_textures(used, scene, files)
    links = {LINK: LinkSpec(**body, parts=parts)}
    category = written.category or name
    spec = AssetSpec(simfoundry="asset/1", name=name, category=category, materials=used, links=links)
    return ObjectAsset(name, category, spec, f"{scene.spec.name}.{name}", MappingProxyType(files))


def _with_textures(materials: Mapping[str, Material], source: Loaded, files: dict[str, Path]) -> dict[str, Material]:
    """Return materials whose textures have names that depend on their content, and add the textures to ``files``."""
    out = dict(materials)
    for key, material in materials.items():
        if material.texture is not None:
            path = source.file(material.texture)
            name = f"{path.stem}_{hashlib.sha256(path.read_bytes()).hexdigest()[:8]}{path.suffix}"
            files[name] = path
            out[key] = material.model_copy(update={"texture": name})
    return out


def lowered(spec: AssetSpec, folder: Path, name: str, cache: Cache | None = None) -> SceneObject:
    """Lower an asset at the origin.

    The asset is first converted to its canonical text, so the result matches the document that is written.

    Args:
        spec: The asset.
        folder: Folder that contains the files of the asset.
        name: Name of the lowered object.
        cache: Cache for lowering.

    Raises:
        SpecError: The asset is invalid.
    """
    file = f"{spec.name}.asset.yaml"
    asset = load(folder / file, text=to_yaml(spec), root=folder)
    if asset.errors:
        raise SpecError(asset.errors)
    written = SceneSpec(simfoundry="scene/1", name="alone", objects={name: ObjectSpec(asset=file)})
    path = folder / "alone.scene.yaml"
    scene = Loaded(path, folder.resolve(), written, (), uses={})
    scene.uses[str(scene.file(file))] = asset
    return lower(scene, cache).object(name)


def alone(item: ObjectAsset, cache: Cache | None = None) -> SceneObject:
    """Lower an object at the origin, using a temporary folder for its files."""
    with TemporaryDirectory(prefix="simfoundry-alone-") as folder:
        lay(item.files, Path(folder))
        return lowered(item.spec, Path(folder), item.name, cache)


def lay(files: Mapping[str, Path], folder: Path) -> None:
    """Copy mesh files, along with their materials and textures, to a folder under the given names."""
    for name, path in files.items():
        target = folder / name
        if target.exists():
            continue
        write_atomically(target, path.read_bytes())
        for other in companions(path):
            write_atomically(target.with_name(other.name), other.read_bytes())
