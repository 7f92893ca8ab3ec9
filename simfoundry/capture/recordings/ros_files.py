"""Messages in ROS bags: ROS 1 `.bag`, ROS 2 `.mcap`, and folders of ROS 2 with `metadata.yaml`."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from simfoundry.capture.recordings.recording import RecordingError
from simfoundry.runtime.extras import install_line


@dataclass(frozen=True, eq=False)
class RosMessage:
    """A message in a bag.

    Attributes:
        topic: Its topic.
        time_ns: Time at which it was recorded [ns].
        stamp_ns: Time in its header [ns], for messages that start with one.
        decode: Returns the message as an object with the fields of its type.
    """

    topic: str
    time_ns: int
    stamp_ns: int
    decode: Callable[[], Any]


class RosBag(Protocol):
    """An opened bag."""

    @property
    def types(self) -> Mapping[str, str]:
        """Type of each topic, such as ``sensor_msgs/msg/Image``."""
        ...

    def messages(self, topics: Collection[str]) -> Iterator[RosMessage]:
        """Yield the messages of some topics in the order in which they were recorded."""
        ...


@contextmanager
def open_bag(path: Path) -> Iterator[RosBag]:
    """Open a bag.

    Raises:
        RecordingError: It cannot be read, or the package that reads it is not installed. This also applies to errors
            within the block.
    """
    opened = _open_mcap if path.suffix.lower() == ".mcap" else _open_rosbags
    with ExitStack() as stack:
        try:
            yield stack.enter_context(opened(path))
        except ImportError as error:
            name = f"`{error.name}`" if error.name else "a package"
            message = f"{path} needs {name}, which is not installed; run `{install_line('sensors')}`"
            raise RecordingError(message) from None
        except RecordingError:
            raise
        except Exception as error:  # the readers raise what their decoders raise
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise RecordingError(f"{path} cannot be read as a ROS bag: {reason}") from None


class _McapBag:
    """A bag in the format MCAP."""

    def __init__(self, stream: Any, path: Path) -> None:
        from mcap.reader import SeekingReader
        from mcap_ros2.decoder import DecoderFactory

        self._reader = SeekingReader(stream, record_size_limit=CHUNK_MAX)
        self._decoders = DecoderFactory()
        summary = self._reader.get_summary()
        if summary is None or not summary.channels:
            raise RecordingError(f"{path} has no index, as after an interrupted recording; run `mcap recover` on it")
        channels = summary.channels.values()
        schemas = {key: schema.name for key, schema in summary.schemas.items()}
        if not any(channel.message_encoding == "cdr" for channel in channels):
            found = ", ".join(sorted({channel.message_encoding for channel in channels}))
            raise RecordingError(f"{path} contains messages of the encoding {found}; those of ROS 2 (cdr) can be read")
        self._types = {c.topic: schemas.get(c.schema_id, "") for c in channels if c.message_encoding == "cdr"}

    @property
    def types(self) -> Mapping[str, str]:
        return self._types

    def messages(self, topics: Collection[str]) -> Iterator[RosMessage]:
        for schema, channel, message in self._reader.iter_messages(topics=list(topics)):
            decoder = self._decoders.decoder_for(channel.message_encoding, schema)
            if decoder is None:
                continue
            decode = partial(decoder, message.data)
            yield RosMessage(channel.topic, message.log_time, _cdr_stamp(message.data), decode)


# Maximum size of a record in an MCAP file [bytes]. Its chunks have 1 MB by default, or one message if that is larger.
CHUNK_MAX = 1_000_000_000


@contextmanager
def _open_mcap(path: Path) -> Iterator[RosBag]:
    with path.open("rb") as stream:
        yield _McapBag(stream, path)


class _AnyBag:
    """A bag that the package rosbags reads."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader
        self._has_cdr = bool(reader.is2)
        self._types: dict[str, str] = {c.topic: str(c.msgtype) for c in reader.connections}

    @property
    def types(self) -> Mapping[str, str]:
        return self._types

    def messages(self, topics: Collection[str]) -> Iterator[RosMessage]:
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        for connection, time_ns, raw in self._reader.messages(connections=connections):
            data = bytes(raw)
            stamp = _cdr_stamp(data) if self._has_cdr else _ros1_stamp(data)
            decode = partial(self._reader.deserialize, data, connection.msgtype)
            yield RosMessage(connection.topic, time_ns, stamp, decode)


@contextmanager
def _open_rosbags(path: Path) -> Iterator[RosBag]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    folder = path.parent if path.suffix.lower() == ".db3" else path
    if folder.is_dir() and not (folder / "metadata.yaml").is_file():
        raise RecordingError(f"{path} has no metadata.yaml beside it; run `ros2 bag reindex {folder}`")
    with AnyReader([folder], default_typestore=get_typestore(Stores.LATEST)) as reader:
        yield _AnyBag(reader)


def _cdr_stamp(data: bytes) -> int:
    """Return the time [ns] at the start of a message of ROS 2. The second of four bytes before it is the byte order."""
    if len(data) < 12:
        return 0
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _ros1_stamp(data: bytes) -> int:
    """Return the time [ns] at the start of a message of ROS 1, after its sequence number."""
    if len(data) < 12:
        return 0
    seconds, nanoseconds = struct.unpack_from("<II", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
