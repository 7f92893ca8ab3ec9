"""How long a language server takes to complete in a scene of 1,000 objects: prints medians and maxima.

    python -m tests.benchmarks.completions [--runs 20]

Each answer is asked over standard input and output right after an edit, so that a check of the scene is running, and
again when the server is idle.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from tests.benchmarks.keystrokes import boxes
from tests.editor.client import Server, started
from tests.language_server.conftest import COMMAND

# Places in the text: what is replaced there, and by what, with a ``|`` for the cursor unless it is at the end.
PLACES = {
    "a key": ("    material: card\n", "    material: card\n    |\n"),
    "an object": ("place: {on: ground", "place: {on: "),
    "an argument": ("OnTop(box_500, ground)", "OnTop(box_500, "),
    "an argument, typed in part": ("OnTop(box_500, ground)", "OnTop(box_500, box_7"),
    "a predicate": ("OnTop(box_500, ground)", ""),
    "a material": ("material: card", "material: "),
    "a file of 300": ("    shape: {box: [0.3, 0.2, 0.15]}", "    asset: "),
    "a new object": ("  box_500:\n", "  |\n  box_500:\n"),
}


def main() -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args().runs
    text = boxes()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        (folder / "simfoundry.yaml").touch()
        (folder / "meshes").mkdir()
        for k in range(300):
            (folder / "meshes" / f"mesh_{k}.obj").touch()
        path = folder / "boxes.scene.yaml"
        with started(COMMAND, folder) as server:
            server.open(path, text)
            server.diagnostics(path)
            print(f"{'':32}{'offers':>8}{'checking: median':>18}{'max':>8}{'idle: median':>14}{'max':>8}   [ms]")
            for what, (old, new) in PLACES.items():
                _measure(server, path, text, what, old, new, runs)


def _measure(server: Server, path: Path, text: str, what: str, old: str, new: str, runs: int) -> None:
    start = text.index(old, len(text) // 3)
    before, _, after = new.partition("|")
    edited = text[:start] + before + after + text[start + len(old) :]
    cursor = start + len(before)
    line, column = edited.count("\n", 0, cursor), cursor - edited.rfind("\n", 0, cursor) - 1
    busy, idle, count = list[float](), list[float](), 0
    for _ in range(runs):
        server.change(path, text)
        server.change(path, edited)
        for times in (busy, idle):
            began = time.perf_counter()
            count = len(server.completions(path, line, column))
            times.append((time.perf_counter() - began) * 1e3)
            time.sleep(0.05 if times is idle else 0.9)  # the check has ended
    shown = "".join(
        f"{statistics.median(times):{width}.0f}{max(times):8.0f}" for times, width in ((busy, 18), (idle, 14))
    )
    print(f"{what:32}{count:8}{shown}", flush=True)


if __name__ == "__main__":
    main()
