"""A page that shows a dataset: its contents and statistics, and videos and plots of some episodes."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, Images
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo
from simfoundry.data.dataset.reading import open_dataset
from simfoundry.data.dataset.summary import summary
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.evaluate.policies.remote import resize_with_pad
from simfoundry.evaluate.rollouts.videos import side_by_side, write_video
from simfoundry.reports.render import render

# Size of a plot [px], and its margin for the axis.
WIDTH, HEIGHT, MARGIN = 420, 110, 40

# Height of videos, and the maximum width of each camera in them [px]; a page with six episodes stays below 5 MB.
VIDEO_HEIGHT, VIDEO_WIDTH = 180, 320

# Number of bars in the histogram of durations.
BARS = 20

# Colors of the lines in a plot; more values repeat them.
COLORS = ("#2f6fde", "#e07b1a", "#2a9d63", "#b23a8f", "#6b7280", "#c3453a", "#7a5a00", "#0f9aa7", "#8b5cf6")


@dataclass(frozen=True)
class PlotLine:
    """A line in a plot: the name of the value, its color, and the points as SVG coordinates."""

    name: str
    color: str
    points: str


@dataclass(frozen=True)
class FeaturePlot:
    """A plot of an array feature over time, with the range of its values."""

    title: str
    low: float
    high: float
    lines: Sequence[PlotLine]
    marks: Mapping[str, float]


@dataclass(frozen=True)
class ShownEpisode:
    """An episode on the page: its description, its video as a data URL or an empty string, and its plots."""

    index: int
    split: str
    instruction: str
    seconds: float
    success: bool
    source: Mapping[str, Any]
    video: str
    plots: Sequence[FeaturePlot]


def dataset_page(folder: Path, episodes: int, progress: Callable[[int, int], None] = lambda k, of: None) -> str:
    """Return the page of a dataset as HTML.

    Args:
        folder: The folder of the dataset.
        episodes: The number of episodes to show, evenly distributed over the dataset.
        progress: Callback that receives the number of the next episode and the number of episodes.
    """
    stored, found = open_dataset(folder)[1], summary(folder)
    chosen = sorted({int(k) for k in np.linspace(0, len(stored) - 1, min(episodes, len(stored))).round()})
    shown = []
    for number, k in enumerate(chosen):
        progress(number, len(chosen))
        shown.append(_shown(stored.info, stored.episode(k)))
    seconds = [stored.header(k).length / stored.info.fps for k in range(len(stored))]
    return render(
        "dataset.html.j2",
        title=f"Dataset: {found['name']}",
        sources="data:",
        facts=_facts(found),
        found=found,
        ranges={name: _ranges(found["features"][name], one) for name, one in found["statistics"].items()},
        durations=_histogram(seconds),
        episodes=shown,
        width=WIDTH,
        height=HEIGHT,
        margin=MARGIN,
    )


def _facts(found: Mapping[str, Any]) -> dict[str, str]:
    return {
        "format": found["format"],
        "profile": found["profile"],
        "license": found["license"],
        "robot": found["robot"],
        "episodes": str(found["episodes"]),
        "frames": f"{found['frames']} at {found['fps']:g} Hz",
        "duration": f"{found['seconds'] / 60:.1f} min",
        "actions": found["action_space"],
        "splits": ", ".join(f"{name} {count}" for name, count in found["splits"].items()),
    }


def _ranges(feature: Mapping[str, Any], statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row with the statistics of each value or channel."""
    columns = {key: np.ravel(statistics[key]) for key in statistics if key != "count"}
    count = len(columns["min"])
    names = feature["names"] or (["red", "green", "blue"] if count == 3 else [""] * count)
    return [{"name": names[k], **{key: float(column[k]) for key, column in columns.items()}} for k in range(count)]


def _histogram(seconds: Sequence[float]) -> dict[str, Any]:
    """Return the relative heights of the bars, and the shortest and longest duration [s]."""
    counts, _ = np.histogram(seconds, bins=BARS)
    return {"bars": [float(c) / max(1, counts.max()) for c in counts], "low": min(seconds), "high": max(seconds)}


def _shown(info: DatasetInfo, episode: Episode) -> ShownEpisode:
    header = episode.header
    marks = {name: (frame + 1) / max(1, header.length) for name, frame in header.subtasks.items() if frame is not None}
    return ShownEpisode(
        index=header.index,
        split=header.split,
        instruction=header.instruction,
        seconds=header.length / info.fps,
        success=header.success,
        source=header.source,
        video=_video(info, episode),
        plots=[_plot(feature, episode.arrays[feature.name], marks) for feature in info.arrays],
    )


def _plot(feature: DatasetFeature, values: NDArray[Any], marks: Mapping[str, float]) -> FeaturePlot:
    rows = values.reshape(len(values), -1).astype(np.float64)
    low, high = float(rows.min()), float(rows.max())
    across = np.linspace(MARGIN, MARGIN + WIDTH, len(rows))
    down = HEIGHT - HEIGHT * (rows - low) / max(high - low, 1e-9)
    names = feature.names or tuple(map(str, range(rows.shape[1])))
    lines = [
        PlotLine(
            name=names[k] if k < len(names) else str(k),
            color=COLORS[k % len(COLORS)],
            points=" ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down[:, k], strict=True)),
        )
        for k in range(rows.shape[1])
    ]
    return FeaturePlot(feature.name, low, high, lines, marks)


def _video(info: DatasetInfo, episode: Episode) -> str:
    """Return a video of the color images of all cameras side by side, as a data URL, or an empty string."""
    colors = [feature for feature in info.images if feature.shape[2] == 3 and feature.dtype == "uint8"]
    if not colors:
        return ""
    frames = [_beside(images, colors) for images in episode.frames()]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.webm"
        write_video(path, frames, info.fps)
        return f"data:video/webm;base64,{base64.b64encode(path.read_bytes()).decode()}"


def _beside(images: Images, features: Sequence[DatasetFeature]) -> NDArray[np.uint8]:
    small = []
    for feature in features:
        height, width, _ = feature.shape
        scale = min(1.0, VIDEO_HEIGHT / height, VIDEO_WIDTH / width)
        size = ImageSize(*(max(2, 2 * round(side * scale / 2)) for side in (width, height)))  # even, as VP8 requires
        small.append(resize_with_pad(images[feature.name], size))
    return side_by_side(small)
