"""Named extensions, either built into SimFoundry or provided by installed packages through entry points.

Each kind of extension has a :class:`Registry` next to the code that uses it. A package provides an extension with an
entry point in the group for that kind, for example::

    [project.entry-points."simfoundry.backends"]
    sdf = "my_package.sdf:BACKEND"
"""

from __future__ import annotations

import re
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType
from typing import Generic, TypeVar, cast

from simfoundry.errors import SimfoundryError

T = TypeVar("T")

# Maximum length of a library's error message in our messages [characters]; some libraries print entire arrays.
LONGEST_MESSAGE = 300

# The entry point groups, each with the kind of extension that it contains, as used in messages.
GROUPS: Mapping[str, str] = {
    "simfoundry.backends": "backend",
    "simfoundry.dataset_formats": "dataset format",
    "simfoundry.dataset_profiles": "dataset profile",
    "simfoundry.importers": "importer",
    "simfoundry.lints": "lint",
    "simfoundry.policies": "policy protocol",
    "simfoundry.predicates": "predicate",
    "simfoundry.robots": "robot",
    "simfoundry.targets": "target",
}


class UnknownExtensionError(SimfoundryError):
    """Raised for an unknown extension. The message lists the available names."""


class PluginError(SimfoundryError):
    """Raised for a plug-in that cannot be loaded or that fails. The message states its package and the cause."""


def fault_text(error: BaseException, package: str = "") -> str:
    """Format an exception as a single line that includes its source location.

    The location is the last line of code in ``package``, or outside SimFoundry if no package is given.
    """
    frames = [(f.f_globals.get("__name__", ""), f.f_code, line) for f, line in traceback.walk_tb(error.__traceback__)]
    codes = [found for found in frames if (found[0].partition(".")[0] == (package or "simfoundry")) is bool(package)]
    where = [f" ({'/'.join(Path(code.co_filename).parts[-2 if package else -1 :])}:{line})" for _, code, line in codes]
    words = " ".join(str(error).split())[:LONGEST_MESSAGE]
    return f"{type(error).__name__}{': ' if words else ''}{words}" + "".join(where[-1:])


@dataclass(frozen=True)
class Plugin:
    """An extension provided by an installed package.

    ``value`` is the entry point, and ``distribution`` is the name and version of the package. If another package
    provides an extension with the same name, ``rival`` is that package, and neither extension can be used.
    """

    name: str
    group: str
    value: str
    distribution: str
    rival: str = ""

    def load(self) -> object:
        """Import the object that the entry point refers to."""
        self._check_unique()
        with self.running("cannot be loaded"):  # importing a third-party module may raise any exception
            return resolve_name(self.value)

    def folder(self) -> Path:
        """Return the folder of the package that the entry point refers to. Targets and robots require a folder."""
        self._check_unique()
        with self.running("cannot be loaded"):  # finding the package imports its parent
            spec = find_spec(self.value)
        places = list(spec.submodule_search_locations or ()) if spec is not None else []
        if not places:
            raise self.error(f"`{self.value}` is not a package (a folder with files)")
        return Path(places[0])

    def _check_unique(self) -> None:
        if self.rival:
            raise self.error(f"the package {self.rival} provides an extension with the same name")

    @contextmanager
    def running(self, outcome: str = "failed", kind: type[SimfoundryError] = PluginError) -> Iterator[None]:
        """Convert exceptions in this plug-in to ``kind``.

        Exceptions that SimFoundry defines are not converted, because their messages already state the cause.
        """
        try:
            yield
        except Exception as error:
            if any(base.__module__.startswith("simfoundry.") for base in type(error).__mro__):
                raise
            raise kind(str(self.error(error, outcome))) from error

    def error(self, cause: str | Exception, outcome: str = "cannot be loaded") -> PluginError:
        """Return an error that explains why this plug-in cannot be used. An exception is stated with its line."""
        what = f"the `{self.name}` {GROUPS.get(self.group, 'extension')} from the package {self.distribution}"
        text = cause if isinstance(cause, str) else fault_text(cause, re.split("[.:]", self.value)[0])
        return PluginError(
            f"{what} {outcome}: {text}. Update or uninstall that package "
            f"(entry point `{self.name} = {self.value}` in the `{self.group}` group)"
        )


@dataclass(frozen=True)
class Registry(Generic[T]):
    """A registry of all extensions of one kind. An extension is not imported until it is used.

    ``built_in`` maps names to ``module:attribute``. A plug-in cannot replace a built-in extension, so installing a
    package never changes the meaning of an existing document. Installed packages are not even searched if the name is
    built in.
    """

    group: str
    built_in: Mapping[str, str]
    kind: type[T] | None = field(default=None, compare=False)

    def names(self) -> list[str]:
        """Return all names: first the built-in names in the order of definition, then the sorted names of plug-ins."""
        return [*self.built_in, *(name for name in plugins(self.group) if name not in self.built_in)]

    def __contains__(self, name: object) -> bool:
        return name in self.built_in or name in plugins(self.group)

    def plugin(self, name: str) -> Plugin | None:
        """Return the plug-in called ``name``, or None if the name is built in or unknown."""
        return None if name in self.built_in else plugins(self.group).get(name)

    def load(self, name: str) -> T:
        """Import and return the extension called ``name``.

        Raises:
            UnknownExtensionError: If the name is unknown; the message lists the available names.
            PluginError: If the plug-in cannot be loaded.
        """
        if name in self.built_in:
            return cast(T, resolve_name(self.built_in[name]))
        plugin = self.plugin(name)
        if plugin is None:
            known = ", ".join(f"`{known}`" for known in self.names())
            raise UnknownExtensionError(f"no {GROUPS[self.group]} is called `{name}`; available: {known}")
        found = plugin.load()
        if self.kind is not None and not isinstance(found, self.kind):
            raise plugin.error(f"`{plugin.value}` is a {type(found).__name__}, not a {self.kind.__name__}")
        return cast(T, found)

    def load_all(self) -> tuple[dict[str, T], dict[str, SimfoundryError]]:
        """Import all extensions of this kind.

        Returns:
            The extensions that can be loaded, and the errors of all others, keyed by name.
        """
        found, errors = dict[str, T](), dict[str, SimfoundryError]()
        for name in self.names():
            try:
                found[name] = self.load(name)
            except SimfoundryError as error:
                errors[name] = error
        return found, errors

    @contextmanager
    def running(self, name: str, kind: type[SimfoundryError] = PluginError) -> Iterator[None]:
        """Convert exceptions in the code of a plug-in to ``kind``. All code of extensions runs inside this context.

        It is also a decorator: ``IMPORTERS.running(name)(reader)`` is a reader. Exceptions in built-in extensions are
        not converted, because they are bugs in SimFoundry.
        """
        plugin = self.plugin(name)
        with nullcontext() if plugin is None else plugin.running("failed", kind):
            yield


def plugins(group: str) -> Mapping[str, Plugin]:
    """Return the extensions that installed packages provide in ``group``, sorted by name."""
    return _scan(group, tuple(sys.path))


@lru_cache(maxsize=64)
def _scan(group: str, path: tuple[str, ...]) -> Mapping[str, Plugin]:  # noqa: ARG001 - used only as a cache key
    """Read the metadata of every package on ``path``. This takes 2 ms per 100 packages, plus 20 ms for the import."""
    from importlib.metadata import entry_points

    found: dict[str, Plugin] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        rival = found[entry.name].distribution if entry.name in found else ""
        package = f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else "of unknown name"
        found[entry.name] = Plugin(entry.name, group, entry.value, package, rival)
    return found


def import_file(path: Path, place: Path | None = None) -> ModuleType:
    """Execute a file as a module without adding it to ``sys.modules``. ``place`` overrides its apparent location."""
    spec = spec_from_file_location(f"{path.parent.name}_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    module = module_from_spec(spec)
    if place is not None:
        module.__file__ = str(place)
    spec.loader.exec_module(module)
    return module
