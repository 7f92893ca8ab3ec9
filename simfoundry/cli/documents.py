"""Which documents a command works on."""

from __future__ import annotations

from pathlib import Path

from simfoundry.cli.output import CannotError
from simfoundry.spec.kinds import is_document


def documents(paths: tuple[Path, ...]) -> list[Path]:
    """The files themselves, and the documents below the folders; each once.

    Folders and files with a dot in front are passed over.
    """
    files: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            inside = (p for p in sorted(path.rglob("*.yaml")) if not _is_hidden(p.relative_to(path)))
            files |= dict.fromkeys(p for p in inside if is_document(p))
        elif path.exists():
            files[path] = None
        else:
            raise CannotError(f"there is no file {path}")
    if not files:
        raise CannotError(f"there is no document below {', '.join(map(str, paths))}")
    return list(files)


def _is_hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)
