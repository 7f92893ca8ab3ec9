"""Single-field corruptions of the real specs: each must be found, on its line, without a traceback.

``python -m tests.corpora.mutations [--count N]`` prints a table, kind by kind, and exits with 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.lint.lints import lint
from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.kinds import is_document
from tests.conftest import REPOSITORY
from tests.corpora.spec_mutants import Mutant, mutants

COUNT = 4000
BAR = 0.97
"""The share of corruptions whose line must be among those that are pointed at."""


@dataclass
class Tally:
    """What became of the corruptions of one kind."""

    count: int = 0
    silent: list[str] = field(default_factory=list)
    crashed: list[str] = field(default_factory=list)
    elsewhere: list[str] = field(default_factory=list)
    later: int = 0
    """The number of corruptions whose line is pointed at, but not by the first error."""


def findings(path: Path) -> tuple[Loaded, list[Diagnostic]]:
    """What `simfoundry check` finds in a document."""
    loaded = load(path)
    return loaded, [*loaded.all_findings(), *lint(loaded)]


def corrupt(
    count: int,
    seed: int = 0,
    root: Path = REPOSITORY / "specs",
    generate: Callable[[str, str, random.Random], Iterator[Mutant]] = mutants,
) -> tuple[dict[str, Tally], Counter[str]]:
    """Check ``count`` corruptions of the documents below ``root``, evenly of each kind; counts of the codes too."""
    tallies: dict[str, Tally] = {}
    codes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "specs"
        shutil.copytree(root, work)
        (Path(folder) / ".git").mkdir()
        (Path(folder) / ".git" / "HEAD").touch()
        every: dict[str, list[tuple[Path, Mutant]]] = {}
        for path in sorted(p for p in work.rglob("*.yaml") if is_document(p)):
            rng = random.Random(f"{seed} {path.relative_to(work)}")
            for mutant in generate(path.read_text(), path.name, rng):
                every.setdefault(mutant.kind, []).append((path, mutant))
        rng = random.Random(seed)
        for chosen in every.values():
            rng.shuffle(chosen)
        while count > 0 and any(every.values()):
            for kind, chosen in every.items():
                if chosen and count > 0:
                    count -= 1
                    path, mutant = chosen.pop()
                    judge(path, mutant, tallies.setdefault(kind, Tally()), codes)
    return tallies, codes


def judge(path: Path, mutant: Mutant, tally: Tally, codes: Counter[str]) -> None:
    """Write a corruption in the place of the document, check it or its user, and put the document back."""
    before = path.read_bytes()
    what = f"{path.name}: {mutant.done}"
    tally.count += 1
    path.write_text(mutant.text)
    try:
        _, found = findings(path.with_name(mutant.user or path.name))
    except Exception:
        tally.crashed.append(f"{what}\n{traceback.format_exc()}")
    else:
        codes.update({d.code for d in found})
        if not found:
            tally.silent.append(what)
        elif not any((Path(d.file).name, d.line) in mutant.places(path.name) for d in found):
            first = found[0]
            tally.elsewhere.append(f"{what} (line {mutant.line}): said {first.line} {first.code} {first.message}")
        else:
            first = min(found, key=lambda d: (d.severity is not Severity.ERROR, d.file, d.line))
            tally.later += (Path(first.file).name, first.line) not in mutant.places(path.name)
    finally:
        path.write_bytes(before)


def options(description: str | None, count: int) -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--count", type=int, default=count)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", action="store_true", help="List what was missed.")
    return parser.parse_args()


def main() -> int:
    """Corrupt the specs of the repository."""
    given = options(__doc__, COUNT)
    return report(*corrupt(given.count, given.seed), given.show)


def report(tallies: dict[str, Tally], codes: Counter[str], show: bool) -> int:
    """Print the table; 1 where a bar is missed."""
    print("| corruption | count | crashed | silent | line pointed at | by the first error |\n|---|---|---|---|---|---|")
    for kind, t in tallies.items():
        share = 1 - (len(t.elsewhere) + len(t.silent)) / t.count
        first = share - t.later / t.count
        print(f"| {kind} | {t.count} | {len(t.crashed)} | {len(t.silent)} | {share:.3f} | {first:.3f} |")
        for line in (*t.crashed, *t.silent, *t.elsewhere) if show else t.crashed[:3]:
            print(f"  {line}", file=sys.stderr)
    total = sum(t.count for t in tallies.values())
    crashed, silent, elsewhere = (
        sum(len(getattr(t, name)) for t in tallies.values()) for name in ("crashed", "silent", "elsewhere")
    )
    share = 1 - (elsewhere + silent) / total
    first = share - sum(t.later for t in tallies.values()) / total
    print(f"| all | {total} | {crashed} | {silent} | {share:.3f} | {first:.3f} |")
    print("codes: " + ", ".join(f"{code} {n}" for code, n in sorted(codes.items())))
    return int(bool(crashed or silent or share < BAR))


if __name__ == "__main__":
    sys.exit(main())
