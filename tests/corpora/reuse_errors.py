"""Corruptions of documents that use reuse: each must be found, on a line that a person wrote, without a traceback.

``python -m tests.corpora.reuse_errors [--count N]`` prints a table, kind by kind, and exits with 1 where the bar is
missed.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path

import yaml

from simfoundry.spec.yaml.text import parse
from tests.conftest import REPOSITORY
from tests.corpora.mutations import Tally, corrupt, options, report
from tests.corpora.reuse_mutants import extended

COUNT = 2000
DOCUMENTS = REPOSITORY / "tests/corpora/reuse"


def corrupt_reuse(count: int, seed: int = 0) -> tuple[dict[str, Tally], Counter[str]]:
    """Check ``count`` corruptions of the documents, each as it is formatted and with every value on its own line."""
    with tempfile.TemporaryDirectory() as folder:
        both = Path(folder) / "reuse"
        shutil.copytree(DOCUMENTS, both)
        for path in sorted(DOCUMENTS.glob("*.scene.yaml")):
            data = _plain(parse(path.read_text()).data)
            (both / f"tall_{path.name}").write_text(yaml.safe_dump(data, sort_keys=False))
        return corrupt(count, seed, both, extended)


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def main() -> int:
    """Corrupt the documents of the corpus."""
    given = options(__doc__, COUNT)
    return report(*corrupt_reuse(given.count, given.seed), given.show)


if __name__ == "__main__":
    sys.exit(main())
