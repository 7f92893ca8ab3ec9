"""What types cannot say about a document: the names and the files that it refers to, and what is plausible."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from simfoundry.spec.asset import AssetSpec
from simfoundry.spec.base import Body, Material, Model, Shape, quantity_value
from simfoundry.spec.capture import CaptureSpec
from simfoundry.spec.diagnostics import Diagnostic, Severity, nearest
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.plausible import implausible, volume
from simfoundry.spec.relations import RelationError, parse_relation
from simfoundry.spec.scene import Degrees, ObjectSpec, SceneSpec
from simfoundry.spec.text import Document
from simfoundry.spec.validate import MAX_FINDINGS

MESH_SUFFIXES = (".glb", ".obj", ".stl", ".ply")
DOCUMENT_SUFFIX = ".asset.yaml"
OF_LINKS = ("scale", "visual", *Body.model_fields)
"""Fields of an object that an asset document decides for its links."""
MAX_PATH = 512
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")


LoadAsset = Callable[[Path, Path], Loaded | None]
"""Reads and checks an asset document in a project; None for a document of another kind."""


def is_document(reference: str) -> bool:
    """Whether an object's ``asset`` is an asset document, not a mesh."""
    return reference.lower().endswith(DOCUMENT_SUFFIX)


def check(
    document: Document, loaded: Loaded, sound: Model | None, whole: bool, load_asset: LoadAsset
) -> list[Diagnostic]:
    """Findings of a document beyond its types; ``sound`` is its typed spec, or what of it is sound where not ``whole``.

    The assets that it uses are read with ``load_asset`` and added to ``loaded``.
    """
    checker = _Checker(document, loaded, whole, load_asset)
    match sound:
        case SceneSpec():
            checker.scene(sound)
        case AssetSpec():
            checker.asset(sound)
        case CaptureSpec():
            checker.capture(sound)
    return checker.findings


class _Checker:
    """Checks what types cannot: names and files that a document refers to.

    Where the document is not ``whole``, the spec lacks its faulty members; their names still count as defined.
    """

    def __init__(self, document: Document, loaded: Loaded, whole: bool, load_asset: LoadAsset) -> None:
        self.document, self.loaded, self.whole, self.load_asset = document, loaded, whole, load_asset
        self.findings: list[Diagnostic] = []

    def names(self, section: str) -> dict[str, Any]:
        """The names that a section of the text defines, sound or not."""
        members = self.document.data.get(section)
        return members if isinstance(members, dict) else {}

    def add(
        self, code: str, path: tuple[Any, ...], message: str, hint: str = "", severity: Severity = Severity.ERROR
    ) -> None:
        if len(self.findings) >= MAX_FINDINGS:
            return
        line, column = self.document.place(path)
        dotted = ".".join(str(p) for p in path)
        self.findings.append(Diagnostic(code, severity, message, self.document.file, line, column, dotted, hint))

    # -- documents ----------------------------------------------------------------------------------------------

    def scene(self, spec: SceneSpec) -> None:
        for name, item in spec.objects.items():
            path = ("objects", name)
            self.material(item, path)
            if item.visual is not None:
                self.file(item.visual, (*path, "visual"), MESH_SUFFIXES)
            if item.asset is not None:
                self.object_asset(item, path)
            elif item.joints:
                self.add("SF201", (*path, "joints"), f"`{name}` is a primitive and has no joints")
            if item.asset is None or not is_document(item.asset):
                if not item.fixed:
                    self.mass(item, [item.material], spec.materials, path)
                self.density(item, path, [item.shape])
        self.densities(spec.materials)
        if spec.viewpoint is not None:
            self.name(spec.viewpoint, self.names("cameras"), ("viewpoint",), "camera")
        for text, place in self.relations(spec):
            self.relation(text, spec, place)
        self.unused(spec.materials, [i.material for i in spec.objects.values()])

    def asset(self, spec: AssetSpec) -> None:
        for name, link in spec.links.items():
            path = ("links", name)
            self.material(link, path)
            self.mass(link, [part.material or link.material for part in link.parts.values()], spec.materials, path)
            self.density(link, path, [part.shape for part in link.parts.values()])
            for part_name, part in link.parts.items():
                part_path = (*path, "parts", part_name)
                if part.mesh is not None:
                    self.file(part.mesh, (*part_path, "mesh"), MESH_SUFFIXES)
                if part.material is not None:
                    self.name(part.material, self.names("materials"), (*part_path, "material"), "material")
        parts = [p.material for link in spec.links.values() for p in link.parts.values()]
        self.unused(spec.materials, [link.material for link in spec.links.values()] + parts)
        self.densities(spec.materials)
        self.tree(spec)

    def capture(self, spec: CaptureSpec) -> None:
        for name, shot in spec.frames.items():
            path = ("frames", name)
            self.file(shot.color, (*path, "color"), PICTURE_SUFFIXES)
            self.file(shot.depth.image, (*path, "depth", "image"), PICTURE_SUFFIXES)
            if shot.masks is not None:
                self.file(shot.masks.image, (*path, "masks", "image"), PICTURE_SUFFIXES)
        if spec.truth is not None:
            self.file(spec.truth, ("truth",), (".yaml",))

    # -- parts --------------------------------------------------------------------------------------------------

    def name(self, name: str, choices: Collection[str], path: tuple[Any, ...], what: str) -> None:
        if name not in choices and len(self.findings) < MAX_FINDINGS:
            self.add("SF201", path, f"no {what} is called `{name}`", nearest(name, choices) or "none is defined")

    def material(self, body: Body, path: tuple[Any, ...]) -> None:
        if body.material is not None:
            self.name(body.material, self.names("materials"), (*path, "material"), "material")

    def mass(
        self, body: Body, made_of: list[str | None], materials: dict[str, Material], path: tuple[Any, ...]
    ) -> None:
        """A body has a mass or a density, or else every piece of it is made of something with a density."""
        if body.mass is not None or body.density is not None:
            return
        if any(name is None or (name in materials and materials[name].density is None) for name in made_of):
            hint = "give `mass`, `density`, or a `material` with a density"
            self.add("SF108", path, f"`{path[-1]}` has no mass", hint)

    def densities(self, materials: dict[str, Material]) -> None:
        for name, material in materials.items():
            if material.density is not None:
                self.plausible(name, material.density, ("materials", name, "density"))

    def density(self, body: Body, path: tuple[Any, ...], shapes: list[Shape | None]) -> None:
        """The density that a body is given, or that its mass has over the volume of its primitives."""
        given, mass = quantity_value(body.density), quantity_value(body.mass)
        solid = sum(volume(shape) for shape in shapes if shape is not None)
        if given is not None:
            self.plausible(path[-1], given, (*path, "density"))
        elif mass is not None and solid > 0 and None not in shapes:
            self.plausible(path[-1], mass / solid, (*path, "mass"))

    def plausible(self, name: str, density: float, path: tuple[Any, ...]) -> None:
        hint = implausible(density)
        if hint:
            message = f"`{name}` has a density of {density:.4g} kg/m^3"
            self.add("SF402", path, message, hint, Severity.WARNING)

    def unused(self, materials: dict[str, Material], used: list[str | None]) -> None:
        for name in materials:
            if self.whole and name not in used:
                self.add("SF401", ("materials", name), f"nothing is made of `{name}`", "remove it", Severity.WARNING)

    def file(self, reference: str, path: tuple[Any, ...], suffixes: tuple[str, ...]) -> bool:
        """Whether ``reference`` is a file below the project root with one of the suffixes."""
        if "\0" in reference or "\\" in reference or len(reference) > MAX_PATH:
            hint = f"separate folders with `/`, and use at most {MAX_PATH} characters"
            self.add("SF204", path, f"`{reference[:MAX_PATH]}` is not a portable path", hint)
            return False
        try:
            return self.reachable(reference, self.loaded.file(reference), path, suffixes)
        except (OSError, RuntimeError) as error:  # a ring of links, a folder that may not be read, a name too long
            reason = getattr(error, "strerror", None) or "its links form a ring"
            self.add("SF203", path, f"`{reference}` cannot be reached: {reason}")
            return False

    def reachable(self, reference: str, target: Path, path: tuple[Any, ...], suffixes: tuple[str, ...]) -> bool:
        """Whether the file that ``reference`` means is there, below the project root and of the right kind."""
        if Path(reference).is_absolute() or not target.is_relative_to(self.loaded.root):
            hint = f"files must lie below the project, {self.loaded.root}; copy it there and give a relative path"
            self.add("SF204", path, f"`{reference}` leaves the project", hint)
            return False
        if not reference.lower().endswith(suffixes):
            self.add("SF203", path, f"`{reference}` is not a file of the right kind", f"valid: {', '.join(suffixes)}")
            return False
        if not target.is_file():
            folder = target.parent
            near = [p.name for p in folder.iterdir() if p.name.lower().endswith(suffixes)] if folder.is_dir() else []
            hint = nearest(target.name, near) or f"there is none in the folder `{folder.name}`"
            if not folder.is_dir():
                hint = f"there is no folder `{folder.name}`"
            self.add("SF203", path, f"there is no file `{reference}`", hint)
            return False
        return True

    def object_asset(self, item: ObjectSpec, path: tuple[Any, ...]) -> None:
        assert item.asset is not None
        if not self.file(item.asset, (*path, "asset"), (*MESH_SUFFIXES, DOCUMENT_SUFFIX)):
            return
        if not is_document(item.asset):
            if item.joints:
                self.add("SF201", (*path, "joints"), "a mesh has no joints; describe it in an `.asset.yaml`")
            return
        for field_name in OF_LINKS:
            if getattr(item, field_name) != ObjectSpec.model_fields[field_name].default:
                message = f"`{field_name}` has no effect here: the links of `{item.asset}` have their own"
                self.add("SF107", (*path, field_name), message, "write it in that document")
        target = self.loaded.file(item.asset)
        if str(target) not in self.loaded.assets:
            asset = self.load_asset(self.loaded.shown(item.asset), self.loaded.root)
            if asset is None:  # a scene, which might even be this one
                message = f"`{item.asset}` is not an asset document"
                self.add("SF006", (*path, "asset"), message, "it must start with `simfoundry: asset/1`")
                return
            self.loaded.assets[str(target)] = asset
        spec = self.loaded.assets[str(target)].spec
        if isinstance(spec, AssetSpec):
            self.joints(item, spec, path)

    def joints(self, item: ObjectSpec, asset: AssetSpec, path: tuple[Any, ...]) -> None:
        import math

        for name in item.joints:
            self.name(name, asset.joints, (*path, "joints", name), "joint")
        for name, joint in asset.joints.items():
            place, position = (*path, "joints", name), item.joints.get(name, 0.0)
            if joint.type == "fixed" and name in item.joints:
                self.add("SF205", place, f"`{name}` is fixed and has no position", "remove it")
                continue
            if isinstance(position, Degrees) and joint.type == "prismatic":
                self.add("SF103", place, f"`{name}` is prismatic: its position is in metres, not degrees")
                continue
            limits = joint.limits
            value, unit = position.deg if isinstance(position, Degrees) else position, "m"
            if joint.limits_deg is not None:
                limits, unit = joint.limits_deg, "deg"
                value = position.deg if isinstance(position, Degrees) else math.degrees(position)
            if limits is not None and not limits[0] - 1e-9 <= value <= limits[1] + 1e-9:
                message = f"`{name}` at {value:g} {unit} is outside its limits, {limits[0]:g} to {limits[1]:g} {unit}"
                self.add("SF205", place, message, "" if name in item.joints else "give its position in `joints`")

    def relations(self, spec: SceneSpec) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """The relations with their places in the text, which may hold faulty ones between them."""
        texts = self.document.data.get("relations") if spec.relations else ()
        for k, text in enumerate(texts if isinstance(texts, tuple) else ()):
            if isinstance(text, str):
                yield text, ("relations", k)

    def relation(self, text: str, spec: SceneSpec, path: tuple[Any, ...]) -> None:
        try:
            _, arguments = parse_relation(text)
        except RelationError as error:
            hint = nearest(error.word, error.choices) or "write it as `OnTop(cup, desk)` or `Closed(cabinet.drawer)`"
            self.add("SF202", path, str(error), hint)
            return
        for argument in arguments:
            name, _, joint = argument.partition(".")
            self.name(name, self.names("objects"), path, "object")
            if joint and name in spec.objects:
                item = spec.objects[name]
                asset = self.loaded.assets.get(str(self.loaded.file(item.asset or "")))
                joints = asset.spec.joints if asset is not None and isinstance(asset.spec, AssetSpec) else {}
                if not joints and (asset is None or asset.spec is not None):
                    self.add("SF201", path, f"`{name}` has no joints, so none is called `{joint}`")
                elif joints:
                    self.name(joint, joints, path, f"joint of `{name}`")

    def tree(self, spec: AssetSpec) -> None:
        """Every link but the first is the child of exactly one joint, and none is its own ancestor."""
        parents: dict[str, str] = {}
        root = next(iter(self.names("links")))
        for name, joint in spec.joints.items():
            path = ("joints", name)
            self.name(joint.parent, self.names("links"), (*path, "parent"), "link")
            self.name(joint.child, self.names("links"), (*path, "child"), "link")
            if joint.child in parents:
                self.add("SF206", (*path, "child"), f"`{joint.child}` is the child of two joints")
            if joint.child == root:
                self.add(
                    "SF206", (*path, "child"), f"`{root}` is the first link, so it is the root and no joint's child"
                )
            parents[joint.child] = joint.parent
        for link in spec.links if self.whole else ():
            if link != root and link not in parents:
                self.add("SF206", ("links", link), f"no joint carries `{link}`", "add a joint with it as `child`")
            elif link in set(_ancestors(link, parents)):
                self.add("SF206", ("links", link), f"`{link}` is carried by itself, through a ring of joints")


def _ancestors(link: str, parents: dict[str, str]) -> Iterator[str]:
    seen: set[str] = set()
    while link in parents and link not in seen:
        seen.add(link)
        link = parents[link]
        yield link
