"""Requirements of LeRobot, and what it does not store."""

from __future__ import annotations

from collections.abc import Sequence

from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.formats.lerobot.schema import DEFAULT_COLUMNS, RESULT_COLUMNS, is_color, is_video
from simfoundry.data.formats.video import check_video_size
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.extras import need_extra


def check_features(info: DatasetInfo) -> None:
    """Check that LeRobot can store a dataset.

    Raises:
        SimfoundryError: If the name or the size of a feature is impossible, or if a package is missing.
    """
    need_extra("data", "LeRobot datasets")
    for feature in info.features:
        if feature.name in {*DEFAULT_COLUMNS, *RESULT_COLUMNS, "task"}:
            raise SimfoundryError(f"a feature cannot be called `{feature.name}`, which LeRobot uses; rename it")
        if "/" in feature.name:
            raise SimfoundryError(f"`{feature.name}` contains a slash, which LeRobot does not allow; rename it")
        if is_video(feature):
            check_video_size(feature.name, *feature.shape[:2])


def format_losses(info: DatasetInfo) -> Sequence[str]:
    """Return what LeRobot does not store, or changes, as whole sentences."""
    found = ["LeRobot does not store the states of the simulation and MimicGen's data."]
    if any(is_video(feature) for feature in info.features):
        found.append("LeRobot stores videos as H.264 in yuv420p, which is not lossless; single images are.")
    hidden = [f"`{f.name}`" for f in info.images if not is_color(f) and "image" in f.name]
    if hidden:
        verb = "has" if len(hidden) == 1 else "have"
        found.append(f"{', '.join(hidden)} {verb} no statistics in LeRobot, which allows only those of color images.")
    return found
