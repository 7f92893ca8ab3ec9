"""The whole flow on 24 pictures of real tables: ``python -m tests.corpora.captures``.

Each picture goes through the real commands, from capture to four compiled targets, which are then opened, read back
and simulated; and everything is done twice. Prints one table and says which bars are missed; exit code 1 if any is.
The pictures are not part of the project: ``--data`` says where they are.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from fnmatch import fnmatch
from pathlib import Path

from tests.corpora.realtables.commands import ROOT
from tests.corpora.realtables.documents import SETS, real_captures
from tests.corpora.realtables.proof import COLUMNS, MAX_MEGABYTES, MAX_SECONDS, prove
from tests.corpora.realtables.table import Bar, Row, text_table, totals_table

DATA = ROOT.parent / "shared" / "data"
MAX_MEDIAN_SECONDS = 30.0
MIN_IOU = 0.80
MAX_INEXACT, MAX_FAR_OFF = 5, 1
"""Of the captures with labels, how many may have another number of objects, and how many one that is off by two."""


def main() -> int:
    """Prove all captures, or those that are asked for; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="*", metavar="PATTERN", help="captures whose names match, as mosd_dev_*")
    parser.add_argument("--data", type=Path, metavar="DIR", help=f"default: {DATA}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there too")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep everything that was made, in this empty folder")
    options = parser.parse_args()
    data = options.data or DATA
    missing = [name for name in SETS if not (data / name / "capture.json").is_file()]
    if missing and options.data:
        parser.error(f"there is no {', '.join(missing)} in {data}")
    if missing:
        print(f"not run: it needs pictures that are not in {data}; name their folder with --data")
        return 0
    if options.keep and options.keep.exists() and any(options.keep.iterdir()):
        parser.error(f"{options.keep} is not empty")
    captures = [c for c in real_captures(data) if fnmatch(c.name, options.only)]
    if not captures:
        parser.error(f"no capture matches {options.only}")
    with tempfile.TemporaryDirectory(prefix="simfoundry-captures-") as temporary:
        base = options.keep or Path(temporary)
        rows = []
        for capture in captures:
            rows.append(prove(capture, base / capture.name))
            _say(rows[-1])
    bars = totals(rows)
    _print(rows, bars)
    if options.json:
        options.json.write_text(json.dumps({"rows": [asdict(r) for r in rows], "bars": [asdict(b) for b in bars]}))
    return 0 if all(bar.passed for bar in bars) else 1


def totals(rows: Sequence[Row]) -> list[Bar]:
    """Every bar over the captures that ran."""
    seconds = [r.measures.seconds for r in rows if r.measures.seconds is not None]
    memory = max((r.measures.megabytes or 0.0 for r in rows), default=0.0)
    bars = [
        Bar(f"median time at most {MAX_MEDIAN_SECONDS:.0f} s", f"{statistics.median(seconds):.1f} s",
            statistics.median(seconds) <= MAX_MEDIAN_SECONDS),
        Bar(f"no time above {MAX_SECONDS:.0f} s", f"{max(seconds):.1f} s", max(seconds) <= MAX_SECONDS),
        Bar(f"no memory above {MAX_MEGABYTES:.0f} MB", f"{memory:.0f} MB", memory <= MAX_MEGABYTES),
    ]  # fmt: skip
    bars += _against_labels(rows)
    for column in COLUMNS:
        judged = [row.cells[column].passed for row in rows if column in row.cells]
        judged = [passed for passed in judged if passed is not None]
        absent = sum(column not in row.cells for row in rows) if column not in ("IoU", "size") else 0
        if judged and column not in ("seconds", "MB"):
            good, wanted = sum(map(bool, judged)), len(judged) + absent
            bars.append(Bar(column, f"{good} of {wanted}", good == wanted))
    return bars


def _against_labels(rows: Sequence[Row]) -> list[Bar]:
    """Number of objects and overlap where people have marked them."""
    marked = [r.measures for r in rows if r.name.startswith("mosd_dev")]
    if not marked:
        return []
    known = [(m.objects_true, m.objects_found) for m in marked]
    off = [abs(t - f) if t is not None and f is not None else 99 for t, f in known]
    exact, near = sum(d == 0 for d in off), sum(d <= 1 for d in off)
    overlaps = [v for m in marked for v in m.overlaps]
    mean = statistics.fmean(overlaps) if overlaps else 0.0
    return [
        Bar("mosd_dev: number of objects within 1", f"{near} of {len(off)}", len(off) - near <= MAX_FAR_OFF),
        Bar("mosd_dev: number of objects exact", f"{exact} of {len(off)}", len(off) - exact <= MAX_INEXACT),
        Bar(f"mosd_dev: mean IoU at least {MIN_IOU:.2f}", f"{mean:.3f}", mean >= MIN_IOU),
    ]


def _say(row: Row) -> None:
    """What became of a capture, while the others are still to come."""
    print(f"{row.name}: {row.measures.seconds or 0:.0f} s, {len(row.failures) or 'no'} failures", file=sys.stderr)
    for line in row.failures:
        print(f"  {line}", file=sys.stderr)


def _print(rows: Sequence[Row], bars: Sequence[Bar]) -> None:
    print(text_table(rows, COLUMNS))
    print()
    print(totals_table(bars))
    failures = [line for row in rows for line in row.failures]
    if failures:
        print("\n" + "\n".join(failures))
    loads = [row.load for row in rows]
    print(f"\nload of this machine meanwhile: {min(loads):.1f} to {max(loads):.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    raise SystemExit(main())
