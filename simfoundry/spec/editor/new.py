"""Create documents from templates, which introduce the keys of each kind of document."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.format import format_text, schema_line
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.editor.strict import EDITOR
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.shapes import SphereShape
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.project import NoProjectError, common_project, markers
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import number

# Names of the kinds on the command line, such as ``scene``.
WORDS = tuple(kind.partition("/")[0] for kind in KINDS)

# Half the width [m] of an object's initial region, which is centered on the position of the object in the scene.
REGION = 0.05


class NewError(SimfoundryError):
    """Raised if a file cannot be created. The message states the reason."""


@dataclass(frozen=True)
class New:
    """A new file, along with the schemas and marker file that must also be written if the project lacks them."""

    path: Path
    text: str
    schemas: dict[Path, str]
    marker: dict[Path, str]


def kind_and_path(words: tuple[str, ...]) -> tuple[str, Path]:
    """Return the kind and the path for the arguments ``desk.scene.yaml`` or ``scene desk``, which are equivalent."""
    *before, last = words
    path = Path(last)
    by_name = next((kind for kind in WORDS if path.name.endswith(f".{kind}.yaml")), None)
    by_name = "capture" if path.name == "capture.yaml" else by_name
    if len(before) > 1 or (before and before[0] not in WORDS):
        raise NewError(f"give a kind and a path, such as `scene desk.scene.yaml`; the kinds are {', '.join(WORDS)}")
    if not before:
        if last in WORDS:
            example = "desk/capture.yaml" if last == "capture" else f"desk.{last}.yaml"
            raise NewError(f"give the {last} a name; for example, `new {last} desk` creates {example}")
        if by_name is None:
            raise NewError(f"the kind of `{last}` is unclear; end it with .scene.yaml, or write `new scene {last}`")
        return by_name, path
    if by_name is None and path.suffix not in (".yaml", ".yml"):
        return before[0], path / "capture.yaml" if before[0] == "capture" else Path(f"{path}.{before[0]}.yaml")
    if by_name != before[0]:
        raise NewError(f"`{path.name}` is not the name of a {before[0]}; end it with .{before[0]}.yaml")
    return by_name, path


def make(kind: str, path: Path, name: str | None, source: Path | None, extends: Path | None) -> New:
    """Return a new file.

    Raises:
        NewError: If the file cannot be created.
        SpecError: If a document that the file refers to is invalid.
    """
    try:
        project = common_project(path, *(named for named in (source, extends) if named is not None))
    except NoProjectError as error:
        raise NewError(str(error)) from None
    text = _text(kind, path, name, source, extends, project.root)
    line, schemas = schema_line(path, parse(text), project.root), dict[Path, str]()
    if line is None:
        from simfoundry.spec.editor.schema import schemas as texts

        folder = project.root / ".simfoundry" / "schemas"
        schemas = {folder / file: content for file, content in texts().items()}
        line = f"{_relative(folder / f'{kind}.schema.json', path)}#/$defs/{EDITOR}"
    return New(path, format_text(text, str(path), line), schemas, markers(project))


def starter(kind: str, path: Path) -> str:
    """Return the text with which an editor fills the empty file ``path``, without a line that names a schema.

    ``kind`` is one of :data:`WORDS`. If the folder contains no scene for a task or recipe, the text is the example.
    """
    from simfoundry.spec.editor.reference import example

    try:
        return _text(kind, path, None, None, None, common_project(path).root)
    except (NewError, NoProjectError, SpecError):
        return example(f"{kind}/1")


def _text(kind: str, path: Path, name: str | None, source: Path | None, extends: Path | None, root: Path) -> str:
    """Return the formatted text of a new file."""
    values = {"name": _name(path, name), "source": _comment(path.name), "kind": kind}
    if extends is not None:
        template, more = "overlay", _overlay(kind, path, extends, root)
    elif kind in ("task", "cousins"):
        template, more = kind, (_task if kind == "task" else _cousins)(path, source, root)
    elif source is not None:
        raise NewError(f"`--from` is for tasks and recipes; use `--extends` to base a {kind} on another {kind}")
    else:
        template, more = kind, {}
    text = (files("simfoundry.spec.editor") / "templates" / f"{template}.txt").read_text(encoding="utf-8")
    return format_text(Template(text).substitute(values | more), str(path))


def _name(path: Path, name: str | None) -> str:
    """Return the document name, which is derived from the file name (for a capture, the folder name) by default."""
    if name is not None:
        if not re.fullmatch(r"[a-z][a-z0-9_]{0,63}", name):
            rule = "a name must start with a letter and contain only lower-case letters, digits and `_`"
            raise NewError(f"`{name}` is not a valid name: {rule}")
        return name
    stem = path.resolve().parent.name if path.name == "capture.yaml" else path.name.partition(".")[0]
    plain = re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_")[:64]
    if not plain or not plain[0].isalpha():
        raise NewError(f"no name can be derived from `{stem}`; give one with --name")
    return plain


def _relative(target: Path, path: Path) -> str:
    return Path(os.path.relpath(target.resolve(), path.resolve().parent)).as_posix()


def _named(source: Path, path: Path) -> dict[str, str]:
    """Return the relative path of another document, both as a YAML value and as the text of a comment."""
    relative = _relative(source, path)
    return {"quoted": json.dumps(relative), "source": _comment(relative)}


def _comment(text: str) -> str:
    """Replace characters that would end a comment."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _source(path: Path, source: Path | None, suffixes: tuple[str, ...], root: Path) -> Loaded:
    """Load the source document, which by default is the only candidate in the folder of the new file."""
    if source is None:
        folder = path.parent
        beside = sorted(p for p in folder.glob("*.yaml") if p.name.endswith(suffixes)) if folder.is_dir() else []
        if len(beside) != 1:
            found = "several documents" if beside else "no scene"
            raise NewError(f"specify the scene with --from, because {folder.resolve().name}/ contains {found}")
        source = beside[0]
    return _valid(source, root)


def _valid(path: Path, root: Path) -> Loaded:
    """Load a document.

    Raises:
        SpecError: If the document has errors.
    """
    loaded = load(path, root)
    if loaded.errors:
        raise SpecError(loaded.errors)
    return loaded


def _scene(loaded: Loaded) -> SceneSpec:
    """Return a document if it is a scene, or the scene that a task refers to."""
    spec = loaded.spec
    if isinstance(spec, TaskSpec):
        used = loaded.used(spec.scene)
        spec = used.spec if used is not None else None
    if not isinstance(spec, SceneSpec):
        message = "expected a scene, or a task that refers to a scene"
        raise SpecError([Diagnostic("SF006", Severity.ERROR, message, str(loaded.path), 1, 1, "simfoundry")])
    return spec


def _free(loaded: Loaded) -> dict[str, ObjectSpec]:
    """Return the objects that can move."""
    free = {name: item for name, item in _scene(loaded).objects.items() if not item.fixed}
    if not free:
        raise NewError(f"every object in {loaded.path.name} is fixed, so none can move")
    return free


def _task(path: Path, source: Path | None, root: Path) -> dict[str, str]:
    """Return the template variables for a task: placing one object on another, or lifting the only object."""
    loaded = _source(path, source, (".scene.yaml",), root)
    free = _free(loaded)
    carriers = {_carrier(item) for item in free.values()}
    rolling = [name for name, item in free.items() if isinstance(item.shape, SphereShape)]
    thing, *after = sorted(free, key=lambda name: (name in carriers, name in rolling))  # stable sort
    target = next((name for name in after if name not in (_carrier(free[thing]), *rolling)), "")
    words = {"goal": f"Lifted({thing})", "step": f"lift_{thing}", "instruction": f"Lift the {thing}."}
    if target:
        words = {"goal": f"OnTop({thing}, {target})", "step": f"{thing}_on_{target}"}
        words["instruction"] = f"Put the {thing} on the {target}."
    words["instruction"] = words["instruction"].replace("_", " ")
    regions = [(name, _where(item)) for name, item in free.items() if name in (thing, target)]
    lines = [f"    {name}: {_region(*where)}" for name, where in regions if where is not None]
    ranges = "ranges of x and y in the world [m], and of the rotation about z [deg]"
    reset = ["  objects:", f"    # {ranges}", *lines]
    if not lines:
        reset = [f"  # {ranges}:", f"  # objects: {{{thing}: {_region(0.45, 0)}}}"]
    return {**_named(loaded.path, path), "thing": thing, **words, "reset": "\n".join(reset)}


def _carrier(item: ObjectSpec) -> str:
    """Return the name of the object that another object is placed on or inside, or an empty string."""
    return "" if item.place is None else (item.place.on or item.place.inside or "").partition(".")[0]


def _where(item: ObjectSpec) -> tuple[float, float] | None:
    """Return the x and y coordinates [m] of an object in the world, if they are specified."""
    return (item.pose.xyz[0], item.pose.xyz[1]) if item.place is None else item.place.xy


def _region(x: float, y: float) -> str:
    ends = [[number(v - REGION), number(v + REGION)] for v in (x, y)]
    return f"{{x: [{', '.join(ends[0])}], y: [{', '.join(ends[1])}], yaw_deg: [-180, 180]}}"


def _cousins(path: Path, source: Path | None, root: Path) -> dict[str, str]:
    """Return the template variables for a recipe that places the first free object around another object."""
    loaded = _source(path, source, (".scene.yaml", ".task.yaml"), root)
    thing, *others = _free(loaded)
    anchors = [*others, *(name for name in _scene(loaded).objects if name != thing)]
    if not anchors:
        raise NewError(f"{loaded.path.name} has only one object, so nothing can be placed around another")
    return {**_named(loaded.path, path), "thing": thing, "anchor": anchors[0]}


def _overlay(kind: str, path: Path, base: Path, root: Path) -> dict[str, str]:
    """Return the template variables for an overlay that rotates the first free object."""
    loaded = _valid(base, root)
    if getattr(loaded.spec, "simfoundry", None) != f"{kind}/1":
        raise NewError(f"a {kind} can only extend another {kind}, and {base} is not one")
    objects = loaded.spec.objects if isinstance(loaded.spec, SceneSpec) else {}
    for name, item in objects.items():
        if not item.fixed:
            change = f"{'pose' if item.place is None else 'place'}: {{yaw_deg: 45}}"
            text = f"\nobjects:\n  {name}:\n    {change}  # rotated; all other keys are inherited"
            return {**_named(base, path), "objects": text}
    return {**_named(base, path), "objects": ""}
