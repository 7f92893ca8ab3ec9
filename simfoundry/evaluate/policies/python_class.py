"""User-defined policies, which are Python classes that run in this process and are selected by module or file."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import ImageSize, InvalidAnswerError, Observation, PolicyError
from simfoundry.evaluate.rollouts.execution import check_rate
from simfoundry.geometry.frames import Array
from simfoundry.runtime.plugins import fault_text
from simfoundry.spec.models.signals import ActionSpace, ImageKind


@dataclass(frozen=True)
class PythonClass:
    """A policy class, selected by its module and name.

    ``module`` is a dotted module name or the path of a ``.py`` file. ``arguments`` contains the keyword arguments of
    the constructor.
    """

    module: str
    name: str
    arguments: tuple[tuple[str, str | int | float], ...] = ()

    @property
    def digest(self) -> str:
        """A digest of the class's source file and arguments.

        Other files that the class reads are not included.
        """
        source = _source(self.module)
        return hashlib.sha256(repr(self).encode() + (source.read_bytes() if source else b"")).hexdigest()[:16]

    def find(self) -> Callable[..., Any]:
        """Import the class, or a different callable that creates a policy.

        Raises:
            PolicyError: If there is no such class or callable.
        """
        module = _module(self.module)
        made = getattr(module, self.name, None)
        if made is None:
            here = [n for n, v in vars(module).items() if inspect.isclass(v) and v.__module__ == module.__name__]
            raise PolicyError(f"{self.module} has no `{self.name}`; available classes: {', '.join(here) or 'none'}")
        if not callable(made):
            raise PolicyError(f"`{self.name}` in {self.module} is a `{type(made).__name__}`, not a class")
        factory: Callable[..., Any] = made
        return factory


class PythonPolicy:
    """A :class:`~simfoundry.evaluate.policies.base.Policy` that wraps an instance of a user-defined class.

    The instance must provide ``infer(observation)`` and ``action_space``. The members ``cameras``, ``control_hz``,
    ``image_kinds``, ``name``, ``reset(instruction, seed)`` and ``close()`` are optional. An exception that the instance
    raises while acting counts as an invalid response. Text that it prints is redirected to standard error because
    standard output is reserved for the command.
    """

    def __init__(self, choice: PythonClass) -> None:
        made = choice.find()
        self.name = choice.name
        try:
            with redirect_stdout(sys.stderr):
                self._policy = made(**dict(choice.arguments))
        except (Exception, SystemExit) as error:
            raise PolicyError(f"could not create `{choice.name}` from {choice.module}: {fault_text(error)}") from None
        self._reset: Callable[[str, int], None] | None = getattr(self._policy, "reset", None)
        self._infer: Callable[[Observation], Array] | None = getattr(self._policy, "infer", None)
        if not callable(self._infer):
            raise PolicyError(f"`{choice.name}` in {choice.module} has no method `infer(observation)`")
        self.action_space = self._space(getattr(self._policy, "action_space", None))
        self.control_hz = self._rate(getattr(self._policy, "control_hz", None))
        self.image_kinds = self._kinds(getattr(self._policy, "image_kinds", None))
        self.cameras = self._sizes(getattr(self._policy, "cameras", None))
        self.origin: Mapping[str, Any] = MappingProxyType({})

    def _space(self, space: object) -> ActionSpace:
        try:
            return ActionSpace.parse(space)
        except ValueError as error:
            raise PolicyError(f"`{self.name}` has `action_space` {space!r}: {error}") from None

    def _rate(self, control_hz: Any) -> float | None:
        try:
            check_rate(control_hz, f"`{self.name}`")
        except SimfoundryError as error:
            raise PolicyError(str(error)) from None
        return None if control_hz is None else float(control_hz)

    def _kinds(self, kinds: Any) -> tuple[ImageKind, ...]:
        words = (ImageKind.COLOR,) if kinds is None else (kinds,) if isinstance(kinds, str) else tuple(kinds)
        try:
            return tuple(ImageKind(word) for word in words)
        except ValueError:
            known = ", ".join(f'"{kind}"' for kind in ImageKind)
            raise PolicyError(f"`image_kinds` of `{self.name}` must contain only {known}, but is {kinds!r}") from None

    def _sizes(self, cameras: object) -> Mapping[str, ImageSize]:
        try:
            sizes = {
                str(name): size if isinstance(size, ImageSize) else ImageSize(*(int(side) for side in size))
                for name, size in dict(cameras or {}).items()  # type: ignore[call-overload]
            }
        except (TypeError, ValueError):
            message = f"`cameras` of `{self.name}` must map camera names to (width, height), but is {cameras!r}"
            raise PolicyError(message) from None
        return MappingProxyType(sizes)

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout."""
        if self._reset is not None:
            with self._answering():
                self._reset(instruction, seed)

    def infer(self, observation: Observation) -> Array:
        """Return the response from the user-defined class."""
        assert self._infer is not None
        with self._answering():
            return self._infer(observation)

    def close(self) -> None:
        """Close the instance.

        Exceptions are printed rather than raised, since the results are already complete.
        """
        close = getattr(self._policy, "close", None)
        if callable(close):
            try:
                with redirect_stdout(sys.stderr):
                    close()
            except (Exception, SystemExit) as error:
                print(f"could not close {self.name}: {fault_text(error)}", file=sys.stderr)

    @contextmanager
    def _answering(self) -> Iterator[None]:
        try:
            with redirect_stdout(sys.stderr):
                yield
        except PolicyError:  # raised on purpose with its own message, for example by a client of a server
            raise
        except (Exception, SystemExit) as error:
            raise InvalidAnswerError(f"{self.name} failed: {fault_text(error)}") from None


def _module(module: str) -> ModuleType:
    source = _source(module)
    if source is None:
        where = f"module `{module}` was found neither in the current folder nor among installed packages"
        where = f"file {module} does not exist" if _is_file(module) else where
        raise PolicyError(f"{where}; specify your own policy as `python:MODULE:CLASS` or `python:FILE.py:CLASS`")
    try:
        with redirect_stdout(sys.stderr):
            if not _is_file(module):
                return importlib.import_module(module)
            # Use a unique name, so that a file named `torch.py` does not replace the package that it imports.
            name = f"policy_{hashlib.sha256(str(source).encode()).hexdigest()[:8]}_{source.stem}"
            spec = importlib.util.spec_from_file_location(name, source)
            assert spec is not None and spec.loader is not None
            made = sys.modules[name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(made)
            return made
    except (Exception, SystemExit) as error:
        raise PolicyError(f"could not import {source}: {fault_text(error)}") from None


def _source(module: str) -> Path | None:
    """Return the file of a module, and add its folder to the import path.

    Installed packages take precedence, so a local file never shadows a package. The result is None if the module is not
    found.
    """
    file = Path(module).resolve()
    folder = str(file.parent if _is_file(module) else Path.cwd())
    sys.path += [] if folder in sys.path else [folder]
    if _is_file(module):
        return file if file.is_file() else None
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError, AttributeError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin and Path(spec.origin).is_file() else None


def _is_file(module: str) -> bool:
    return module.endswith(".py")
