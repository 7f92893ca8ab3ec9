"""MP4 files of an episode's images: encode, join without encoding again, decode.

H.264 in yuv420p is what every reader of LeRobot datasets decodes. The frame rate is exact, and every second frame is a
key frame, so that readers find a single frame by its time without decoding many others. Equal images give equal bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import OutputError, SimfoundryError

# One key frame in two, as LeRobot encodes; no B-frames, so that frames are stored in the order of their times.
# Quality 18 is the usual bound of visible loss in H.264; `veryfast` is within 0.1 dB of `medium` on our images.
_ENCODER = {"crf": "18", "preset": "veryfast", "g": "2", "bf": "0"}

# No date and no version of the muxer in the file; the index comes first, so that browsers play without seeking.
_CONTAINER = {"fflags": "+bitexact", "movflags": "+faststart"}

# BT.601 in limited range, which decoders assume for small videos. It is also written to the file, because some decoders
# assume BT.709 for large ones. The numbers are those of ITU-T H.273.
_LIMITED_RANGE, _BT601 = 1, 6

# Largest denominator of a frame rate: 1001 expresses the rates of television, and tenths and hundredths of a hertz.
_MAX_DENOMINATOR = 1001


def exact_rate(hz: float) -> Fraction:
    """Return a rate in Hz as a fraction, such as 15 or 15/2."""
    return Fraction(hz).limit_denominator(_MAX_DENOMINATOR)


class VideoWriter:
    """A video that is written image by image. Use it as a context manager; the file is complete when the block ends."""

    def __init__(self, path: Path, hz: float) -> None:
        import av

        rate = exact_rate(hz)
        self._container = av.open(str(path), "w", format="mp4", options=_container_options(rate))
        self._stream = self._container.add_stream("libx264", rate=rate, options=_ENCODER)
        self._stream.pix_fmt, self._stream.time_base = "yuv420p", 1 / rate
        context = self._stream.codec_context
        context.thread_count = 1  # the bytes depend on the number of threads
        context.color_range, context.colorspace = _LIMITED_RANGE, _BT601
        context.color_primaries, context.color_trc = _BT601, _BT601
        self.count = 0

    def add(self, image: NDArray[np.uint8]) -> None:
        """Append an image, uint8, shape (height, width, 3)."""
        import av

        if self.count == 0:
            self._stream.height, self._stream.width = image.shape[:2]
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU601", dst_color_range="MPEG")
        frame.pts = self.count
        self.count += 1
        self._container.mux(self._stream.encode(frame))

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if error is None:
            self._container.mux(self._stream.encode())
        self._container.close()


def check_video_size(name: str, height: int, width: int) -> None:
    """Check that H.264 can represent images of a size.

    Raises:
        SimfoundryError: If the height or the width is odd, which yuv420p cannot represent.
    """
    if height % 2 or width % 2:
        raise SimfoundryError(
            f"`{name}` has the size {width} x {height}, but a video requires even numbers; "
            f"choose {width + width % 2} x {height + height % 2}"
        )


def _container_options(rate: Fraction) -> dict[str, str]:
    return {**_CONTAINER, "video_track_timescale": str(rate.numerator)}


def join_videos(parts: Sequence[Path], target: Path) -> None:
    """Write the frames of several videos of one size and rate as one video, without encoding them again.

    Frame k of the result is at k / rate: the times of a part continue those of the part before it.
    """
    import av

    offset, shown = 0, None
    with av.open(str(parts[0])) as first:
        rate = first.streams.video[0].average_rate
        assert rate is not None
    with av.open(str(target), "w", format="mp4", options=_container_options(rate)) as container:
        stream = None
        for part in parts:
            with av.open(str(part)) as source:
                video = source.streams.video[0]
                properties = video.codec_context.extradata, video.average_rate, video.width, video.height
                if stream is None:
                    stream, shown = container.add_stream_from_template(video), properties
                    stream.time_base = 1 / rate
                if properties != shown:
                    raise OutputError(f"{part} has a different size, rate or encoding from {parts[0]}")
                frames = 0
                for packet in source.demux(video):
                    if packet.pts is None:  # the end of the stream
                        continue
                    frames += 1
                    packet.pts = packet.dts = round(packet.pts * packet.time_base * rate) + offset
                    packet.duration, packet.time_base = 1, 1 / rate
                    packet.stream = stream
                    container.mux(packet)
                offset += frames


def decode_video(
    path: Path, start: int = 0, count: int | None = None, size: tuple[int, int] | None = None
) -> Iterator[NDArray[np.uint8]]:
    """Yield images of a video, uint8 of shape (height, width, 3).

    Args:
        path: The video.
        start: The index of the first image.
        count: The maximum number of images, or None for all.
        size: The expected height and width.

    Raises:
        ValueError: If the video has another size, or no exact rate.
    """
    import av

    with av.open(str(path)) as container:
        if not container.streams.video:
            raise ValueError("it contains no video")
        stream = container.streams.video[0]
        rate, base = stream.average_rate, stream.time_base
        if size is not None and (stream.height, stream.width) != size:
            raise ValueError(f"its size is {stream.width} x {stream.height}, not {size[1]} x {size[0]}")
        if not rate or not base:
            raise ValueError("its number of images per second is unknown")
        if start:
            container.seek(round(start / rate / base), stream=stream)
        for frame in container.decode(stream):
            index = round((frame.pts or 0) * base * rate)
            if count is not None and index >= start + count:
                return
            if index >= start:
                yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
