"""How long an editor waits for the language server: prints the median and the 95th percentile of each wait.

    python -m tests.benchmarks.editor [--strokes 40] [--like boxes]

The server runs as an editor starts it and is driven over standard input and output. A digit is typed into a document
and removed again, and the time is taken until the findings of that version are published. Completion, hover and the
preparation of a rename are requested while nothing else happens, and completion also right after a keystroke, while the
document is being checked. The bars are 150 ms from a keystroke to its findings for 10 objects, 500 ms for 1,000 (both
medians), and 50 ms for completion. The exit status is 1 if one is missed.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from tests.benchmarks.keystrokes import boxes, write_project
from tests.conftest import REPOSITORY
from tests.editor.client import Server, started

COMMAND = [sys.executable, "-m", "simfoundry", "lsp", "--stdio"]

# Seconds between a published finding and the next keystroke, as of a person who types fast.
PAUSE = 0.1

SMALL, LARGE, COMPLETION = 150.0, 500.0, 50.0
"""The longest waits [ms]: for findings in small and in large documents, and for completion."""


class Waits(NamedTuple):
    """Milliseconds that an editor waited."""

    what: str
    times: list[float]
    bar: float | None = None

    @property
    def is_late(self) -> bool:
        """Whether the bar is missed."""
        return self.bar is not None and statistics.median(self.times) > self.bar

    def __str__(self) -> str:
        ordered = sorted(self.times)
        late = "  MISSED" if self.is_late else ""
        p95 = ordered[min(len(ordered) - 1, round(0.95 * (len(ordered) - 1)))]
        return f"  {self.what:34} median {statistics.median(ordered):7.1f} ms   95 % {p95:7.1f} ms{late}"


def documents(folder: Path) -> Iterator[tuple[Path, float]]:
    """The documents to type into, each with its bar [ms]."""
    large = write_project(folder)
    small = folder / "ten.scene.yaml"
    small.write_text(boxes(10))
    yield small, SMALL
    for name in ("scenes/cluttered.scene.yaml", "tasks/cup_in_bowl.task.yaml", "tasks/clear_table.task.yaml"):
        yield REPOSITORY / "specs" / name, SMALL
    for path in large:
        yield path, LARGE


def place(text: str) -> dict[str, int]:
    """The position behind a number in the middle of a text."""
    ends = [number.end() for number in re.finditer(r"\d\.\d+", text)] or [len(text.rstrip())]
    return position(text, ends[len(ends) // 2])


def position(text: str, at: int) -> dict[str, int]:
    """The position of an offset in a text of ASCII characters."""
    return {"line": text.count("\n", 0, at), "character": at - (text.rfind("\n", 0, at) + 1)}


def typed(server: Server, path: Path, text: str, strokes: int, bar: float) -> Iterator[Waits]:
    """The waits after keystrokes, and for completion during the check of a keystroke."""
    at = place(text)
    after = {**at, "character": at["character"] + 1}
    findings, completions = list[float](), list[float]()
    for stroke in range(strokes):
        time.sleep(PAUSE)
        start = time.perf_counter()
        version = server.change(path, "5", start=at, end=at) if stroke % 2 == 0 else server.change(
            path, "", start=at, end=after
        )  # fmt: skip
        server.diagnostics_of(path, version)
        findings.append(1e3 * (time.perf_counter() - start))
    yield Waits("keystroke to findings", findings, bar)
    if "completionProvider" not in server.capabilities:
        return
    for stroke in range(strokes):
        time.sleep(PAUSE)
        version = server.change(path, "5", start=at, end=at) if stroke % 2 == 0 else server.change(
            path, "", start=at, end=after
        )  # fmt: skip
        time.sleep(0.01 * (stroke % 10))  # in each phase of the check
        start = time.perf_counter()
        server.completions(path, at["line"], at["character"])
        completions.append(1e3 * (time.perf_counter() - start))
        server.diagnostics_of(path, version)
    yield Waits("completion during a check", completions, COMPLETION)


# Requests by capability, each with the bar for its answer [ms].
REQUESTS: dict[str, tuple[str, float | None]] = {
    "completionProvider": ("textDocument/completion", COMPLETION),
    "hoverProvider": ("textDocument/hover", None),
    "definitionProvider": ("textDocument/definition", None),
    "referencesProvider": ("textDocument/references", None),
    "renameProvider": ("textDocument/prepareRename", None),
    "documentSymbolProvider": ("textDocument/documentSymbol", None),
    "inlayHintProvider": ("textDocument/inlayHint", None),
}


def asked(server: Server, path: Path, text: str, count: int) -> Iterator[Waits]:
    """The waits for answers while nothing else happens: at a key, a name and a value in turn."""
    places = [position(text, found.start(1)) for found in re.finditer(r"(?:on: |\n  |: )(\w)", text)]
    whole = {"start": {"line": 0, "character": 0}, "end": position(text, len(text))}
    for capability, (method, bar) in REQUESTS.items():
        if not server.capabilities.get(capability):
            continue
        times = []
        for k in range(count):
            at = places[k * 7919 % len(places)]
            start = time.perf_counter()
            params: dict[str, Any] = {"textDocument": {"uri": path.as_uri()}, "position": at, "range": whole}
            server.ask(method, **params, context={"includeDeclaration": True, "triggerKind": 1})
            times.append(1e3 * (time.perf_counter() - start))
        yield Waits(method.partition("/")[2], times, bar)


def memory(pid: int) -> float:
    """The resident memory of a process [MiB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def main() -> int:
    """Print the waits in each document, and the memory of the server afterwards."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--strokes", type=int, default=40)
    parser.add_argument("--like", default="", help="only documents with this in their name")
    arguments = parser.parse_args()
    is_late = False
    with tempfile.TemporaryDirectory() as folder:
        for path, bar in documents(Path(folder).resolve()):
            if arguments.like not in path.name:
                continue
            text = path.read_text(encoding="utf-8")
            with started(COMMAND, path.parent) as server:
                print(path.name)
                server.open(path, text)
                server.diagnostics(path)
                waits = typed(server, path, text, arguments.strokes, bar)
                for one in chain(waits, asked(server, path, text, arguments.strokes)):
                    print(one, flush=True)
                    is_late |= one.is_late
                print(f"  {'memory':34} {memory(server.process.pid):14.0f} MiB   errors {len(server.logged)}")
    return int(is_late)


if __name__ == "__main__":
    sys.exit(main())
