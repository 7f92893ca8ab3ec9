"""Models that are absent, die, hang, lie or send a bomb: a finding and a scene, and then the run resumes there."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.capture.run import CaptureRun
from simfoundry.models.setup import ModelSetup
from simfoundry.models.transports import http
from simfoundry.models.wire import BundleFile, BundleImage
from simfoundry.spec.models.model_sources import ModelSource
from tests.capture.runs import again, ran
from tests.capture.test_model_stages import capture, made
from tests.models.stand_ins import SOLVED, Result, StandIns, configured
from tests.models.test_transports import talking

__all__ = ["capture", "made"]

# The stage at which each task is asked for; that of `complete_depth` is the first of two.
STAGE = {
    "complete_depth": "depth", "read_scene": "read", "segment": "masks", "inpaint": "inpaint", "mesh": "mesh",
    "pose": "refine", "articulate": "parts", "parts": "parts", "splat": "background",
}  # fmt: skip

# Tasks that fail together, so that no failure keeps another task from being asked for, and those that answer meanwhile.
TOGETHER = {
    ("complete_depth", "inpaint", "mesh", "articulate", "splat"): ("read_scene", "segment", "parts"),
    ("pose", "parts"): ("read_scene", "segment", "mesh", "articulate"),
    ("segment",): (),
    ("read_scene",): (),
}


def member(name: str, change: Callable[[Any], Any]) -> Callable[[Result], None]:
    def spoil(result: Result) -> None:
        result.members[name] = change(result.members[name])

    return spoil


def values(change: Callable[[dict[str, Any]], Any]) -> Callable[[Result], None]:
    def spoil(result: Result) -> None:
        assert result.values is not None
        change(result.values)

    return spoil


def triangle(z: float) -> BundleFile:
    """A mesh of one triangle, which has no volume."""
    import trimesh

    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, z]], [[0, 1, 2]], process=False)
    return BundleFile("glb", bytes(flat.export(file_type="glb")))


def nan(array: Any) -> Any:
    return np.full_like(array, np.nan)


def nan_ply(splat: BundleFile) -> BundleFile:
    head, found, rows = splat.data.partition(b"end_header\n")
    return BundleFile("ply", head + found + np.full(len(rows) // 4, np.nan, np.float32).tobytes())


LIES: Mapping[str, Mapping[str, Callable[[Result], None]]] = {
    "nan": {
        "complete_depth": member("depth", nan),
        "read_scene": values(lambda v: v["objects"][0].update(mass=-1)),
        "segment": member("scores", nan),
        "inpaint": member("image", lambda image: BundleImage(255 - image.pixels)),
        "mesh": member("mesh", lambda _: triangle(float("nan"))),
        "pose": member("object_to_camera", nan),
        "parts": member("labels", lambda labels: np.full_like(labels, -1)),
        "articulate": values(lambda v: v["joints"][0].update(axis=[0, 0, 0])),
        "splat": member("splat", nan_ply),
    },
    "shape": {
        "complete_depth": member("depth", lambda depth: depth[:-1]),
        "read_scene": values(lambda v: v["objects"][0].update(box=[0, 0, 9999, 9999])),
        "segment": member("masks", lambda masks: masks[:, :, :-1]),
        "inpaint": member("image", lambda image: BundleImage(image.pixels[:-1])),
        "mesh": member("mesh", lambda _: triangle(0.0)),
        "pose": member("object_to_camera", lambda poses: poses[:, :3]),
        "parts": member("labels", lambda labels: labels[:-1]),
        "articulate": values(lambda v: v["joints"][0].update(part=99)),
        "splat": member("splat", lambda splat: BundleFile("ply", splat.data[:300])),
    },
}


def bomb() -> bytes:
    """A bundle with 2 GiB of zeros, whose size is stated in its central directory."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("answer.json", "{}")
        file.writestr("depth.npy", bytes(2**20))
    data = bytearray(stream.getvalue())
    at = data.rindex(b"PK\x01\x02")  # the entry of the second member
    data[at + 24 : at + 28] = (2**31).to_bytes(4, "little")
    return bytes(data)


BOMB = bomb()
REPLIES: Mapping[str, Callable[[Any], None]] = {
    "dies": lambda connection: connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nPK"),
    "hangs": lambda connection: connection.recv(1),
    "bomb": lambda connection: connection.sendall(
        f"HTTP/1.1 200 OK\r\nContent-Length: {len(BOMB)}\r\nConnection: close\r\n\r\n".encode() + BOMB
    ),
}
FAULTS = ("absent", *REPLIES, *LIES)


@contextmanager
def faulty(
    stand_ins: StandIns, folder: Path, fault: str, tasks: tuple[str, ...], others: tuple[str, ...] = ()
) -> Iterator[ModelSetup]:
    """A setup in which models of some tasks have a fault, and those of others answer."""
    with ExitStack() as stack:
        setup = stack.enter_context(configured(stand_ins, folder, *others)) if others else ModelSetup(folder)
        if fault in LIES:
            lying = replace(stand_ins, spoil={task: LIES[fault][task] for task in tasks})
            bad = stack.enter_context(configured(lying, folder)).sources
            source = bad[tasks[0]][0]
        elif fault == "absent":
            source = ModelSource(url="http://127.0.0.1:9", timeout_s=1)
        else:
            source = ModelSource(url=stack.enter_context(talking(REPLIES[fault]))[0], timeout_s=1)
        yield replace(setup, sources={**setup.sources, **dict.fromkeys(tasks, (source, "a test"))})


@pytest.mark.slow  # 90 s: 25 runs, most of whose stages are cached
def test_each_fault_at_each_stage_is_a_finding(capture: tuple[Path, StandIns], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http, "PAUSES_S", (0.0,))
    folder, stand_ins = capture
    for tasks, others in TOGETHER.items():
        for fault in FAULTS:
            with faulty(stand_ins, folder, fault, tasks, others) as setup:
                run = again(folder, setup=setup)
            failed = [finding for finding in run.findings if finding.code == "SF640"]
            stages = {STAGE[task] for task in tasks}
            assert len(failed) == len(stages), (fault, tasks, [finding.text() for finding in failed])
            assert all("\n" not in f.message and "run again when the model answers" in f.hint for f in failed)
            assert not {stage for stage, _ in ran(run)} & stages - {"mesh"}
            assert len(run.reconstruction.shapes) >= 2 and (folder / "out" / "capture.scene.yaml").is_file()
            assert not used(run) & set(tasks) - {"complete_depth"}, (fault, tasks)
    with configured(stand_ins, folder) as setup:
        whole = again(folder, setup=setup)
    assert not [finding for finding in whole.findings if finding.code == "SF640"]
    assert "read" in {stage for stage, _ in ran(whole)}, "the last that failed was asked again"
    assert set(SOLVED) - {"inpaint", "splat", "pose"} <= used(whole)


def used(run: CaptureRun) -> set[str]:
    """The tasks of the models that made the objects of a scene."""
    origins = [item.origin for item in run.reconstruction.spec.objects.values()]
    return {use.task for origin in origins if origin is not None for use in origin.models}
