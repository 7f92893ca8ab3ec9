"""Files to checked documents: the text, the types, the names and the files that they refer to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simfoundry.spec.asset import AssetSpec
from simfoundry.spec.base import Body, Material, Model
from simfoundry.spec.capture import CaptureSpec
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, nearest
from simfoundry.spec.relations import RelationError, parse_relation
from simfoundry.spec.scene import Degrees, ObjectSpec, SceneSpec
from simfoundry.spec.text import Document, YamlError, read
from simfoundry.spec.validate import validate

KINDS: dict[str, type[Model]] = {"scene/1": SceneSpec, "asset/1": AssetSpec, "capture/1": CaptureSpec}
MESH_SUFFIXES = (".glb", ".obj", ".stl", ".ply")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")


@dataclass(frozen=True)
class Loaded:
    """A checked document: its typed ``spec`` (None where errors forbid one), findings, and the assets it uses."""

    path: Path
    root: Path
    spec: Model | None
    findings: tuple[Diagnostic, ...]
    assets: dict[str, Loaded] = field(default_factory=dict)

    @property
    def errors(self) -> list[Diagnostic]:
        """Findings that forbid any further work, assets' included."""
        return [d for d in self.all_findings() if d.severity is Severity.ERROR]

    def all_findings(self) -> list[Diagnostic]:
        """Findings of this document and of the assets it uses."""
        return [*self.findings, *(d for a in self.assets.values() for d in a.all_findings())]

    def finding(self, code: str, path: tuple[str | int, ...], message: str, hint: str = "") -> Diagnostic:
        """An error at a place of this document, whose text is read again to find it."""
        try:
            line, column = read(self.path).place(path)
        except YamlError:
            line, column = 0, 0
        dotted = ".".join(str(p) for p in path)
        return Diagnostic(code, Severity.ERROR, message, str(self.path), line, column, dotted, hint)

    def file(self, reference: str) -> Path:
        """The file that a path in this document means."""
        return (self.path.parent / reference).resolve()


def project_root(path: Path) -> Path:
    """The folder below which a document's files must lie: the nearest with a ``.git`` or ``simfoundry.yaml``."""
    folder = path.resolve().parent
    for candidate in (folder, *folder.parents):
        if (candidate / ".git").exists() or (candidate / "simfoundry.yaml").exists():
            return candidate
    return folder


def load(path: Path, root: Path | None = None) -> Loaded:
    """Read and check one document; the findings say what is wrong, nothing is raised."""
    root = (root or project_root(path)).resolve()
    try:
        document = read(path)
    except YamlError as error:
        return Loaded(path, root, None, (error.diagnostic(str(path)),))
    model, finding = _kind(document)
    if model is None:
        assert finding is not None
        return Loaded(path, root, None, (*document.duplicates, finding))
    spec, findings = validate(model, document)
    loaded = Loaded(path, root, spec, ())
    checker = _Checker(document, loaded)
    match spec:
        case SceneSpec():
            checker.scene(spec)
        case AssetSpec():
            checker.asset(spec)
        case CaptureSpec():
            checker.capture(spec)
    return Loaded(path, root, spec, (*findings, *checker.findings), loaded.assets)


def load_scene(path: Path) -> Loaded:
    """A scene document without errors; raises :class:`SpecError` with every finding otherwise."""
    return _of_kind(path, SceneSpec, "scene/1")


def load_capture(path: Path) -> Loaded:
    """A capture document without errors; raises :class:`SpecError` with every finding otherwise."""
    return _of_kind(path, CaptureSpec, "capture/1")


def _of_kind(path: Path, model: type[Model], kind: str) -> Loaded:
    loaded = load(path)
    if loaded.errors:
        raise SpecError(loaded.errors)
    if not isinstance(loaded.spec, model):
        message = f"expected a `{kind}` document"
        raise SpecError([Diagnostic("SF006", Severity.ERROR, message, str(path), 1, 1, "simfoundry")])
    return loaded


def _kind(document: Document) -> tuple[type[Model] | None, Diagnostic | None]:
    """The model of a document by its first key."""
    data = document.data
    if not isinstance(data, dict):
        message, value = "a document is a mapping that starts with `simfoundry: scene/1`", None
    else:
        value = data.get("simfoundry")
        if isinstance(value, str) and value in KINDS:
            return KINDS[value], None
        message = f"`{value}` is not a kind of document" if "simfoundry" in data else "the key `simfoundry` is missing"
    line, column = document.place(("simfoundry",))
    hint = nearest(str(value), KINDS) if value is not None else "start the document with `simfoundry: scene/1`"
    return None, Diagnostic("SF006", Severity.ERROR, message, document.file, line, column, "simfoundry", hint)


class _Checker:
    """Checks what types cannot: names and files that a document refers to."""

    def __init__(self, document: Document, loaded: Loaded) -> None:
        self.document, self.loaded = document, loaded
        self.findings: list[Diagnostic] = []

    def add(
        self, code: str, path: tuple[Any, ...], message: str, hint: str = "", severity: Severity = Severity.ERROR
    ) -> None:
        line, column = self.document.place(path)
        dotted = ".".join(str(p) for p in path)
        self.findings.append(Diagnostic(code, severity, message, self.document.file, line, column, dotted, hint))

    # -- documents ----------------------------------------------------------------------------------------------

    def scene(self, spec: SceneSpec) -> None:
        for name, item in spec.objects.items():
            path = ("objects", name)
            self.material(item, spec.materials, path)
            if item.visual is not None:
                self.file(item.visual, (*path, "visual"), MESH_SUFFIXES)
            if item.asset is not None:
                self.object_asset(item, path)
            elif item.joints:
                self.add("SF201", (*path, "joints"), f"`{name}` is a primitive and has no joints")
            if item.asset is None or item.asset.endswith(MESH_SUFFIXES):
                self.mass(item, spec.materials, path, item.fixed)
        if spec.viewpoint is not None and spec.viewpoint not in spec.cameras:
            self.add(
                "SF201",
                ("viewpoint",),
                f"no camera is called `{spec.viewpoint}`",
                nearest(spec.viewpoint, spec.cameras),
            )
        for k, text in enumerate(spec.relations):
            self.relation(text, spec, ("relations", k))
        used = [i.material for i in spec.objects.values()]
        self.unused(spec.materials, used)

    def asset(self, spec: AssetSpec) -> None:
        for name, link in spec.links.items():
            path = ("links", name)
            self.material(link, spec.materials, path)
            self.mass(link, spec.materials, path, False)
            for part_name, part in link.parts.items():
                part_path = (*path, "parts", part_name)
                if part.mesh is not None:
                    self.file(part.mesh, (*part_path, "mesh"), MESH_SUFFIXES)
                if part.material is not None:
                    self.name(part.material, spec.materials, (*part_path, "material"), "material")
        parts = [p.material for link in spec.links.values() for p in link.parts.values()]
        self.unused(spec.materials, [link.material for link in spec.links.values()] + parts)
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

    def name(self, name: str, choices: dict[str, Any], path: tuple[Any, ...], what: str) -> None:
        if name not in choices:
            self.add("SF201", path, f"no {what} is called `{name}`", nearest(name, choices))

    def material(self, body: Body, materials: dict[str, Material], path: tuple[Any, ...]) -> None:
        if body.material is not None:
            self.name(body.material, materials, (*path, "material"), "material")

    def mass(self, body: Body, materials: dict[str, Material], path: tuple[Any, ...], fixed: bool) -> None:
        material = materials.get(body.material or "")
        known = body.mass is not None or body.density is not None or (material is not None and material.density)
        if not known and not fixed and (body.material is None or material is not None):
            self.add(
                "SF108", path, f"`{path[-1]}` has no mass", "give `mass`, `density`, or a `material` with a density"
            )

    def unused(self, materials: dict[str, Material], used: list[str | None]) -> None:
        for name in materials:
            if name not in used:
                self.add("SF401", ("materials", name), f"nothing is made of `{name}`", "remove it", Severity.WARNING)

    def file(self, reference: str, path: tuple[Any, ...], suffixes: tuple[str, ...]) -> bool:
        """Whether ``reference`` is a file below the project root with one of the suffixes."""
        if "\0" in reference or "\\" in reference:
            self.add("SF204", path, f"`{reference!r}` is not a portable path", "separate folders with `/`")
            return False
        target = self.loaded.file(reference)
        if Path(reference).is_absolute() or not target.is_relative_to(self.loaded.root):
            hint = f"files must lie below {self.loaded.root}; copy it there and give a relative path"
            self.add("SF204", path, f"`{reference}` leaves the project", hint)
            return False
        if not target.name.lower().endswith(suffixes):
            self.add("SF203", path, f"`{reference}` is not one of {', '.join(suffixes)}")
            return False
        if not target.is_file():
            near = [p.name for p in target.parent.iterdir()] if target.parent.is_dir() else []
            hint = nearest(target.name, near) if near else f"the folder {target.parent.name} does not exist"
            self.add("SF203", path, f"there is no file `{reference}`", hint)
            return False
        return True

    def object_asset(self, item: ObjectSpec, path: tuple[Any, ...]) -> None:
        assert item.asset is not None
        if not self.file(item.asset, (*path, "asset"), (*MESH_SUFFIXES, ".asset.yaml")):
            return
        if not item.asset.endswith(".asset.yaml"):
            if item.joints:
                self.add("SF201", (*path, "joints"), "a mesh has no joints; describe it in an `.asset.yaml`")
            return
        target = self.loaded.file(item.asset)
        loaded = self.loaded.assets.get(str(target)) or load(target, self.loaded.root)
        self.loaded.assets[str(target)] = loaded
        if not isinstance(loaded.spec, AssetSpec):
            if loaded.spec is not None:
                self.add("SF006", (*path, "asset"), f"`{item.asset}` is not an asset document")
            return
        self.joints(item, loaded.spec, path)

    def joints(self, item: ObjectSpec, asset: AssetSpec, path: tuple[Any, ...]) -> None:
        import math

        for name, position in item.joints.items():
            place = (*path, "joints", name)
            if name not in asset.joints:
                self.name(name, asset.joints, place, "joint")
                continue
            joint = asset.joints[name]
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
                self.add("SF205", place, message)

    def relation(self, text: str, spec: SceneSpec, path: tuple[Any, ...]) -> None:
        try:
            _, arguments = parse_relation(text)
        except RelationError as error:
            self.add("SF202", path, str(error), nearest(error.word, error.choices))
            return
        for argument in arguments:
            name, _, joint = argument.partition(".")
            if name not in spec.objects:
                self.add("SF201", path, f"no object is called `{name}`", nearest(name, spec.objects))
            elif joint:
                item = spec.objects[name]
                asset = self.loaded.assets.get(str(self.loaded.file(item.asset or "")))
                joints = asset.spec.joints if asset is not None and isinstance(asset.spec, AssetSpec) else {}
                if asset is None or asset.spec is not None:
                    self.name(joint, joints, path, f"joint of `{name}`")

    def tree(self, spec: AssetSpec) -> None:
        """Every link but the first is the child of exactly one joint, and none is its own ancestor."""
        parents: dict[str, str] = {}
        root = next(iter(spec.links))
        for name, joint in spec.joints.items():
            path = ("joints", name)
            self.name(joint.parent, spec.links, (*path, "parent"), "link")
            self.name(joint.child, spec.links, (*path, "child"), "link")
            if joint.child in parents:
                self.add("SF206", (*path, "child"), f"`{joint.child}` is the child of two joints")
            if joint.child == root:
                self.add(
                    "SF206", (*path, "child"), f"`{root}` is the first link, so it is the root and no joint's child"
                )
            parents[joint.child] = joint.parent
        for link in spec.links:
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
