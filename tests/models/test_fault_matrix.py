"""Every task over every transport with every fault: one sentence, nothing kept, and the next run succeeds.

Faults that are particular to one transport are in ``test_transports.py``, and those of contracts in ``test_tasks.py``.
"""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from scaffold import Result

from simfoundry.models import wire
from simfoundry.models.client import ModelClient, Transport
from simfoundry.models.contract import ModelError
from simfoundry.models.tasks.registry import TASKS
from simfoundry.models.transports import http, process
from simfoundry.models.transports.http import HttpTransport
from simfoundry.models.transports.process import ProcessTransport
from simfoundry.models.transports.recorded import RecordedTransport
from simfoundry.models.wire import BundleFile, BundleImage
from tests.models import truth
from tests.models.test_tasks import CALLS, Direct
from tests.models.test_transports import Reply, talking

pytestmark = pytest.mark.slow  # 288 cells, half a minute of processor time

FAULTS = ("dies", "hangs", "lies about shapes", "sends NaN", "a zip bomb", "a 2 GB mesh")
TRANSPORTS = ("http", "process", "recorded")

LIMIT_S = 0.3  # time limit of a model that hangs [s]

# Limits of sizes during these tests [bytes]; the answers of the truth take 50 kB.
MAX_BUNDLE, MAX_CONTENT = 2**20, 8 * 2**20


class _Kept(Direct):
    """A model that keeps its answer and the digest of the request."""

    def exchange(self, task: str, digest: str, data: bytes) -> bytes:
        self.digest, self.answer = digest, super().exchange(task, digest, data)
        return self.answer


def _asked(task: str, change: Callable[[Result], None] | None = None) -> tuple[bytes, str]:
    """Return the answer for a task, spoiled by a change, and the digest of its request."""
    model = _Kept(truth.TRUTH if change is None else truth.broken(task, change))
    try:
        CALLS[task](ModelClient(model))
    except ModelError:
        assert change is not None
    return model.answer, model.digest


def _reshaped(result: Result) -> None:
    """Lie about the shape of the first member that has one, or about the structure of the values."""
    for name, content in result.members.items():
        if isinstance(content, np.ndarray):
            result.members[name] = content[None]
        elif isinstance(content, BundleImage):
            is_any_size = content.pixels.shape[2] == 4  # an edited image may have another size, but must have alpha
            result.members[name] = BundleImage(content.pixels[..., :3] if is_any_size else content.pixels[:-1])
        elif isinstance(content, BundleFile):
            result.members[name] = BundleFile(content.kind, content.data[:-40])
        else:
            result.members[name] = content[:-1]
        return
    assert result.values is not None
    result.values = {name: {"0": found} for name, found in result.values.items()}


def _unknown(result: Result) -> None:
    """Put NaN into every array of floating-point numbers, and into the first vertex of meshes and splats."""
    for name, content in result.members.items():
        if isinstance(content, np.ndarray) and content.dtype.kind == "f":
            spoiled = content.copy()
            spoiled.reshape(-1)[0] = np.nan
            result.members[name] = spoiled
        elif isinstance(content, BundleFile):
            start = b"BIN\x00" if content.kind == "glb" else b"end_header\n"
            head, mark, rest = content.data.partition(start)
            result.members[name] = BundleFile(content.kind, head + mark + np.float32(np.nan).tobytes() + rest[4:])


def _rewritten(answer: bytes, extra: dict[str, bytes], head: Callable[[bytes], bytes] = lambda data: data) -> bytes:
    """Return an answer with another JSON document and further files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(answer)) as old, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, head(data) if name == wire.ANSWER else data)
        for name, data in extra.items():
            new.writestr(name, data)
    return stream.getvalue()


def _with_nan(task: str) -> bytes:
    """Return an answer with NaN in its arrays, or in its JSON document where it has no floating-point numbers."""
    has_floats = any(
        m.kind in ("glb", "ply") or (m.kind, m.dtype[:5]) == ("array", "float") for m in TASKS[task].outputs
    )
    if has_floats:
        return _asked(task, _unknown)[0]
    return _rewritten(_asked(task)[0], {}, lambda data: data.replace(b"{", b'{"confidence": NaN, ', 1))


def _bytes_of(fault: str, task: str) -> bytes:
    answer = _asked(task)[0]
    if fault == "dies":
        return answer[: len(answer) // 2]
    if fault == "lies about shapes":
        return _asked(task, _reshaped)[0]
    if fault == "sends NaN":
        return _with_nan(task)
    return _rewritten(answer, {"bomb.npy": bytes(3 * MAX_CONTENT)})


def _reply(fault: str, data: bytes) -> Reply:
    if fault == "hangs":
        return lambda connection: connection.recv(1)  # type: ignore[return-value]
    length = 2**31 if fault == "a 2 GB mesh" else len(data) * (2 if fault == "dies" else 1)
    return lambda connection: connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % length + data)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def _transport(kind: str, fault: str, task: str, folder: Path, stack: ExitStack) -> Transport:
    data = b"" if fault in ("hangs", "a 2 GB mesh") else _bytes_of(fault, task)
    if kind == "http":
        url, _ = stack.enter_context(talking(_reply(fault, data)))
        return HttpTransport(url, timeout_s=LIMIT_S if fault == "hangs" else 5.0)
    folder.mkdir()
    file = folder / f"{_asked(task)[1]}.zip"
    if kind == "recorded" and fault == "hangs":
        os.mkfifo(file)  # reading it would wait for a writer
        return RecordedTransport(folder)
    file.write_bytes(data)
    if fault == "a 2 GB mesh":
        os.truncate(file, 2**31)  # without content, so that it takes no space
    if kind == "recorded":
        return RecordedTransport(folder)
    command = {"hangs": "sleep 60", "dies": f"cat {file}; kill -9 $$"}.get(fault, f"cat {file}")
    return ProcessTransport(("sh", "-c", command), timeout_s=LIMIT_S if fault == "hangs" else 5.0)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", TRANSPORTS)
@pytest.mark.parametrize("task", TASKS)
def test_a_faulty_model_is_reported_in_one_sentence_and_can_be_asked_again(
    task: str, kind: str, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stack: ExitStack
) -> None:
    monkeypatch.setattr(http, "PAUSES_S", ())
    monkeypatch.setattr(http.request_bytes, "__defaults__", (5.0, MAX_BUNDLE))
    monkeypatch.setattr(process, "MAX_BUNDLE_BYTES", MAX_BUNDLE)
    monkeypatch.setattr(wire.read_bundle, "__defaults__", (MAX_CONTENT,))
    transport = _transport(kind, fault, task, tmp_path / "answers", stack)
    kept = tmp_path / "kept"
    with pytest.raises(ModelError) as error:
        CALLS[task](ModelClient(transport, record=kept))
    text = str(error.value)
    assert "\n" not in text and "Traceback" not in text and len(text) < 500
    assert f"`{task}`" in text or "127.0.0.1" in text or "sh -c" in text or str(tmp_path) in text, text
    assert not kept.exists() or not list(kept.iterdir())
    again = CALLS[task](ModelClient(Direct(truth.TRUTH), record=kept))
    assert again.made_by.name == "truth" and len(list(kept.iterdir())) == 1
