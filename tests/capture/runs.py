"""Runs of a capture in a folder, and which of its stages they ran."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simfoundry.assets.cache import Cache
from simfoundry.capture.reconstruct import Progress
from simfoundry.capture.run import CaptureOptions, CaptureRun, run_capture


def again(folder: Path, progress: Progress = lambda stage, share: None, **options: Any) -> CaptureRun:
    cache = Cache(folder / "cache")
    return run_capture(folder / "capture", folder / "out", progress, cache, CaptureOptions(**options))


def ran(run: CaptureRun) -> set[tuple[str, str]]:
    return {key for key, state in run.states.items() if state == "ran"}


def output(folder: Path) -> dict[str, bytes]:
    files = (p for p in (folder / "out").rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files if "stages" not in p.parts}
