"""Write files generated from the models: ``python -m simfoundry.spec.generated [--check]``."""

from __future__ import annotations

import sys
from pathlib import Path

from simfoundry.runtime.files import write_atomically
from simfoundry.spec.check.pages import findings_page
from simfoundry.spec.editor.reference import reference
from simfoundry.spec.editor.schema import schemas
from simfoundry.spec.editor.signals_page import signals_page


def generated() -> dict[str, str]:
    """Return the text of every generated file, keyed by its path in the repository."""
    files = {f"schemas/{name}": text for name, text in schemas().items()}
    pages = {"docs/reference.md": reference(), "docs/findings.md": findings_page(), "docs/signals.md": signals_page()}
    return {**files, **pages}


def stale(root: Path) -> dict[str, str]:
    """Return the generated files below ``root`` that are missing or out of date."""
    return {path: text for path, text in generated().items() if not _is_current(root / path, text)}


def _is_current(path: Path, text: str) -> bool:
    return path.is_file() and path.read_bytes() == text.encode()


def main(arguments: list[str]) -> int:
    """Write files that are out of date, or only report them with ``--check``. Returns the exit status."""
    root = Path.cwd()
    if not (root / "schemas").is_dir():
        print("run this in the root of the repository, which contains the `schemas` folder", file=sys.stderr)
        return 2
    differing = stale(root)
    if "--check" in arguments:
        for path in differing:
            print(f"{path} does not match the models; run `make schemas`", file=sys.stderr)
        return 1 if differing else 0
    for path, text in differing.items():
        write_atomically(root / path, text.encode())
        print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
