"""A capture that is watched runs again after each edit, with two processes, and no edit is lost."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from simfoundry.capture.shared_modules import SHARED_MODULES
from simfoundry.errors import OutputError
from simfoundry.runtime.process_pair import ProcessPair
from tests.capture.runs import again, output, ran


def clear_row(file: Path) -> None:
    """Take the highest row of pixels from the masks, as a person might."""
    with Image.open(file) as image:
        palette, masks = image.getpalette(), np.array(image)
    masks[np.nonzero(masks)[0].min()] = 0
    changed = Image.fromarray(masks, mode="P")
    changed.putpalette(palette or [])
    changed.save(file)


def test_an_edit_during_a_run_is_kept(folder: Path) -> None:
    masks = folder / "out" / "masks.png"

    def edit(stage: str, _share: float) -> None:
        if stage == "pictures":
            clear_row(masks)

    (folder / "out" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"masks\.png was changed during the run"):
        again(folder, progress=edit)
    edited = masks.read_bytes()
    assert ("segment", "") in ran(again(folder)) and masks.read_bytes() == edited
    assert (folder / "out" / "notes.txt").read_text() == "mine"


@pytest.mark.slow  # 5 s: a process, and two first runs
def test_two_processes_write_what_one_writes(folder: Path) -> None:
    before = output(folder)
    with ProcessPair() as pair:
        pair.start(SHARED_MODULES)
        for _ in range(2):
            run = again(folder, redo_from="support", processes=pair)
    assert {stage for stage, _ in ran(run)} >= {"support", "shape", "texture", "doubts", "remove"}
    assert output(folder) == before


@pytest.mark.slow  # 8 s: the command, and three runs
def test_a_watched_capture_runs_again_until_it_is_interrupted(folder: Path) -> None:
    capture, out = folder / "capture" / "capture.yaml", folder / "out"
    command = [sys.executable, "-m", "simfoundry", "capture", str(capture), "-o", str(out), "--watch"]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, **pipes, preexec_fn=heed_interrupts) as process:
        assert process.stdout is not None
        limit = threading.Timer(120, process.kill)  # then a line is missing
        limit.start()
        lines = iter(process.stdout)
        assert "pictures in" in until(lines, "watching for changes")
        clear_row(out / "masks.png")
        assert "error" not in until(lines, "pictures in")
        text = capture.read_text()
        capture.write_text(f"{text}wrong: 1\n")
        assert "error[SF101]" in until(lines, "unknown key `wrong`")
        capture.write_text(text)
        assert "[ok]" in until(lines, "pictures in")
        process.send_signal(signal.SIGINT)
        assert process.wait(20) in (0, 1)
        limit.cancel()


def heed_interrupts() -> None:
    """Undo that shells make processes in the background, such as those of a test run, ignore interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def until(lines: Iterator[str], end: str) -> str:
    """Return the lines up to the one that contains a text."""
    read = ""
    for line in lines:
        read += line
        if end in line:
            return read
    raise AssertionError(f"`{end}` is missing in:\n{read}")
