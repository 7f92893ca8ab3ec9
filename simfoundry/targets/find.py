"""Which targets there are, and their profiles read: those of the project, your own, and the plain backends."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.backends import BACKENDS
from simfoundry.backends.features import FEATURES
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import Diagnostic, SpecError, nearest
from simfoundry.spec.yaml.text import Document, YamlError, read

if TYPE_CHECKING:
    from simfoundry.targets.profile import TargetSpec

SUFFIXES = (".yaml", ".yml")
_PACKAGED = Path(__file__).parent / "profiles"
_CHECKOUT = Path(__file__).parents[2] / "targets"
_TEMPLATES = Path(__file__).parents[1] / "backends" / "templates"


class UnknownTargetError(SimfoundryError):
    """A name that is no target."""


@dataclass(frozen=True)
class Target:
    """A target: its name, the backend with its options, the text of its loader (None: the backend's), its profile."""

    name: str
    backend: str
    options: Mapping[str, float | bool | str] = field(default_factory=dict)
    loader: bytes | None = None
    profile: TargetSpec | None = None


def folder() -> Path:
    """Where the profiles of the project are: in the package, or in the checkout that it is run from."""
    return _PACKAGED if _PACKAGED.is_dir() else _CHECKOUT


def profile_names() -> list[str]:
    """The simulators that have a profile, sorted."""
    return sorted(path.stem for path in folder().glob("*.yaml"))


def target_names() -> list[str]:
    """Every name that ``-t`` takes: the plain backends, then the simulators."""
    return [*BACKENDS.names(), *(name for name in profile_names() if name not in BACKENDS)]


def find_target(name: str) -> Target:
    """The target called ``name``, or that of the profile at the path ``name``.

    Raises :class:`UnknownTargetError`, and :class:`SpecError` with every finding of a faulty profile.
    """
    if name.endswith(SUFFIXES):
        return read_profile(Path(name))
    path = folder() / f"{name}.yaml"
    if "/" not in name and path.is_file():
        return read_profile(path)
    if name in BACKENDS:
        return Target(name, name)
    hint = nearest(name, target_names()) + " A profile of your own is named by its path, as `my_sim.yaml`."
    raise UnknownTargetError(f"no target is called `{name}`; {hint}")


def read_profile(path: Path) -> Target:
    """The target of the profile at ``path``; raises :class:`SpecError` with every finding."""
    from simfoundry.spec.check.validate import validate
    from simfoundry.targets.profile import TargetSpec

    try:
        document = read(path)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(path))]) from None
    spec, findings = validate(TargetSpec, document)
    if spec is None:
        raise SpecError(findings)
    findings += _findings(spec, document, path)
    if findings:
        raise SpecError(findings)
    loader = None if spec.loader is None else _loader(spec.loader, path)
    return Target(spec.name, spec.backend, spec.options, None if loader is None else loader.read_bytes(), spec)


def _findings(spec: TargetSpec, document: Document, path: Path) -> Iterator[Diagnostic]:
    """What types cannot say about a profile."""

    def known(name: str, choices: Collection[str], place: tuple[str, ...], what: str) -> Iterator[Diagnostic]:
        if name not in choices:
            message = f"no {what} is called `{name}`"
            yield document.finding("SF201", place, message, nearest(name, choices) or "none is defined", of_key=True)

    if spec.name != path.stem:
        message = f"the profile is called `{spec.name}`, and its file `{path.name}`"
        yield document.finding("SF106", ("name",), message, f"`{path.stem}`")
    yield from known(spec.backend, BACKENDS.names(), ("backend",), "backend")
    if spec.backend in BACKENDS:
        options = backend_options(spec.backend)
        for name, value in spec.options.items():
            yield from known(name, options, ("options", name), f"option of the backend `{spec.backend}`")
            if name in options and not isinstance(value, type(options[name])):
                message = f"expected {_KINDS[type(options[name])]}, as `{options[name]}`"
                yield document.finding("SF103", ("options", name), message)
    for key in ("restores", "gaps"):
        for name in getattr(spec, key):
            yield from known(name, FEATURES, (key, name), "feature")
    if spec.loader is not None and _loader(spec.loader, path) is None:
        hint = "it stands beside the profile"
        yield document.finding("SF203", ("loader",), f"there is no file `{spec.loader}`", hint)


_KINDS = {float: "a number", bool: "`true` or `false`", str: "a text"}


def backend_options(backend: str) -> dict[str, float | bool | str]:
    """The options of a backend by name, with the values that they have where nobody says otherwise."""
    parameters = list(inspect.signature(BACKENDS.load(backend).compile).parameters.values())
    return {p.name: p.default for p in parameters[1:]}


def _loader(name: str, profile: Path) -> Path | None:
    """The file of a loader: beside the profile, or one that the backends ship."""
    beside, shipped = profile.parent / name, _TEMPLATES / name
    inside = (profile.parent.resolve(), _TEMPLATES)
    found = (p for p, root in zip((beside, shipped), inside, strict=True) if p.resolve().is_relative_to(root))
    return next((p for p in found if p.is_file()), None)
