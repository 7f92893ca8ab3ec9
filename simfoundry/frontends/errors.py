"""Errors raised when a file cannot be imported, including internal errors in an importer."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from simfoundry.assets.errors import MeshError
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.plugins import Plugin, fault_text
from simfoundry.spec.diagnostics import SpecError

# Maximum size of a file [bytes] that is searched for a line number.
MAX_BYTES = 50_000_000


class ImportRefusedError(SimfoundryError):
    """Raised if a file cannot be imported.

    The error includes the location, the reason, and a hint for the user.
    """

    def __init__(self, file: Path | str, message: str, line: int = 0, hint: str = "") -> None:
        place = f"{file}:{line}" if line else str(file)
        super().__init__(f"{place}: {message}" + (f"; {hint}" if hint else ""))
        self.file, self.line, self.reason, self.hint = str(file), line, message, hint


@contextmanager
def refusing_faults(file: Path, plugin: Plugin | None = None) -> Iterator[None]:
    """Convert unexpected errors during the import of ``file`` to :class:`ImportRefusedError`.

    SimFoundry's own errors and operating system errors are not converted. ``plugin`` is the importer that runs, if it
    is not built in.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # invalid numbers are reported when they are used
            yield
    except (SimfoundryError, SpecError, ModuleNotFoundError):
        raise
    except MeshError as error:
        raise ImportRefusedError(file, str(error), _line(file, error), error.hint) from error
    except ValidationError as error:  # values are copied unchanged and may be invalid in a document
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        message = f"its `{where}` is {first.get('input')!r:.60}, which is invalid in a document: {first['msg']}"
        raise ImportRefusedError(file, message, _line(file, error), "check its numbers and names") from error
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        if plugin is not None:
            raise ImportRefusedError(file, str(plugin.error(error, "failed")), _line(file, error)) from error
        message = f"the importer failed because of a bug in simfoundry: {fault_text(error, 'simfoundry')}"
        hint = "please report it together with this file; until it is fixed, remove the element at this line"
        raise ImportRefusedError(file, message, _line(file, error), hint) from error


def _line(file: Path, error: Exception) -> int:
    """Return the line of ``file`` that was being read when an error occurred, or 0 if the line is unknown.

    This is the line of the XML element being read. If no element was being read, it is the first line that contains the
    name of an affected element.
    """
    from simfoundry.frontends.draft import BodyDraft, CameraDraft, JointDraft, LinkDraft, PartDraft
    from simfoundry.frontends.files import Element

    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][::-1]
    at_hand = [value for frame in frames for value in frame.f_locals.values()]
    element = next((v for v in at_hand if isinstance(v, Element) and v.file == file), None)
    if element is not None:
        return element.line
    drafts = (BodyDraft, CameraDraft, JointDraft, LinkDraft, PartDraft)
    names = [*(arg for arg in error.args if isinstance(arg, str)), *(v.name for v in at_hand if isinstance(v, drafts))]
    if not file.is_file() or file.stat().st_size > MAX_BYTES or b"\0" in (data := file.read_bytes()):
        return 0
    lines = data.decode("utf-8", "replace").splitlines()
    return next((k for name in names for k, line in enumerate(lines, 1) if name and f'"{name}"' in line), 0)
