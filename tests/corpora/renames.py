"""Random renames in projects of ten documents, and in a copy of ``specs/``.

Run ``python -m tests.corpora.renames [--renames 200] [--seed 1] [--lints]``. After each rename, ``check`` must find
nothing new, only the name may have changed in the texts, and renaming back must restore each byte.
"""

from __future__ import annotations

import argparse
import random
import re
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.lint.lints import lint
from simfoundry.runtime.files import write_all_in_place
from simfoundry.spec.load import load
from simfoundry.spec.names.plan import RenamePlan, plan_rename
from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.names.symbols import Symbol
from simfoundry.spec.project import document_files
from tests.conftest import REPOSITORY
from tests.spec.names.projects import FILES, write_project

WORDS = (
    *("mug", "cup", "bowl", "oak", "clay", "hinge", "slide", "drawer", "lamp", "front", "top", "view", "arm", "tray"),
    *("lid", "knob", "corner", "shelf", "spoon", "plate", "gap", "red", "left", "on", "inside", "size", "mass", "name"),
    *("shape", "goal", "box", "joint", "a", "x2", "b_c", "z9_k", "part_a"),
)

# Names in the project, by where they must differ. Names in different groups may be equal.
GROUPS = (
    (
        *("mug", "cup", "bowl", "saucer", "coin", "shelf", "commode", "table", "arm", "corner", "deep"),
        *("spoon", "fork", "ball", "portrait"),
    ),
    ("bird", "eye"),
    ("clay", "wood"),
    ("vessel", "jug"),
    ("clearance", "rise"),
    ("big", "small"),
    ("plank", "slab"),
    ("oak", "brass"),
    ("trunk", "tray", "lid"),
    ("slide", "gimbal", "pan", "tilt"),
    ("base", "knob", "shell", "sheet"),
    ("tip",),
    ("pusher",),
    ("feeler", "encoder", "mark"),
    ("seize", "pull"),
    ("lamp",),
    ("west", "east"),
)
# Names that stay as they are, because no object may be called `west_x`.
FIXED = ("west", "east")

TOKEN = re.compile(r"[A-Za-z0-9_]+|[^A-Za-z0-9_]+")


def generated_project(rng: random.Random, folder: Path) -> Path:
    """Write a project of ten documents with random names and layout."""
    names: dict[str, str] = {}
    for group in GROUPS:
        taken = {names["portrait"]} if group == ("bird", "eye") else set()
        for old in group:
            new = old if old in FIXED else _word(rng, taken)
            taken.add(new)
            names[old] = new
    pattern = re.compile(rf"(?<![A-Za-z0-9])({'|'.join(sorted(names, key=len, reverse=True))})(?![A-Za-z0-9])")
    files = {}
    for name, text in FILES.items():
        text = pattern.sub(lambda m: names[m[1]], text)
        rows = [f"{row}  # {rng.choice(list(names.values()))}, as before" if _open(row, rng) else row
                for row in text.split("\n")]  # fmt: skip
        text = rng.choice(("", "", "\ufeff")) + rng.choice(("\n", "\n", "\r\n")).join(rows)
        files[name] = text if name != "simfoundry.yaml" else ""
    return write_project(folder, files)


def _open(row: str, rng: random.Random) -> bool:
    """Whether a comment can be added at the end of a row."""
    return rng.random() < 0.2 and row.rstrip().endswith(("}", "]")) and not row.strip().startswith("#")


def _word(rng: random.Random, taken: set[str]) -> str:
    while True:
        word = rng.choice(WORDS)
        if rng.random() < 0.3:
            word += rng.choice(("_a", "x", "_of_it"))
        if word not in taken:
            return word


def renameable(folder: Path) -> list[Symbol]:
    """The symbols that are defined in a project."""
    names = ProjectNames(folder, document_files(folder).included)
    found = {o.symbol for file in names.documents for o in names.occurrences(file) if o.is_definition}
    return sorted((s for s in found if s is not None), key=lambda s: (s.file, str(s.section), s.name))


def contents(folder: Path) -> dict[str, bytes]:
    """The content of every file below a folder."""
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*.yaml"))}


def findings(folder: Path, lints: bool) -> Counter[tuple[str, int, str]]:
    """What `check` finds, by file, line and code."""
    known, linted, found = {}, set(), Counter[tuple[str, int, str]]()  # type: ignore[var-annotated]
    for path in document_files(folder).included:
        loaded = load(path, folder, known)
        more = lint(loaded, linted) if lints else ()
        found.update((d.file, d.line, d.code) for d in (*loaded.findings, *more))
    return found


def errors(folder: Path) -> list[str]:
    """The errors in a project."""
    return [str(d) for path in document_files(folder).included for d in load(path, folder).errors]


def other_changes(before: bytes, after: bytes, old: str, new: str) -> list[str]:
    """The words that changed other than from the old to the new name, and places with other structure.

    This does not use what the rename knows of the texts: the texts must have the same words and the same characters
    between them, and a word may change only by one replacement of the name.
    """
    a, b = (TOKEN.findall(text.decode()) for text in (before, after))
    if len(a) != len(b):
        return ["the texts have different numbers of words"]
    wrong = []
    for x, y in zip(a, b, strict=True):
        places = [m.start() for m in re.finditer(f"(?={re.escape(old)})", x)]
        if x != y and not any(y == x[:k] + new + x[k + len(old) :] for k in places):
            wrong.append(f"`{x}` became `{y}`")
    for x, y in zip(before.splitlines(), after.splitlines(), strict=True):
        x_comment, y_comment = (line.partition(b" #")[2] or line * line.startswith(b"#") for line in (x, y))
        if x_comment != y_comment:
            wrong.append(f"the comment {x_comment!r} changed")
    return wrong


@dataclass
class Report:
    """The results of all renames."""

    renames: Counter[str] = field(default_factory=Counter)
    places: int = 0
    documents: int = 0
    failures: list[str] = field(default_factory=list)


def apply(plan: RenamePlan) -> None:
    """Write the edits of a plan."""
    write_all_in_place({edit.file: (edit.before.encode(), edit.after.encode()) for edit in plan.edits})


def try_rename(folder: Path, symbol: Symbol, new: str, report: Report, lints: bool) -> None:
    """Rename a symbol, check the result, rename it back, and check that again."""
    what = f"{symbol.kind} {symbol.name} → {new} in {Path(symbol.file).name}"
    before, was = contents(folder), findings(folder, lints)
    path = ".".join(map(str, (*symbol.section, symbol.name)))
    try:
        plan = plan_rename(Path(symbol.file), path, new)
    except Exception as error:
        report.failures.append(f"{what}: {error}")
        return
    apply(plan)
    after = contents(folder)
    report.renames[symbol.kind] += 1
    report.places += sum(len(edit.edits) for edit in plan.edits)
    report.documents += len(plan.edits)
    if more := findings(folder, lints) - was:
        report.failures.append(f"{what}: new findings {dict(more)}")
    for file, data in before.items():
        report.failures += [f"{what}: {file}: {w}" for w in other_changes(data, after[file], symbol.name, new)]
    path = ".".join(map(str, (*symbol.section, new)))
    try:
        apply(plan_rename(Path(symbol.file), path, symbol.name))
    except Exception as error:
        report.failures.append(f"{what}: back: {error}")
    if contents(folder) != before:
        report.failures.append(f"{what}: renaming back gives other bytes")
        for file, data in before.items():
            Path(file).write_bytes(data)


def run(renames: int, seed: int, lints: bool, specs: bool = True) -> Report:
    """Rename random symbols in random projects, with a fifth of the renames in a copy of ``specs/``."""
    rng, report = random.Random(seed), Report()
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place).resolve() / "specs"
        if specs:
            shutil.copytree(REPOSITORY / "specs", copy)
            (copy / "simfoundry.yaml").write_text("")
        for k in range(renames):
            folder = copy
            if not specs or k % 5:
                folder = generated_project(rng, Path(place).resolve() / f"project{k}")
                assert not errors(folder), errors(folder)
            symbols = renameable(folder)
            kinds = sorted({s.kind for s in symbols})
            kind = rng.choice([k for k in kinds if k in ("object", "joint", "camera", "material")] * 3 + kinds)
            symbol = rng.choice([s for s in symbols if s.kind == kind])
            taken = {s.name for s in symbols}
            # The name of an object without category is its category, for which other masses may be plausible; no
            # category ends like this.
            new = next(
                w for w in iter(lambda: _word(rng, set()) + rng.choice(("_new", "9", "_b")), "") if w not in taken
            )
            try_rename(folder, symbol, new, report, lints)
            if folder != copy:
                shutil.rmtree(folder)
    return report


def main() -> int:
    """Run the renames and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--renames", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lints", action="store_true", help="also compare the findings of geometry")
    given = parser.parse_args()
    report = run(given.renames, given.seed, given.lints)
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(report.renames.items()))
    print(f"{report.renames.total()} of {given.renames} renames: {kinds}")
    print(f"{report.places} places in {report.documents} documents; {len(report.failures)} failures")
    for failure in report.failures[:40]:
        print(failure)
    return 1 if report.failures else 0


if __name__ == "__main__":
    sys.exit(main())
