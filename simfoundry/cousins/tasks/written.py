"""Proposals as files: one task document each in canonical form, checked as a user would check it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from simfoundry.cousins.reasons import Reason
from simfoundry.cousins.tasks.enumerate import Proposal
from simfoundry.lint.run import lint
from simfoundry.runtime.files import write_atomically
from simfoundry.spec.load import load
from simfoundry.spec.yaml.write import to_yaml

SUFFIX = ".task.yaml"


def scene_reference(scene: Path, out: Path) -> str:
    """How a document in ``out`` names a scene."""
    return Path(os.path.relpath(scene.resolve(), out.resolve())).as_posix()


def checked(proposals: Sequence[Proposal], out: Path) -> list[Proposal]:
    """The proposals; of those that would not pass ``simfoundry check`` in ``out`` with its findings as reasons."""
    return [_checked(proposal, out) for proposal in proposals]


def _checked(proposal: Proposal, out: Path) -> Proposal:
    if not proposal.accepted or proposal.task is None:
        return proposal
    loaded = load(file_of(proposal, out), text=to_yaml(proposal.task))
    found = loaded.findings or [d for d in lint(loaded) if d.file == str(file_of(proposal, out))]
    return replace(proposal, reasons=tuple(Reason("check", f"{d.code}: {d.message}") for d in found[:3]))


def file_of(proposal: Proposal, out: Path) -> Path:
    """The file of a proposal."""
    return out / f"{proposal.name}{SUFFIX}"


def write(proposals: Sequence[Proposal], out: Path) -> list[Path]:
    """Write the accepted ones; their files in order."""
    files = []
    for proposal in proposals:
        if proposal.accepted and proposal.task is not None:
            write_atomically(file_of(proposal, out), to_yaml(proposal.task).encode())
            files.append(file_of(proposal, out))
    return files


def to_json(proposal: Proposal, out: Path) -> dict[str, Any]:
    """A plain mapping, for scripts."""
    task = proposal.task
    return {
        "name": proposal.name,
        "goal": proposal.goal,
        "accepted": proposal.accepted,
        "instruction": task.instruction if task is not None else None,
        "file": str(file_of(proposal, out)) if proposal.accepted else None,
        "reasons": [reason.to_json() for reason in proposal.reasons],
    }
