"""The support matrix as it is checked in: ``python -m simfoundry.targets.generated [--check]``."""

from __future__ import annotations

import sys
from pathlib import Path

from simfoundry.runtime.files import write_atomically
from simfoundry.targets.support import PAGE, support_page


def main(arguments: list[str]) -> int:
    """Write the page where it is stale; with ``--check``, only say so. Returns the exit status."""
    path, text = Path.cwd() / PAGE, support_page().encode()
    if not path.parent.is_dir():
        print("run this in the root of the repository: there is no folder `docs` here", file=sys.stderr)
        return 2
    if path.is_file() and path.read_bytes() == text:
        return 0
    if "--check" in arguments:
        print(f"{PAGE} is not what the tables say; run `make schemas`", file=sys.stderr)
        return 1
    write_atomically(path, text)
    print(f"wrote {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
