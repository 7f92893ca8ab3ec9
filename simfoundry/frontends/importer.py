"""Import files by reading them, checking the resulting documents by lowering them, and moving the documents into place.

The documents are moved atomically.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.backends.features import native_words
from simfoundry.errors import OutputError
from simfoundry.frontends.asset_documents import BuiltDocuments
from simfoundry.frontends.document_data import document_text
from simfoundry.frontends.documents import build_asset, build_scene
from simfoundry.frontends.draft import DEFAULTS, ImportNote, ImportOptions, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError, refusing_faults
from simfoundry.frontends.registry import TaskReader, model_reader, task_readers
from simfoundry.runtime.files import replace_folder, write_atomically, write_file
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.project import project_root

if TYPE_CHECKING:
    from simfoundry.scene.model import Scene

SCENE, ASSET, TASK = ".scene.yaml", ".asset.yaml", ".task.yaml"

# Maximum number of attempts to lower a draft; each failed attempt removes invalid parts, such as flat colliders.
ATTEMPTS = 3


@dataclass(frozen=True)
class ImportReport:
    """The result of importing a file.

    If the import succeeded, the report contains the path of the document and its differences from the file. Otherwise,
    ``error`` contains the reason for the failure. ``assumed_masses`` lists the masses [kg] that the file does not
    specify, keyed by `object.link`.
    """

    source: str
    out: str | None
    format: str = ""
    bodies: int = 0
    links: int = 0
    joints: int = 0
    cameras: int = 0
    lights: int = 0
    meshes: int = 0
    notes: tuple[ImportNote, ...] = ()
    names: tuple[tuple[str, str], ...] = ()
    more: tuple[str, ...] = ()
    error: str = ""
    assumed_masses: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping for the ``--json`` output."""
        if self.error:
            return {"source": self.source, "error": self.error}
        data = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("names", "error")}
        return data | {"notes": [note.to_json() for note in self.notes], "renamed": dict(self.names)}


def import_file(path: Path, out: Path, options: ImportOptions = DEFAULTS) -> ImportReport:
    """Import a file to ``out``, which must be named NAME.scene.yaml, NAME.asset.yaml or, for tasks, NAME.task.yaml.

    Meshes are written to the adjacent NAME_files folder. Documents are written only if they can be lowered without
    errors.

    Raises:
        ImportRefusedError: If the file cannot be imported.
        OutputError: If ``out`` does not have a valid name, or if existing files would be overwritten without
            ``options.force``.
    """
    with refusing_faults(path):
        read_task = task_readers().get(path.suffix.lower())
        return _import_model(path, out, options) if read_task is None else _import_task(path, out, options, read_task)


def _import_model(path: Path, out: Path, options: ImportOptions) -> ImportReport:
    kind = next((k for k in (SCENE, ASSET) if out.name.endswith(k)), None)
    if kind is None:
        raise OutputError(f"{out}: the output file must be named NAME{SCENE} or NAME{ASSET}")
    folder = out.parent / f"{out.name.removesuffix(kind)}_files"
    _refuse_existing(options, out, folder)
    draft = model_reader(path)(path, options)
    if kind == ASSET and len(draft.bodies) != 1:
        message = f"an asset must have exactly one body, but the file has {len(draft.bodies)}"
        raise ImportRefusedError(path, message, hint=f"import it to NAME{SCENE}")
    if kind == ASSET and draft.bodies[0].fixed:
        why = "scenes, not assets, fix objects to the world; write `fixed: true` in the scene"
        draft.changed("fixed root link", why)
    if kind == ASSET and draft.native:
        why = "an asset has no native data of its scene, such as tendons and settings; import the file to a scene"
        draft.dropped("native data of the scene", why, native_words(draft.native))
    built, scene = _write(draft, kind, out, folder, path)
    return ImportReport(
        source=str(path),
        out=str(out),
        format=draft.format,
        bodies=len(draft.bodies),
        links=sum(len(body.links) for body in draft.bodies),
        joints=sum(len(body.joints) for body in draft.bodies),
        cameras=len(draft.cameras),
        lights=len(draft.lights),
        meshes=sum(name.lower().endswith((".obj", ".stl", ".glb", ".ply")) for name in built.files),
        notes=tuple(draft.notes),
        names=tuple(built.names.items()),
        assumed_masses=_assumed_masses(draft, built, scene),
    )


def _refuse_existing(options: ImportOptions, *places: Path) -> None:
    for place in places:
        if place.exists() and not options.force:
            raise OutputError(f"{place} already exists; choose another output or replace it with --force")


def _import_task(path: Path, out: Path, options: ImportOptions, read_task: TaskReader) -> ImportReport:
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load, load_kind
    from simfoundry.spec.models.scene import SceneSpec

    if not out.name.endswith(TASK):
        raise OutputError(f"{out}: the output file must be named NAME{TASK}")
    if options.scene is None:
        raise ImportRefusedError(path, "a task requires a scene", hint="specify it with --scene NAME.scene.yaml")
    _refuse_existing(options, out)
    loaded = load_kind(options.scene, "scene/1")
    scene = lower(loaded, Cache.default(), fetch=False)
    assert isinstance(loaded.spec, SceneSpec)
    spec, draft = read_task(path, loaded.spec, scene, out, options)
    text = document_text(spec)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", prefix=".import.", suffix=TASK, dir=out.parent, encoding="utf-8") as trial:
        trial.write(text)
        trial.flush()
        errors = load(Path(trial.name)).errors
    if errors:
        raise ImportRefusedError(path, errors[0].message, hint=errors[0].hint)
    write_atomically(out, text.encode())
    return ImportReport(str(path), str(out), draft.format, notes=tuple(draft.notes))


def _write(draft: ModelDraft, kind: str, out: Path, folder: Path, source: Path) -> tuple[BuiltDocuments, Scene]:
    """Write the documents to a temporary folder, validate them, and move them into place.

    Returns:
        The documents and the lowered scene.
    """
    name, root = out.name.removesuffix(kind), project_root(out)
    marked = root if any((root / mark).exists() for mark in (".git", "simfoundry.yaml")) else None
    build = build_asset if kind == ASSET else build_scene
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{name}.import.", dir=out.parent) as temporary:
        staging = Path(temporary)
        for _ in range(ATTEMPTS):
            made = build(draft, name, staging, marked)
            for document, data in {**{n: t.encode() for n, t in made.documents.items()}, **made.files}.items():
                write_file(staging / document, data)
            scene, found = _lowered(staging, f"{name}{kind}", root)
            if scene is not None or not _without_bad_meshes(draft, made, found, source):
                break
        if scene is None:
            more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
            place = Path(os.path.relpath(found[0].file, staging)).name
            raise ImportRefusedError(source, f"{found[0].message}{more}", hint=f"{place} {found[0].path}")
        built = build(draft, name, out.parent, marked)
        for document, text in built.documents.items():
            (staging / document).write_text(text)
        if (staging / folder.name).exists():
            replace_folder(staging / folder.name, folder)
        write_atomically(out, built.documents[out.name].encode())
    return built, scene


def _lowered(folder: Path, document: str, root: Path) -> tuple[Scene | None, list[Diagnostic]]:
    """Lower a document.

    Returns:
        The scene, or None if lowering fails, and the errors.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load

    scene = folder / document
    if document.endswith(ASSET):
        scene = folder / "check.scene.yaml"
        scene.write_text(f"simfoundry: scene/1\nname: check\nobjects: {{thing: {{asset: {document}}}}}\n")
    try:
        return lower(load(scene, root), Cache.default(), fetch=False), []
    except SpecError as error:
        return None, [d for d in error.diagnostics if d.severity is Severity.ERROR]


def _assumed_masses(draft: ModelDraft, built: BuiltDocuments, scene: Scene) -> dict[str, float]:
    """Return the masses [kg] of moving links for which the file specifies no mass.

    The keys have the form `object.link`, or are just link names if there is only one object.
    """
    out: dict[str, float] = {}
    by_name = {item.name: item for item in scene.objects}
    for body in draft.bodies:
        item = scene.objects[0] if len(by_name) == 1 else by_name[built.names.get(body.name, body.name)]
        masses = {link.name: link.mass for link in item.links}
        for link in body.links.values():
            name = built.names.get(f"{body.name}/{link.name}", link.name) if len(masses) > 1 else item.links[0].name
            if link.assumed and link.density is not None and not (body.fixed and link.name == body.root):
                out[f"{item.name}.{name}" if len(by_name) > 1 else name] = masses[name]
    return out


def _without_bad_meshes(draft: ModelDraft, built: BuiltDocuments, found: list[Diagnostic], source: Path) -> bool:
    """Remove flat colliders and unusable visuals from the draft.

    Returns:
        True if anything was removed.
    """
    from simfoundry.frontends.mass_repair import repair_masses

    mended = False
    for finding in found:
        words = finding.path.split(".")
        key = (Path(finding.file).name.removesuffix(ASSET), *words[1:4:2])
        if len(words) != 4 or key not in built.parts:
            continue
        link, part = built.parts[key]
        what = f"`{part.name}` of link `{link.name}`"
        if finding.code == "SF301" and "flat" in finding.message and part.collides:
            draft.dropped(f"contact of {what}", "the mesh is flat")
        elif finding.code in ("SF301", "SF303") and part.use == "visual":
            why = "the mesh has an implausible size" if finding.code == "SF303" else "the mesh is unusable"
            draft.dropped(what, why, finding.message)
        else:
            continue
        if part.use == "both":
            part.use = "visual"
        else:
            link.parts.remove(part)
        mended = True
        if link.density is not None and not link.colliders:
            link.mass, link.com, link.density, link.assumed = 1.0, np.zeros(3), None, "import"
            draft.assumed(f"mass of `{link.name}`", "none of its colliders has a volume; 1 kg is assumed, as in PhysX")
    if mended:
        repair_masses(draft, str(source))
    return mended
