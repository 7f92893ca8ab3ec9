"""Named extensions, either built into SimFoundry or provided by installed packages through entry points.

Each kind of extension has a :class:`Registry` next to the code that uses it. A package provides an extension with an
entry point in the group for that kind, for example::

    [project.entry-points."simfoundry.backends"]
    sdf = "my_package.sdf:BACKEND"
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType
from typing import Generic, TypeVar, cast

from simfoundry.errors import SimfoundryError

T = TypeVar("T")

# The entry point groups, each with the kind of extension that it contains, as used in messages.
GROUPS: Mapping[str, str] = {
    "simfoundry.backends": "backend",
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
    """Raised for a plug-in that cannot be loaded. The message states its package and the cause."""


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
        try:
            return resolve_name(self.value)
        except SimfoundryError:
            raise
        except Exception as error:  # importing a third-party module may raise any exception
            raise self.error(f"{type(error).__name__}: {error}") from error

    def folder(self) -> Path:
        """Return the folder of the package that the entry point refers to. Targets and robots require a folder."""
        self._check_unique()
        try:
            spec = find_spec(self.value)
        except Exception as error:  # finding the package imports its parent, which may raise any exception
            raise self.error(f"{type(error).__name__}: {error}") from error
        places = list(spec.submodule_search_locations or ()) if spec is not None else []
        if not places:
            raise self.error(f"`{self.value}` is not a package (a folder with files)")
        return Path(places[0])

    def _check_unique(self) -> None:
        if self.rival:
            raise self.error(f"the package {self.rival} provides an extension with the same name")

    def error(self, cause: str) -> PluginError:
        """Return an error that explains why this plug-in cannot be used."""
        what = f"the `{self.name}` {GROUPS.get(self.group, 'extension')} from the package {self.distribution}"
        cause = " ".join(cause.split()).rstrip(".")
        return PluginError(
            f"{what} cannot be loaded: {cause}. Update or uninstall that package "
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

    def load_all(self) -> dict[str, T]:
        """Import and return all extensions of this kind, keyed by name."""
        return {name: self.load(name) for name in self.names()}


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
