"""Why a file cannot be imported."""

from __future__ import annotations

from pathlib import Path

from simfoundry.errors import SimfoundryError


class ImportRefusedError(SimfoundryError):
    """A file that cannot be imported: where, why, and what to do about it."""

    def __init__(self, file: Path | str, message: str, line: int = 0, hint: str = "") -> None:
        place = f"{file}:{line}" if line else str(file)
        super().__init__(f"{place}: {message}" + (f"; {hint}" if hint else ""))
        self.file, self.line, self.reason, self.hint = str(file), line, message, hint

    def __reduce__(self) -> tuple[type[ImportRefusedError], tuple[str, str, int, str]]:
        return type(self), (self.file, self.reason, self.line, self.hint)
