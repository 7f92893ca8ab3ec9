"""Read and write ``bundle/1``, the ZIP files that requests to models and their answers travel in.

A bundle contains ``request.json`` or ``answer.json``, which names all other members: images (``.png``), arrays
(``.npy``), meshes (``.glb``), point clouds and splats (``.ply``) and videos (``.mp4``). Nothing is unpickled, extracted
to a disk, or larger than a limit that is checked before anything is allocated.

This module needs only numpy, Pillow and Python 3.9, and nothing else of SimFoundry: model servers run in environments
of their own, with a copy of this file.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Union

import numpy as np

VERSION = 1

REQUEST, ANSWER = "request.json", "answer.json"

# Limits on one bundle. 100 frames of 4K take about 1 GiB, and no usable mesh is larger than 256 MiB.
MAX_BUNDLE_BYTES = 256 * 2**20  # as transferred
MAX_CONTENT_BYTES = 2**30  # after decompression, all members together
MAX_JSON_BYTES = 4 * 2**20  # joints of a cabinet take 10 kB
MAX_MEMBERS = 1024  # frames of a video, as images
MAX_PIXELS = 8192**2  # of one image
MAX_HEADER_BYTES = 4096  # of an array; numpy writes 118

# Names without folders, so that no member can be written outside of a folder.
FILE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}\.(?:json|png|npy|glb|ply|mp4)")

MEMBER_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")

DTYPES = ("bool", "uint8", "uint16", "int32", "int64", "float32", "float64")

# First bytes of the files that are passed on as they are.
MAGIC = {"glb": (b"glTF",), "ply": (b"ply\n", b"ply\r"), "mp4": ()}

PNG = b"\x89PNG\r\n\x1a\n"

# Earliest date that a ZIP file can state; equal bundles thus have equal bytes.
DATE = (1980, 1, 1, 0, 0, 0)


class BundleError(ValueError):
    """Raised for a bundle that cannot be read or written. The message continues a sentence about the bundle."""


@dataclass(frozen=True, eq=False)
class BundleImage:
    """An image: uint8 of shape (H, W, 3) or (H, W, 4), or ids as uint16 of shape (H, W)."""

    pixels: np.ndarray


@dataclass(frozen=True)
class BundleFile:
    """A file that is passed on as it is. ``kind`` is ``glb``, ``ply`` or ``mp4``."""

    kind: str
    data: bytes


Content = Union[np.ndarray, BundleImage, tuple[BundleImage, ...], BundleFile]  # noqa: UP007


@dataclass(frozen=True, eq=False)
class Bundle:
    """A request or an answer.

    Attributes:
        head: Content of the JSON document, without ``members``.
        members: Arrays, images and files by name.
        notes: What the sender states of members: ``unit`` and ``frame`` by name of the member.
    """

    head: Mapping[str, Any]
    members: Mapping[str, Content] = field(default_factory=dict)
    notes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """The SHA-256 digest of the content, which does not depend on how it was compressed."""
        content = {name: _fingerprint(member) for name, member in sorted(self.members.items())}
        plain = {"head": self.head, "members": content}
        text = json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


def _fingerprint(content: Content) -> Any:
    if isinstance(content, tuple):
        return [_fingerprint(one) for one in content]
    if isinstance(content, BundleFile):
        return [content.kind, hashlib.sha256(content.data).hexdigest()]
    array = np.ascontiguousarray(content.pixels if isinstance(content, BundleImage) else content)
    kind = "png" if isinstance(content, BundleImage) else "npy"
    return [kind, array.dtype.name, list(array.shape), hashlib.sha256(array.tobytes()).hexdigest()]


def write_bundle(bundle: Bundle, name: str) -> bytes:
    """Return a bundle as a ZIP file. ``name`` is :data:`REQUEST` or :data:`ANSWER`.

    Raises:
        BundleError: If a member cannot be represented.
    """
    files: dict[str, bytes] = {}
    listed: dict[str, Any] = {}
    for key, content in bundle.members.items():
        if not MEMBER_NAME.fullmatch(key):
            raise BundleError(f"cannot contain a member named `{key}`")
        many = content if isinstance(content, tuple) else None
        parts = many if many is not None else (content,)
        names = [f"{key}_{k:04d}" for k in range(len(parts))] if many is not None else [key]
        paths = [f"{one}.{_suffix(part)}" for one, part in zip(names, parts)]  # noqa: B905
        files.update(zip(paths, map(_encoded, parts)))  # noqa: B905
        listed[key] = {"files": paths} if many is not None else {"file": paths[0]}
        listed[key].update(bundle.notes.get(key, {}))
    try:
        text = json.dumps({**bundle.head, "members": listed}, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BundleError(f"cannot be written as JSON: {error}") from None
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for path, data in {name: text.encode(), **files}.items():
            info = zipfile.ZipInfo(path, DATE)
            # Images and videos are compressed already.
            info.compress_type = zipfile.ZIP_STORED if path.endswith((".png", ".mp4")) else zipfile.ZIP_DEFLATED
            archive.writestr(info, data)
    return stream.getvalue()


def _suffix(content: Content) -> str:
    if isinstance(content, BundleFile):
        return content.kind
    return "png" if isinstance(content, BundleImage) else "npy"


def _encoded(content: Content) -> bytes:
    if isinstance(content, BundleFile):
        return content.data
    stream = io.BytesIO()
    if isinstance(content, BundleImage):
        from PIL import Image

        pixels = np.ascontiguousarray(content.pixels)
        is_ids = pixels.dtype == np.uint16 and pixels.ndim == 2
        if not is_ids and (pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4)):
            raise BundleError(f"cannot contain an image of {pixels.dtype} with the shape {pixels.shape}")
        Image.fromarray(pixels).save(stream, format="PNG", compress_level=1)
        return stream.getvalue()
    if not isinstance(content, np.ndarray) or content.dtype.name not in DTYPES:
        kind = getattr(getattr(content, "dtype", None), "name", type(content).__name__)
        raise BundleError(f"cannot contain an array of {kind}; convert it to one of {', '.join(DTYPES)}")
    np.save(stream, np.ascontiguousarray(content), allow_pickle=False)
    return stream.getvalue()


def read_bundle(data: bytes, name: str, max_bytes: int = MAX_CONTENT_BYTES) -> Bundle:
    """Read a bundle from a source that is not trusted.

    Args:
        data: The ZIP file.
        name: :data:`REQUEST` or :data:`ANSWER`.
        max_bytes: Maximum size of all members after decompression [bytes].

    Raises:
        BundleError: If the bundle is damaged, too large, or contains anything that a bundle may not contain.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            files = _files(archive, name, max_bytes)
    except BundleError:
        raise
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RuntimeError, ValueError) as error:
        raise BundleError(f"is not a valid ZIP file ({error})") from None
    head = read_json(files.pop(name), name)
    if head.get("bundle") != VERSION or isinstance(head.get("bundle"), bool):
        raise BundleError(f"is of version {str(head.get('bundle'))[:20]!r}; only `bundle: {VERSION}` can be read")
    members, notes = _members(head.pop("members", {}), files)
    return Bundle(head, members, notes)


def _files(archive: zipfile.ZipFile, name: str, max_bytes: int) -> dict[str, bytes]:
    """Return the files of an archive, after checking their number, names and sizes."""
    listed = archive.infolist()
    if len(listed) > MAX_MEMBERS:
        raise BundleError(f"has {len(listed)} members; at most {MAX_MEMBERS} are allowed")
    names = [info.filename for info in listed]
    for path in names:
        if not FILE_NAME.fullmatch(path):
            raise BundleError(
                f"has a member named {path[:80]!r}; names such as `depth.npy` are allowed, without folders"
            )
    if len(set(names)) < len(names):
        raise BundleError("has several members with the same name")
    if name not in names:
        raise BundleError(f"has no {name}")
    total = sum(info.file_size for info in listed)
    if total > max_bytes:
        raise BundleError(f"has {total / 2**20:.0f} MiB of content; at most {max_bytes / 2**20:.0f} MiB are allowed")
    for info in listed:
        if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise BundleError(f"has an encrypted or unusually compressed member, {info.filename}")
        if info.filename.endswith(".json") and info.file_size > MAX_JSON_BYTES:
            raise BundleError(f"has a {info.filename} of more than {MAX_JSON_BYTES // 2**20} MiB")
    # `ZipFile.read` returns at most `file_size` bytes of a member, whatever its compressed data contain.
    return {info.filename: archive.read(info) for info in listed}


def read_json(data: bytes, name: str) -> dict[str, Any]:
    """Return a JSON object. NaN, infinity, repeated keys and values other than objects are errors."""

    def refuse(constant: str) -> Any:
        raise BundleError(f"has the number {constant} in {name}; all numbers must be finite")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if len(set(keys)) < len(keys):
            raise BundleError(f"has a repeated key in {name}")
        return dict(pairs)

    def finite(text: str) -> float:
        value = float(text)
        return value if math.isfinite(value) else refuse(text[:20])

    try:
        head = json.loads(data, parse_constant=refuse, parse_float=finite, object_pairs_hook=unique)
    except BundleError:
        raise
    except (ValueError, RecursionError) as error:
        raise BundleError(f"has a damaged {name} ({str(error)[:80]})") from None
    if not isinstance(head, dict):
        raise BundleError(f"has a {name} that is not a JSON object")
    return head


def _members(listed: Any, files: dict[str, bytes]) -> tuple[dict[str, Content], dict[str, dict[str, str]]]:
    """Decode the members that the JSON document lists. Each file belongs to exactly one of them."""
    if not isinstance(listed, dict):
        raise BundleError("lists its `members` in something that is not a JSON object")
    members: dict[str, Content] = {}
    notes: dict[str, dict[str, str]] = {}
    for key, entry in listed.items():
        if not MEMBER_NAME.fullmatch(key) or not isinstance(entry, dict):
            raise BundleError(f"lists a member {key[:60]!r} that is not described by a JSON object with a plain name")
        paths = entry.get("files", [entry.get("file")])
        if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
            raise BundleError(f"lists no file for the member `{key}`")
        missing = next((path for path in paths if path not in files), None)
        if missing is not None:
            raise BundleError(f"does not contain the file {missing[:80]!r} of the member `{key}`")
        parts = [_decoded(path, files.pop(path)) for path in paths]
        if "files" in entry:
            if not all(isinstance(part, BundleImage) for part in parts):
                raise BundleError(f"lists files that are not images for the member `{key}`")
            members[key] = tuple(part for part in parts if isinstance(part, BundleImage))
        else:
            members[key] = parts[0]
        notes[key] = {note: str(entry[note])[:80] for note in ("unit", "frame") if note in entry}
    if files:
        raise BundleError(f"contains the file {sorted(files)[0]}, which its JSON document does not list")
    return members, notes


def _decoded(path: str, data: bytes) -> Content:
    kind = path.rpartition(".")[2]
    if kind == "npy":
        return _read_array(path, data)
    if kind == "png":
        return BundleImage(_read_png(path, data))
    if kind not in MAGIC or not (data.startswith(MAGIC[kind]) if MAGIC[kind] else data[4:8] == b"ftyp"):
        raise BundleError(f"has a {path} that is not a file of this kind")
    return BundleFile(kind, data)


def _read_array(path: str, data: bytes) -> np.ndarray:
    """Read an array whose header states exactly the bytes that follow. Non-finite numbers are errors."""
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        width = 2 if version == (1, 0) else 4
        length = int.from_bytes(data[8 : 8 + width], "little")
        if version not in ((1, 0), (2, 0)) or length > MAX_HEADER_BYTES:
            raise BundleError(f"has a {path} with an unusual header")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, is_fortran, dtype = read(stream)
    except BundleError:
        raise
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError, EOFError) as error:
        raise BundleError(f"has a {path} that is not an array ({str(error)[:80]})") from None
    if dtype.names is not None or dtype.name not in DTYPES or not dtype.isnative:
        raise BundleError(f"has a {path} of {str(dtype)[:40]}; an array must be one of {', '.join(DTYPES)}")
    content = data[stream.tell() :]
    fits = len(shape) <= 5 and all(0 <= size < 2**31 for size in shape)
    if not fits or math.prod(shape) * dtype.itemsize != len(content):
        raise BundleError(
            f"has a {path} whose header states the shape {str(shape)[:60]}, but {len(content)} bytes follow"
        )
    flat = np.frombuffer(content, dtype) if content else np.zeros(0, dtype)
    array = flat.reshape(shape, order="F" if is_fortran else "C")
    if dtype == np.bool_ and len(content) and np.frombuffer(content, np.uint8).max() > 1:
        raise BundleError(f"has a {path} of bool with other values than 0 and 1")
    if dtype.kind == "f" and not np.isfinite(array).all():
        bad = int(array.size - np.isfinite(array).sum())
        raise BundleError(f"has a {path} with {bad} of {array.size} numbers that are not finite; unknown values are 0")
    return array


def _read_png(path: str, data: bytes) -> np.ndarray:
    """Decode a PNG with 8 bits per channel (RGB or RGBA), or with 16 bits and one channel (ids)."""
    from PIL import Image

    if not data.startswith(PNG) or data[12:16] != b"IHDR" or len(data) < 33:
        raise BundleError(f"has a {path} that is not a PNG image")
    width, height, bits, color = struct.unpack(">IIBB", data[16:26])
    if not (width and height) or width * height > MAX_PIXELS:
        raise BundleError(
            f"has a {path} of {width} x {height} pixels; at most {MAX_PIXELS // 10**6} megapixels are allowed"
        )
    if (bits, color) not in ((8, 2), (8, 6), (16, 0)):
        raise BundleError(f"has a {path} that is neither RGB or RGBA with 8 bits nor gray with 16 bits per channel")
    try:
        with Image.open(io.BytesIO(data)) as image:
            pixels = np.array(image)
    except Exception as error:  # Pillow's parsers raise many kinds
        raise BundleError(f"has a {path} that cannot be decoded ({str(error)[:80]})") from None
    return pixels.astype(np.uint16 if bits == 16 else np.uint8)
