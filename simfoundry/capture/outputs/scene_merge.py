"""Merge a new reconstruction into the scene that a person edited."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from simfoundry.capture.findings import CONFLICTING_EDIT, CaptureFinding
from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.merge.conflict import dotted
from simfoundry.spec.change.merge.texts import UnmergeableError, merge_texts, new_errors, resolve
from simfoundry.spec.change.merge.trees import model_in
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import read_tree
from simfoundry.spec.yaml.write import write_tree

HINT = "compare both values; to take the new one, write it into the scene or start over with --force"


@dataclass(frozen=True)
class MergedScene:
    """The text of a scene in which a person's edits and a new reconstruction are merged."""

    text: str
    findings: tuple[CaptureFinding, ...] = ()


def merge_scene(path: Path, base: str | None, ours: str | None, theirs: str) -> MergedScene:
    """Merge a new reconstruction into an edited scene.

    Where a person and the new reconstruction changed the same value, the value of the person is kept, and a finding
    says so.

    Args:
        path: File of the scene, for messages.
        base: Text of the scene that the last run reconstructed, or None.
        ours: Text of the scene as it is now, perhaps edited, or None.
        theirs: Text of the new reconstruction.

    Raises:
        SimfoundryError: The edited scene cannot be read.
    """
    if base is None or ours is None or ours == base:
        return MergedScene(theirs)
    try:
        merged = merge_texts(base, ours, theirs)
    except UnmergeableError as error:
        raise SimfoundryError(
            f"the edits in {path} cannot be merged into the new reconstruction: {error}; correct the file, or discard "
            "the edits with --force"
        ) from None
    text, findings = merged.text, []
    if merged.conflicts:
        tree = read_tree(parse(text, str(path)))
        tree, _ = resolve(tree, model_in(tree), "ours", [dotted(c.path) for c in merged.conflicts])
        text = write_tree(tree, model_in(tree))
        for conflict in merged.conflicts:
            message = f"your value of `{dotted(conflict.path)}` was kept, although the new reconstruction changed it"
            findings.append(CaptureFinding(CONFLICTING_EDIT, message, HINT))
    for found in new_errors(path, text, ours, theirs):
        where = f"`{found.path}`: " if found.path else ""
        message = f"your edits and the new reconstruction do not fit together: {where}{found.message}"
        findings.append(CaptureFinding(CONFLICTING_EDIT, message, found.hint or HINT))
    return MergedScene(text, tuple(findings))
