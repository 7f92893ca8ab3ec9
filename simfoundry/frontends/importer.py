"""One file in, documents and meshes out: read, check by lowering, and put in place in one step."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.errors import OutputError
from simfoundry.frontends.document_data import Built, text_of
from simfoundry.frontends.documents import build_asset, build_scene
from simfoundry.frontends.draft import Draft, Note
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.fault_guard import refusing_faults
from simfoundry.runtime.files import replace_folder, write_atomically, write_file
from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.project import project_root

if TYPE_CHECKING:
    from simfoundry.scene.model import Scene

SCENE, ASSET = ".scene.yaml", ".asset.yaml"
VALID = (
    "valid: .urdf, .xml (MJCF or URDF), .usd, .usda, .usdc, .usdz, .json (a scene of OmniGibson, poses.json); with a "
    "scene, .yaml and .bddl (tasks)"
)

ATTEMPTS = 3
"""How often a draft is mended until it lowers."""

TASK, TASKS, BDDL = ".task.yaml", (".yaml", ".yml"), ".bddl"
USD = (".usd", ".usda", ".usdc", ".usdz")


@dataclass(frozen=True)
class Options:
    """How to import: folders of packages by name, and whether files that exist are replaced."""

    packages: Mapping[str, Path] = field(default_factory=dict)
    force: bool = False
    scene: Path | None = None
    """The scene document that a task is for."""
    bound: Mapping[str, str] = field(default_factory=dict)
    """Objects of that scene by the names that a task of BDDL has for them."""
    density: float | None = None
    """Density [kg/m^3] of links that state no mass; None for that of water, which simulators take."""


@dataclass(frozen=True)
class Report:
    """What came of one file: where it went and what of it is not as it was; or, in ``error``, why it was refused."""

    source: str
    out: str | None
    format: str = ""
    bodies: int = 0
    links: int = 0
    joints: int = 0
    cameras: int = 0
    lights: int = 0
    meshes: int = 0
    notes: tuple[Note, ...] = ()
    names: tuple[tuple[str, str], ...] = ()
    more: tuple[str, ...] = ()
    error: str = ""
    assumed_masses: Mapping[str, float] = field(default_factory=dict)
    """Masses [kg] of links that move and state none, at the density of water, by `object.link`."""

    def to_json(self) -> dict[str, Any]:
        """A plain mapping for ``--json``."""
        if self.error:
            return {"source": self.source, "error": self.error}
        counts = {key: getattr(self, key) for key in ("bodies", "links", "joints", "cameras", "lights", "meshes")}
        return {
            "source": self.source,
            "out": self.out,
            "format": self.format,
            **counts,
            "notes": [note.to_json() for note in self.notes],
            "renamed": dict(self.names),
            "more": list(self.more),
            "assumed_masses": dict(self.assumed_masses),
        }


def read(path: Path, options: Options = Options()) -> Draft:
    """What a file says; raises :class:`ImportRefusedError`."""
    reader = _reader(path)
    return reader(path, options)


def _reader(path: Path) -> Callable[[Path, Options], Draft]:
    suffix = path.suffix.lower()
    if suffix == ".urdf":
        return _read_urdf
    if suffix == ".xml":
        from simfoundry.frontends.xmltree import read_xml

        tag = read_xml(path).tag
        if tag == "robot":
            return _read_urdf
        if tag == "mujoco":
            return _read_mjcf
        raise ImportRefusedError(path, f"its root is `<{tag}>`", hint="URDF has `<robot>`, MJCF `<mujoco>`")
    if suffix == ".json":
        return _read_json
    if suffix in USD:
        return _read_usd
    raise ImportRefusedError(path, "its kind is not known", hint=VALID)


def _read_urdf(path: Path, options: Options) -> Draft:
    from simfoundry.frontends.urdf import read_urdf

    return read_urdf(path, options.packages, options.density)


def _read_usd(path: Path, options: Options) -> Draft:
    from simfoundry.frontends.usd.reader import read_usd

    return read_usd(path, options.density)


def _read_json(path: Path, options: Options) -> Draft:
    from simfoundry.frontends.omnigibson.scene import read_json, read_omnigibson
    from simfoundry.frontends.urdf.folder import is_poses, read_poses

    data = read_json(path)
    if is_poses(data):
        return read_poses(path, data, options.packages)
    return read_omnigibson(path, options.packages, options.density)


def _read_mjcf(path: Path, options: Options) -> Draft:
    from simfoundry.frontends.mjcf import read_mjcf

    if options.density is not None:
        hint = "leave out `--density`, and write `<default><geom density=…/></default>` into the file"
        raise ImportRefusedError(
            path, "every geom of an MJCF file has a density, MuJoCo's own where none is given", 0, hint
        )
    return read_mjcf(path, options.packages)


def import_file(path: Path, out: Path, options: Options = Options()) -> Report:
    """Import a file to NAME.scene.yaml or NAME.asset.yaml, ``out``, with what it needs in NAME_files beside it.

    Raises :class:`ImportRefusedError` for a file that cannot be imported, whatever goes wrong with it, and
    :class:`OutputError` where something would be lost. What is written lowers without an error, or nothing is written.
    """
    with refusing_faults(path):
        return _import(path, out, options)


def _import(path: Path, out: Path, options: Options) -> Report:
    if path.suffix.lower() in (*TASKS, BDDL):
        return _import_task(path, out, options)
    kind = next((k for k in (SCENE, ASSET) if out.name.endswith(k)), None)
    if kind is None:
        raise OutputError(f"{out}: the output is called NAME{SCENE} or NAME{ASSET}")
    name = out.name.removesuffix(kind)
    folder = out.parent / f"{name}_files"
    for place in (out, folder):
        if place.exists() and not options.force:
            raise OutputError(f"{place} exists; write elsewhere, or replace it with --force")
    draft = read(path, options)
    if kind == ASSET and len(draft.bodies) != 1:
        raise ImportRefusedError(path, f"it holds {len(draft.bodies)} bodies", hint=f"import it to NAME{SCENE}")
    if kind == ASSET and draft.bodies[0].fixed:
        draft.changed(
            "its root, which does not move", "objects are fixed where they are used: write `fixed: true` there"
        )
    built, masses = _write(draft, kind, name, out, folder, path)
    return _report(path, out, draft, built, masses)


def _import_task(path: Path, out: Path, options: Options) -> Report:
    """Import a task of the release, of LIBERO or of BEHAVIOR."""
    from simfoundry.spec.load import load

    if not out.name.endswith(TASK):
        raise OutputError(f"{out}: the output is called NAME{TASK}")
    if options.scene is None:
        raise ImportRefusedError(path, "a task is for a scene", hint="name its document: --scene NAME.scene.yaml")
    if out.exists() and not options.force:
        raise OutputError(f"{out} exists; write elsewhere, or replace it with --force")
    spec, draft = _read_task(path, options.scene, out, options.bound)
    out.parent.mkdir(parents=True, exist_ok=True)
    trial = out.parent / f".{out.name.removesuffix(TASK)}.import{TASK}"
    try:
        trial.write_text(text_of(spec))
        errors = load(trial).errors
    finally:
        trial.unlink(missing_ok=True)
    if errors:
        raise ImportRefusedError(path, errors[0].message, hint=errors[0].hint)
    write_atomically(out, text_of(spec).encode())
    return Report(str(path), str(out), draft.format, notes=tuple(draft.notes))


def _read_task(path: Path, scene_file: Path, out: Path, bound: Mapping[str, str]) -> tuple[TaskSpec, Draft]:
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_kind
    from simfoundry.spec.models.scene import SceneSpec

    loaded = load_kind(scene_file, "scene/1")
    lowered = lower(loaded, Cache.default(), fetch=False)
    if path.suffix.lower() == BDDL:
        from simfoundry.frontends.bddl import read_bddl_task

        return read_bddl_task(path, scene_file, lowered, out, bound)
    from simfoundry.frontends.omnigibson.task import read_task

    assert isinstance(loaded.spec, SceneSpec)
    return read_task(path, scene_file, loaded.spec, lowered, out)


def _write(
    draft: Draft, kind: str, name: str, out: Path, folder: Path, source: Path
) -> tuple[Built, Mapping[str, float]]:
    """Write everything beside its place, check it there, and move it; what was built, and the masses assumed in it."""
    root = project_root(out)
    marked = any((root / mark).exists() for mark in (".git", "simfoundry.yaml"))
    build = build_asset if kind == ASSET else build_scene
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{name}.import.", dir=out.parent) as temporary:
        staging = Path(temporary)
        for _ in range(ATTEMPTS):
            made = build(draft, name, staging, root if marked else None)
            _fill(staging, made)
            scene, found = _check(staging, f"{name}{kind}", root)
            if not found or not _without_bad_meshes(draft, made, found, source):
                break
        if found:
            more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
            place = Path(os.path.relpath(found[0].file, staging)).name
            raise ImportRefusedError(source, f"{found[0].message}{more}", hint=f"{place} {found[0].path}")
        built = build(draft, name, out.parent, root if marked else None)
        for document, text in built.documents.items():
            (staging / document).write_text(text)
        if (staging / folder.name).exists():
            replace_folder(staging / folder.name, folder)
        write_atomically(out, built.documents[out.name].encode())
    return built, {} if scene is None else _assumed_masses(draft, built, scene)


def _assumed_masses(draft: Draft, built: Built, scene: Scene) -> dict[str, float]:
    """Masses [kg] of links that state none and move, by `object.link`, or by link where there is one object."""
    out = {}
    by_name = {item.name: item for item in scene.objects}
    for body in draft.bodies:
        item = scene.objects[0] if len(by_name) == 1 else by_name[built.names.get(body.name, body.name)]
        masses = {link.name: link.mass for link in item.links}
        for link in body.links.values():
            name = built.names.get(f"{body.name}/{link.name}", link.name) if len(masses) > 1 else item.links[0].name
            if link.assumed and link.density is not None and not (body.fixed and link.name == body.root):
                out[f"{item.name}.{name}" if len(by_name) > 1 else name] = masses[name]
    return out


def _fill(folder: Path, built: Built) -> None:
    texts = {name: text.encode() for name, text in built.documents.items()}
    for name, data in {**texts, **built.files}.items():
        write_file(folder / name, data)


def _without_bad_meshes(draft: Draft, built: Built, found: list[Diagnostic], source: Path) -> bool:
    """Leave out flat colliders, which nothing can touch, and what cannot be shown; whether there was any."""
    from simfoundry.frontends.mass_repair import make_sound

    mended = False
    for finding in found:
        words = finding.path.split(".")
        key = (Path(finding.file).name.removesuffix(ASSET), *words[1:4:2])
        if len(words) != 4 or key not in built.parts:
            continue
        link, part = built.parts[key]
        what = f"`{part.name}` of link `{link.name}`"
        if finding.code == "SF301" and "flat" in finding.message and part.use != "visual":
            draft.dropped(f"contact of {what}", "its mesh is flat")
            if part.use == "both":
                part.use = "visual"
            else:
                link.parts.remove(part)
        elif finding.code in ("SF301", "SF303") and part.use == "visual":
            why = "no mesh of such a size is shown" if finding.code == "SF303" else "its mesh cannot be shown"
            draft.dropped(what, why, finding.message)
            link.parts.remove(part)
        else:
            continue
        mended = True
        if link.density is not None and all(p.use == "visual" for p in link.parts):
            link.mass, link.com, link.density, link.assumed = 1.0, np.zeros(3), None, "import"
            draft.assumed(f"mass of `{link.name}`", "nothing of it has a volume; 1 kg, as PhysX takes it")
    if mended:
        make_sound(draft, str(source))
    return mended


def _check(folder: Path, document: str, root: Path) -> tuple[Scene | None, list[Diagnostic]]:
    """What was written, lowered, or the errors that were found by trying to."""
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.spec.diagnostics import SpecError
    from simfoundry.spec.load import load

    if document.endswith(ASSET):
        scene = folder / "check.scene.yaml"
        scene.write_text(f"simfoundry: scene/1\nname: check\nobjects: {{thing: {{asset: {document}}}}}\n")
    else:
        scene = folder / document
    loaded = load(scene, root)
    try:
        return lower(loaded, Cache.default(), fetch=False), []
    except SpecError as error:
        return None, [d for d in error.diagnostics if d.severity is Severity.ERROR]


def _report(path: Path, out: Path, draft: Draft, built: Built, masses: Mapping[str, float]) -> Report:
    links = sum(len(body.links) for body in draft.bodies)
    joints = sum(len(body.joints) for body in draft.bodies)
    meshes = sum(name.lower().endswith((".obj", ".stl", ".glb", ".ply")) for name in built.files)
    return Report(
        str(path), str(out), draft.format, len(draft.bodies), links, joints, len(draft.cameras), len(draft.lights),
        meshes, tuple(draft.notes), tuple(built.names.items()), assumed_masses=masses,
    )  # fmt: skip
