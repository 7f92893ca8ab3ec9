"""Generator of the support matrix in the documentation: ``python -m simfoundry.targets.generated [--check]``."""

from __future__ import annotations

import sys
from pathlib import Path

from simfoundry.runtime.files import write_atomically
from simfoundry.targets.support import PAGE, support_page


def main(arguments: list[str]) -> int:
    """Update the page if it is out of date; with ``--check``, only report that. Return the exit status."""
    path, text = Path.cwd() / PAGE, support_page().encode()
    if not path.parent.is_dir():
        print("run this command in the root of the repository; there is no `docs` folder here", file=sys.stderr)
        return 2
    if path.is_file() and path.read_bytes() == text:
        return 0
    if "--check" in arguments:
        print(f"{PAGE} is out of date; run `make schemas`", file=sys.stderr)
        return 1
    write_atomically(path, text)
    print(f"wrote {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
