"""Bundles as they are written, and bundles from sources that are not trusted."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.models import wire
from simfoundry.models.wire import (
    ANSWER,
    REQUEST,
    Bundle,
    BundleError,
    BundleFile,
    BundleImage,
    read_bundle,
    write_bundle,
)
from tests.models.truth import png

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)
FULL = Bundle(
    {"bundle": 1, "task": "x", "parameters": {"a": [1, 2.5, "é"]}, "seed": 3},
    {
        "depth": RNG.random((5, 7)).astype(np.float32),
        "K": np.asfortranarray(RNG.random((3, 3))),
        "mask": RNG.random((2, 5, 7)) > 0.5,
        "none": np.zeros((0, 4), np.int32),
        "image": BundleImage(IMAGE),
        "cut": BundleImage(np.dstack([IMAGE, IMAGE[..., 0]])),
        "ids": BundleImage(RNG.integers(0, 65536, (5, 7), dtype=np.uint16)),
        "frames": (BundleImage(IMAGE), BundleImage(IMAGE[::-1])),
        "mesh": BundleFile("glb", b"glTF\x02\x00\x00\x00rest"),
        "cloud": BundleFile("ply", b"ply\nrest"),
        "film": BundleFile("mp4", b"\x00\x00\x00\x18ftypisom"),
    },
    {"depth": {"unit": "m", "frame": "camera_opencv"}},
)


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, BundleImage):
        return _same(a.pixels, b.pixels)
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and a.shape == b.shape and (a == b).all())
    return bool(a == b)


def test_what_is_written_is_read() -> None:
    data = write_bundle(FULL, REQUEST)
    again = read_bundle(data, REQUEST)
    assert dict(again.head) == FULL.head and again.members.keys() == FULL.members.keys()
    assert all(_same(FULL.members[name], again.members[name]) for name in FULL.members)
    assert again.notes["depth"] == {"unit": "m", "frame": "camera_opencv"} and again.notes["K"] == {}
    assert again.digest == FULL.digest and write_bundle(FULL, REQUEST) == data


def test_the_digest_is_that_of_the_content_and_of_all_of_it() -> None:
    changes: list[Mapping[str, Any]] = [
        {"depth": np.nextafter(np.asarray(FULL.members["depth"]), np.float32(2))},
        {"mask": np.asarray(FULL.members["mask"]).astype(np.uint8)},
        {"K": np.ascontiguousarray(np.asarray(FULL.members["K"]).T)},
        {"frames": (BundleImage(IMAGE[::-1]), BundleImage(IMAGE))},
        {"mesh": BundleFile("ply", b"glTF\x02\x00\x00\x00rest")},
        {"image": IMAGE},
    ]
    digests = {Bundle(FULL.head, {**FULL.members, **change}).digest for change in changes}
    digests |= {Bundle({**FULL.head, "seed": 4}, FULL.members).digest, FULL.digest}
    assert len(digests) == len(changes) + 2
    # The digest names recorded answers, so it must never change.
    plain = Bundle(
        {"bundle": 1, "task": "depth", "parameters": {}, "seed": 0},
        {"image": BundleImage(np.zeros((2, 3, 3), np.uint8))},
    )
    assert plain.digest == "870e37fd142cd1cf994599220be76cdb42371f1069630c5bf77eabc086abbe1e"


def archive(files: Mapping[str, bytes], head: Any = None, compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Return a ZIP file whose answer.json lists its files by their stem."""
    members = {name.partition(".")[0]: {"file": name} for name in files}
    text = head if isinstance(head, bytes) else json.dumps({"bundle": 1, "members": members, **(head or {})}).encode()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as written:
        for name, data in {ANSWER: text, **files}.items():
            written.writestr(name, data)
    return stream.getvalue()


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def header(text: str, content: bytes = b"") -> bytes:
    """Return an array file with the given header."""
    padded = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded + content


def _raw_names(*names: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as written, warnings.catch_warnings(action="ignore"):
        for name in names:
            written.writestr(zipfile.ZipInfo(name), b"{}")
    return stream.getvalue()


def _bomb() -> bytes:
    return archive({"a.npy": npy(np.zeros(3 * 2**20))})


def _lying_size() -> bytes:
    """Return an archive whose member is larger than its directory states."""
    data = bytearray(archive({"a.npy": npy(np.zeros(1000))}))
    at = data.rindex(b"PK\x01\x02")
    data[at + 24 : at + 28] = struct.pack("<I", 100)
    return bytes(data)


HUGE = header("{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776, 1099511627776), }")
HOSTILE: dict[str, tuple[Callable[[], bytes], str]] = {
    "empty": (lambda: b"", "not a valid ZIP"),
    "html": (lambda: b"<html>502</html>", "not a valid ZIP"),
    "cut off": (lambda: write_bundle(FULL, ANSWER)[:-40], "not a valid ZIP"),
    "a request": (lambda: write_bundle(FULL, REQUEST), "has no answer.json"),
    "a path outside": (lambda: _raw_names("../answer.json"), "without folders"),
    "an absolute path": (lambda: _raw_names("answer.json", "/etc/x.npy"), "without folders"),
    "a folder": (lambda: _raw_names("answer.json", "a/b.npy"), "without folders"),
    "a backslash": (lambda: _raw_names("answer.json", "a\\b.npy"), "without folders"),
    "a pickle": (lambda: archive({"a.pkl": b"x"}), "without folders"),
    "twice": (lambda: _raw_names("answer.json", "answer.json"), "same name"),
    "many": (lambda: _raw_names(*(f"a{k}.npy" for k in range(1025)), "answer.json"), "1026 members"),
    "a bomb": (_bomb, "24 MiB of content"),
    "a lying size": (_lying_size, "not a valid ZIP|shape|array"),
    "bzip2": (lambda: archive({"a.npy": npy(np.zeros(9))}, compression=zipfile.ZIP_BZIP2), "unusually compressed"),
    "another version": (lambda: archive({}, {"bundle": 2}), "version '2'"),
    "a true version": (lambda: archive({}, {"bundle": True}), "version 'True'"),
    "a list": (lambda: archive({}, b"[1]"), "not a JSON object"),
    "NaN in JSON": (lambda: archive({}, b'{"bundle": 1, "seconds": NaN}'), "NaN"),
    "infinity in JSON": (lambda: archive({}, b'{"bundle": 1, "seconds": 1e999}'), "1e999"),
    "repeated keys": (lambda: archive({}, b'{"bundle": 1, "bundle": 1}'), "repeated key"),
    "deep JSON": (
        lambda: archive({}, b'{"bundle": 1, "x": ' + b"[" * 10**5 + b"]" * 10**5 + b"}"), "damaged answer.json"),
    "a long number": (lambda: archive({}, b'{"bundle": ' + b"9" * 5000 + b"}"), "damaged answer.json"),
    "bytes in JSON": (lambda: archive({}, b"\xff\xfe"), "damaged answer.json"),
    "unlisted": (lambda: archive({"a.npy": npy(IMAGE)}, {"members": {}}), "a.npy, which its JSON"),
    "missing": (lambda: archive({}, {"members": {"a": {"file": "a.npy"}}}), "does not contain the file 'a.npy'"),
    "shared": (
        lambda: archive({"a.npy": npy(IMAGE)}, {"members": {"a": {"file": "a.npy"}, "b": {"file": "a.npy"}}}),
        "does not contain the file 'a.npy' of the member `b`",
    ),
    "members as a list": (lambda: archive({}, {"members": []}), "not a JSON object"),
    "a file number": (lambda: archive({}, {"members": {"a": {"file": 3}}}), "no file for the member"),
    "a strange member": (lambda: archive({}, {"members": {"../a": {"file": "a.npy"}}}), "plain name"),
    "files of arrays": (
        lambda: archive({"a.npy": npy(IMAGE)}, {"members": {"a": {"files": ["a.npy"]}}}), "not images"),
    "objects": (lambda: archive({"a.npy": npy(np.array([{}], dtype=object))}), "of object"),
    "strings": (lambda: archive({"a.npy": npy(np.array(["a"]))}), "an array must be one of"),
    "complex": (lambda: archive({"a.npy": npy(np.ones(2, complex))}), "complex128"),
    "records": (lambda: archive({"a.npy": npy(np.zeros(2, [("x", "f4")]))}), "must be one of"),
    "other byte order": (lambda: archive({"a.npy": npy(np.ones(3, ">f4"))}), ">f4"),
    "NaN": (lambda: archive({"a.npy": npy(np.array([1, np.nan, np.inf]))}), "2 of 3 numbers that are not finite"),
    "a huge shape": (lambda: archive({"a.npy": HUGE}), "but 0 bytes follow"),
    "a negative shape": (
        lambda: archive({"a.npy": header("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, -1), }", b"0000")}),
        "states the shape|not an array"),
    "six axes": (lambda: archive({"a.npy": npy(np.zeros((1,) * 6))}), "states the shape"),
    "code in a header": (lambda: archive({"a.npy": header("__import__('os').system('true')")}), "not an array"),
    "a long header": (
        lambda: archive({"a.npy": b"\x93NUMPY\x02\x00" + struct.pack("<I", 10**6) + b" " * 10**6}), "unusual header"),
    "trailing bytes": (lambda: archive({"a.npy": npy(IMAGE) + b"x"}), "bytes follow"),
    "bools of 2": (
        lambda: archive({"a.npy": npy(np.array([True, True]))[:-2] + b"\x02\x01"}), "other values than 0 and 1"),
    "no PNG": (lambda: archive({"a.png": b"GIF89a"}), "not a PNG"),
    "a large PNG": (
        lambda: archive({"a.png": wire.PNG + b"\0\0\0\x0dIHDR" + struct.pack(">IIBB", 65000, 65000, 8, 2) + b"0" * 9}),
        "65000 x 65000 pixels"),
    "a damaged PNG": (lambda: archive({"a.png": png(IMAGE)[:40]}), "cannot be decoded"),
    "a palette": (lambda: archive({"a.png": png(IMAGE[..., 0])}), "neither RGB or RGBA"),
    "no GLB": (lambda: archive({"a.glb": b"solid cube"}), "not a file of this kind"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_bundle_is_refused_in_one_sentence(name: str) -> None:
    make, said = HOSTILE[name]
    with pytest.raises(BundleError, match=said) as error:
        read_bundle(make(), ANSWER, max_bytes=8 * 2**20)
    assert "\n" not in str(error.value) and len(str(error.value)) < 300


def test_damage_anywhere_is_refused_or_harmless() -> None:
    data = write_bundle(FULL, ANSWER)
    rng = np.random.default_rng(1)
    for _ in range(300):
        spoiled = bytearray(data)
        for at in rng.integers(0, len(data), 3):
            spoiled[at] = rng.integers(0, 256)
        try:
            read = read_bundle(bytes(spoiled), ANSWER)
        except BundleError:
            continue
        assert len(read.members) <= len(FULL.members)


def test_what_cannot_be_sent_is_said() -> None:
    head = {"bundle": 1}
    with pytest.raises(BundleError, match="array of object"):
        write_bundle(Bundle(head, {"a": np.array([{}], dtype=object)}), REQUEST)
    with pytest.raises(BundleError, match=r"image of float64 with the shape \(2, 2, 3\)"):
        write_bundle(Bundle(head, {"a": BundleImage(np.zeros((2, 2, 3)))}), REQUEST)
    with pytest.raises(BundleError, match="named `a b`"):
        write_bundle(Bundle(head, {"a b": IMAGE}), REQUEST)
    with pytest.raises(BundleError, match="as JSON"):
        write_bundle(Bundle({"bundle": 1, "x": float("nan")}), REQUEST)


def test_the_module_runs_without_the_rest_of_the_package(tmp_path: Path) -> None:
    """A server has a copy of the file in an environment without SimFoundry."""
    (tmp_path / "wire.py").write_bytes(Path(wire.__file__).read_bytes())
    (tmp_path / "answer.zip").write_bytes(write_bundle(FULL, ANSWER))
    code = (
        "import sys, wire; b = wire.read_bundle(open('answer.zip', 'rb').read(), wire.ANSWER); print(b.digest);"
        "assert not any(m.startswith('simfoundry') for m in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == FULL.digest
