"""Videos as decoders see them: exact times, key frames, colors, and joints without encoding."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from simfoundry.data.formats.video import VideoWriter, check_video_size, decode_video, exact_rate, join_videos
from simfoundry.errors import OutputError, SimfoundryError
from tests.data.synthetic import pictures

IMAGES = [pictures(0, t)["observation.images.front"] for t in range(9)]


def written(path: Path, images: list[NDArray[np.uint8]], hz: float = 15.0) -> Path:
    with VideoWriter(path, hz) as video:
        for image in images:
            video.add(image)
    return path


def time_of(one: Any) -> Fraction:
    assert one.pts is not None and one.time_base is not None
    return Fraction(one.pts * one.time_base)


def psnr(a: NDArray[Any], b: NDArray[Any]) -> float:
    return float(10 * np.log10(255.0**2 / np.mean((a.astype(np.float64) - b) ** 2)))


def test_frames_have_exact_times_and_every_second_one_is_a_key_frame(tmp_path: Path) -> None:
    """Decoders find frames by their times, and torchcodec by the mean rate, so that both must be exact."""
    for hz in (15.0, 7.5, 29.97, 10.0):
        with av.open(str(written(tmp_path / "a.mp4", IMAGES, hz))) as container:
            stream = container.streams.video[0]
            assert stream.average_rate == exact_rate(hz) and stream.frames == len(IMAGES)
            assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
            frames = list(container.decode(stream))
        assert [time_of(frame) for frame in frames] == [k / exact_rate(hz) for k in range(len(IMAGES))]
        assert [bool(frame.key_frame) for frame in frames] == [k % 2 == 0 for k in range(len(IMAGES))]


def test_colors_survive_up_to_the_resolution_of_chroma(tmp_path: Path) -> None:
    """Encoding costs at most 1 dB beyond the conversion to yuv420p, and the color matrix is written to the file."""
    path = written(tmp_path / "a.mp4", IMAGES)
    with av.open(str(path)) as container:
        context = container.streams.video[0].codec_context
        assert (int(context.color_range), int(context.colorspace), int(context.color_primaries)) == (1, 6, 6)
    for image, found in zip(IMAGES, decode_video(path), strict=True):
        frame = av.VideoFrame.from_ndarray(image, format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU601", dst_color_range="MPEG")
        frame.colorspace, frame.color_range = 5, 1
        assert psnr(found, image) > psnr(frame.to_ndarray(format="rgb24"), image) - 1.0


@pytest.mark.parametrize("hz", [15.0, 7.5])
def test_joined_videos_have_the_same_frames_at_consecutive_times(tmp_path: Path, hz: float) -> None:
    """Their packets are copied; joining twice gives the same bytes."""
    parts = [written(tmp_path / f"{k}.mp4", images, hz) for k, images in enumerate((IMAGES[:4], IMAGES[:1], IMAGES))]
    join_videos(parts, tmp_path / "joined.mp4")
    packets, times = [], []
    for path in (*parts, tmp_path / "joined.mp4"):
        with av.open(str(path)) as container:
            found = [packet for packet in container.demux(video=0) if packet.pts is not None]
            packets.append([bytes(packet) for packet in found])
            times.append([time_of(packet) for packet in found])
    assert packets[-1] == packets[0] + packets[1] + packets[2]
    assert times[-1] == [Fraction(k) / exact_rate(hz) for k in range(14)]
    one = list(decode_video(parts[2]))
    assert all((a == b).all() for a, b in zip(decode_video(tmp_path / "joined.mp4", 5, 9), one, strict=True))
    join_videos(parts, tmp_path / "again.mp4")
    assert (tmp_path / "again.mp4").read_bytes() == (tmp_path / "joined.mp4").read_bytes()


def test_videos_of_different_sizes_are_not_joined(tmp_path: Path) -> None:
    small = written(tmp_path / "b.mp4", [image[:32] for image in IMAGES])
    with pytest.raises(OutputError, match=r"b\.mp4 has a different size, rate or encoding from .*a\.mp4"):
        join_videos([written(tmp_path / "a.mp4", IMAGES), small], tmp_path / "joined.mp4")


def test_odd_sizes_are_refused_with_the_nearest_possible_one() -> None:
    check_video_size("front", 180, 320)
    with pytest.raises(SimfoundryError, match=r"`front` has the size 321 x 180, but .* even numbers; choose 322 x 180"):
        check_video_size("front", 180, 321)
