"""Merges of two independent edits of documents with reuse: equal to both edits, in either order, comments kept.

``python -m tests.corpora.reuse_merges [--count N]`` prints a table, kind by kind, and exits with 1 if a merge is wrong.
"""

from __future__ import annotations

import random
import re
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simfoundry.spec.change.merge.conflict import dotted
from simfoundry.spec.change.merge.texts import merge_texts
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY
from tests.corpora.mutations import options
from tests.corpora.reuse_edits import SETS, Edit, edits

COUNT = 1000
DOCUMENTS = REPOSITORY / "tests/corpora/reuse"

# One pair of edits in this many is about the same value, and must be recorded as a conflict.
CLASHES = 10


@dataclass
class Outcome:
    """What became of the pairs."""

    pairs: int = 0
    clashes: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


def merge_pairs(count: int, seed: int = 0) -> Outcome:
    """Merge ``count`` pairs of edits, evenly of each document."""
    out = Outcome()
    paths = sorted(DOCUMENTS.glob("*.scene.yaml"))
    for k in range(count):
        rng = random.Random(f"{seed} {k}")
        path = paths[k % len(paths)]
        clash = k % CLASHES == 0
        (_clash if clash else _independent)(path, rng, out)
        out.pairs += 1
        out.clashes += clash
    return out


def _independent(path: Path, rng: random.Random, out: Outcome) -> None:
    base = path.read_text()
    sides = independent(base, rng)
    out.kinds.update(edit.kind for side in sides for edit in side)
    texts = [applied(base, side) for side in sides]
    merges = [merge_texts(base, *texts), merge_texts(base, *reversed(texts))]
    wanted = [applied(base, [*sides[0], *sides[1]]), applied(base, [*sides[1], *sides[0]])]
    shown = f"{path.name}: {' | '.join(' + '.join(e.shown or e.kind for e in side) for side in sides)}"
    for merged in merges:
        if merged.conflicts:
            out.wrong.append(f"{shown}: conflict {'; '.join(map(str, merged.conflicts))}")
            return
        for text in wanted:
            difference = differing(meaning(path, text), meaning(path, merged.text))
            if difference:
                out.wrong.append(f"{shown}: {difference}")
                return
        known = [remarks(text) for text in (base, *texts)]
        lost = (known[1] | known[2]) - remarks(merged.text) - (known[0] - (known[1] & known[2]))
        if lost:
            out.wrong.append(f"{shown}: lost {lost}")
            return


def independent(base: str, rng: random.Random) -> tuple[list[Edit], list[Edit]]:
    """Edits of two sides, of which none touches another."""
    found = [*edits(base, rng, "o"), *edits(base, rng, "t")]
    kinds = sorted({edit.kind for edit in found})
    sides: tuple[list[Edit], list[Edit]] = ([], [])
    for k in range(rng.randrange(2, 9)):
        kind = rng.choice(kinds)
        edit = rng.choice([e for e in found if e.kind == kind])
        renames = [e for e in (*sides[k % 2], edit) if e.last]
        if any(edit.touches(other) for side in sides for other in side) or any(
            ("names", path[1]) in rename.paths for rename in renames for e in (*sides[k % 2], edit) if e is not rename
            for path in e.paths if len(path) > 1
        ):  # a side that renames a member and edits it as well has another member  # fmt: skip
            continue
        sides[k % 2].append(edit)
    return sides


def applied(text: str, side: list[Edit]) -> str:
    """The text with the edits of a side; new names come last."""
    for edit in sorted(side, key=lambda e: e.last):
        text = edit.apply(text)
    return text


def meaning(path: Path, text: str) -> dict[str, Any]:
    """The data with everything written out, in which relations and pairs have no order, and its errors."""
    loaded = load(path, text=text)
    assert loaded.document is not None
    data = dict(loaded.document.data)
    for key in SETS:
        data[key] = {item if isinstance(item, str) else frozenset(item) for item in data.get(key, ())}
    return {**data, "errors": sorted({(d.code, d.message) for d in loaded.errors})}


def differing(a: Any, b: Any, path: str = "") -> str:
    """The first difference between two data, or an empty text."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in dict.fromkeys([*a, *b]):
            if key not in a or key not in b:
                return f"{path}.{key} is only in {'the merge' if key in b else 'the edited text'}"
            if found := differing(a[key], b[key], f"{path}.{key}"):
                return found
        return ""
    return "" if a == b else f"{path}: {a} or {b}"


def remarks(text: str) -> set[str]:
    """The comments in a text."""
    return {match[1].strip() for line in text.splitlines() if (match := re.search(r"(?:^|\s)#(.*)$", line))}


def _clash(path: Path, rng: random.Random, out: Outcome) -> None:
    """Edit one value on both sides; everything else is merged, and the two values are recorded."""
    base = path.read_text()
    ours, theirs = independent(base, rng)
    values = [e for e in edits(base, rng, "o") if e.kind.startswith("value")]
    edit = rng.choice([e for e in values if not any(e.touches(o) for o in (*ours, *theirs))])
    # A different new value for the same scalar.
    other = next(
        e
        for _ in range(200)
        for e in edits(base, rng, "t")
        if e.paths == edit.paths and e.apply(base) != edit.apply(base)
    )
    if any(e.last for e in (*ours, *theirs)):
        ours, theirs = [e for e in ours if not e.last], [e for e in theirs if not e.last]
    a, b = applied(base, [edit, *ours]), applied(base, [other, *theirs])
    out.kinds["clash"] += 1
    place = dotted(tuple(map(str, next(iter(edit.paths)))))
    for sides in ((a, b), (b, a)):
        merged = merge_texts(base, *sides)
        if [dotted(c.path) for c in merged.conflicts] != [place]:
            out.wrong.append(f"{path.name}: {edit.shown} | {other.shown}: {[str(c) for c in merged.conflicts]}")
            return
        if "conflicts:" not in merged.text:
            out.wrong.append(f"{path.name}: {edit.shown} | {other.shown}: not recorded")
            return


def main() -> int:
    """Print the table."""
    given = options(__doc__, COUNT)
    out = merge_pairs(given.count, given.seed)
    print("| edit | count |\n|---|---|")
    for kind, number in sorted(out.kinds.items()):
        print(f"| {kind} | {number} |")
    print(f"{out.pairs} pairs, {out.clashes} of them about one value; {len(out.wrong)} wrong")
    for line in out.wrong if given.show else out.wrong[:5]:
        print(f"  {line}", file=sys.stderr)
    return int(bool(out.wrong))


if __name__ == "__main__":
    sys.exit(main())
