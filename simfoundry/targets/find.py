"""Lookup of targets by name or path.

The targets are plain backends, built-in targets, and targets from packages and users.
"""

from __future__ import annotations

import inspect
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.backends import BACKENDS, features_of
from simfoundry.backends.features import FEATURES, Fidelity
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.files import shipped
from simfoundry.runtime.plugins import PluginError, plugins
from simfoundry.spec.diagnostics import Diagnostic, SpecError, nearest
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, read

if TYPE_CHECKING:
    from simfoundry.targets.profile import TargetSpec

GROUP = "simfoundry.targets"
# The standard file names in a target's folder.
PROFILE, LOADER, READBACK = "profile.yaml", "load.py", "readback.py"

SUFFIXES = (".yaml", ".yml")


class UnknownTargetError(SimfoundryError):
    """Raised if no target has the given name."""


@dataclass(frozen=True)
class Target:
    """A format or simulator for which scenes are compiled, with its profile and the folder for its other files."""

    profile: TargetSpec
    folder: Path | None = None

    @property
    def name(self) -> str:
        """The name to use with ``-t``, which is also the name of the target's folder in a build."""
        return self.profile.name

    @property
    def backend(self) -> str:
        """The backend that writes the target's files."""
        return self.profile.backend

    @property
    def loader(self) -> Path | None:
        """The target's own ``load.py``, or None if builds use the loader of the backend."""
        if self.folder is None or self.name == self.backend:
            return None
        if self.profile.loader is not None:
            return self.folder / self.profile.loader
        return self._file(LOADER)

    @property
    def readback(self) -> Path | None:
        """The module that ``verify`` uses to read builds back, or None if builds cannot be read back."""
        return self._file(READBACK) if self.profile.engine is not None else None

    def _file(self, name: str) -> Path | None:
        path = None if self.folder is None else self.folder / name
        return path if path is not None and path.is_file() else None


@cache
def _own_folders() -> Mapping[str, Path]:
    """Return the folders of the built-in targets, sorted by name."""
    return {path.parent.name: path.parent for path in sorted(shipped("targets").glob(f"*/{PROFILE}"))}


def target_names() -> list[str]:
    """Return all names that ``-t`` accepts: plain backends, then simulators, then targets from installed packages."""
    return list(dict.fromkeys((*BACKENDS.names(), *_own_folders(), *plugins(GROUP))))


def find_target(name: str | Path) -> Target:
    """Return the target called ``name``, or the target whose folder or profile is at the path ``name``.

    A ``Path`` is never the name of a target.

    Raises:
        UnknownTargetError: If the name is unknown.
        SpecError: If the profile is invalid. The error contains all findings.
        PluginError: If the package that provides the target is broken.
    """
    if str(name).endswith(SUFFIXES):
        return read_profile(Path(name))
    if isinstance(name, Path) or "/" in name or "\\" in name:
        return read_profile(Path(name) / PROFILE)
    if name in _own_folders():
        return read_profile(_own_folders()[name] / PROFILE)
    if name in BACKENDS:
        return _plain(name)
    plugin = plugins(GROUP).get(name)
    if plugin is not None:
        return read_profile(plugin.folder() / PROFILE)
    hint = nearest(name, target_names()) + " To use your own target, specify its folder, such as `./my_sim`."
    raise UnknownTargetError(f"no target is called `{name}`; {hint}")


def find_targets(names: Iterable[str | Path]) -> tuple[list[Target], dict[str, str]]:
    """Return the targets that can be used, and the reasons why the others cannot, by name.

    Raises:
        UnknownTargetError: If a name is unknown.
        SpecError: If no target can be used because of an invalid profile.
        PluginError: If no target can be used because of a broken package.
    """
    found, errors = dict[str, Target](), dict[str, PluginError | SpecError]()
    for name in names:
        try:
            found[str(name)] = find_target(name)
        except (PluginError, SpecError) as error:
            errors[str(name)] = error
    if errors and not found:
        raise next(iter(errors.values()))
    unique = {target.name: target for target in found.values()}
    return list(unique.values()), {name: "; ".join(str(error).splitlines()) for name, error in errors.items()}


def _plain(backend: str) -> Target:
    """Return the target for a backend that has no target folder. The backend's files are used without a profile."""
    from simfoundry.targets.profile import TargetSpec

    data = {"simfoundry": "target/1", "name": backend, "backend": backend}
    data["description"] = "the plain files of the backend"
    tested = {"how": "checked", "note": "by the package that provides the backend"}
    return Target(TargetSpec.model_validate({**data, "tested": tested}))


def read_profile(path: Path) -> Target:
    """Read the profile at ``path``.

    Raises:
        SpecError: If the profile is invalid. The error contains all findings.
    """
    from simfoundry.spec.check.validate import sound_part, validate
    from simfoundry.targets.profile import TargetSpec

    try:
        document = read(path)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(path))]) from None
    spec, findings = validate(TargetSpec, document)
    if (sound := spec or sound_part(TargetSpec, document)) is not None:
        findings += _findings(sound, document, path)
    if spec is None or findings:
        raise SpecError(findings)
    # Only a profile named `profile.yaml` describes its folder; a profile with a different file name is standalone.
    return Target(spec, path.parent if path.name == PROFILE or spec.loader is not None else None)


def _findings(spec: TargetSpec, document: Document, path: Path) -> Iterator[Diagnostic]:
    """Yield the problems in a profile that validation of its data types cannot detect."""
    from simfoundry.targets.profile import BEHAVIORS, QUANTITIES, READ_BACK

    def known(name: str, choices: Collection[str], place: tuple[str, ...], what: str) -> Iterator[Diagnostic]:
        if name not in choices:
            message = f"no {what} is called `{name}`"
            yield document.finding("SF201", place, message, nearest(name, choices) or "none is defined", of_key=True)

    whole = path.name == PROFILE
    own_name = path.resolve().parent.name if whole else path.stem
    if spec.name != own_name and spec.name in document.data.values():
        place = f"its folder is `{own_name}`" if whole else f"its file is `{path.name}`"
        yield document.finding("SF106", ("name",), f"the profile is called `{spec.name}`, but {place}", f"`{own_name}`")
    yield from known(spec.backend, BACKENDS.names(), ("backend",), "backend")
    if spec.backend in BACKENDS:
        options = backend_options(spec.backend)
        for name, value in spec.options.items():
            yield from known(name, options, ("options", name), f"option of the backend `{spec.backend}`")
            if name in options and not isinstance(value, type(options[name])):
                message = f"expected {_KINDS[type(options[name])]}, such as `{options[name]}`"
                yield document.finding("SF103", ("options", name), message)
        cells = features_of(spec.backend)
        for name in spec.combines.model_dump(exclude_none=True):
            if cells[name].fidelity is Fidelity.DROPPED and len(document.known(("restores", name))) < 2:
                message = f"the backend `{spec.backend}` drops `{name}`; list it under `restores`, or remove the rule"
                yield document.finding("SF107", ("combines", name), message)
    names = {"restores": (FEATURES, "feature"), "gaps": (FEATURES, "feature"), "behaviors": (BEHAVIORS, "behavior")}
    names["tolerances"] = (READ_BACK, *QUANTITIES, *BEHAVIORS), "quantity or behavior"
    for key, (choices, what) in names.items():
        for name in getattr(spec, key):
            yield from known(name, choices, (key, name), what)
    folder = path.parent.resolve()
    if spec.loader is not None:
        loader = (folder / spec.loader).resolve()
        if not (loader.is_relative_to(folder) and loader.is_file()):
            hint = "the loader must be in the same folder as the profile"
            yield document.finding("SF203", ("loader",), f"file `{spec.loader}` does not exist", hint)
    if spec.engine is not None and not (whole and (folder / READBACK).is_file()):
        hint = "an engine requires a read-back module with this name next to `profile.yaml`"
        yield document.finding("SF203", ("engine",), f"file `{READBACK}` does not exist", hint)
    if spec.tolerances and not document.known(("engine",)):
        hint = "add an engine for reading builds back under `engine`, or remove the tolerances"
        yield document.finding("SF107", ("tolerances",), "tolerances have no effect without an `engine`", hint)


_KINDS = {float: "a number", bool: "`true` or `false`", str: "a string"}


def backend_options(backend: str) -> dict[str, float | bool | str]:
    """Return the default values of a backend's options, keyed by name."""
    parameters = list(inspect.signature(BACKENDS.load(backend).compile).parameters.values())
    return {p.name: p.default for p in parameters[1:]}
