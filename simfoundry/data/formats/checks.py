"""Checks that all formats share: of an episode while it is written, and of a dataset that is opened."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from simfoundry.data.dataset.episode import Episode, Images
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.manifest import DatasetManifest, read_manifest
from simfoundry.errors import OutputError, SimfoundryError


def checked_frames(info: DatasetInfo, episode: Episode, final: bool = False) -> Iterator[Images]:
    """Yield the images of each frame of an episode.

    Args:
        info: The description of the dataset.
        episode: The episode.
        final: Whether to yield the images after the last action as well.

    Raises:
        SimfoundryError: If there are more or fewer frames than the episode has, or if an image is missing or has
            another shape or type than its feature. Readers would accept such an episode.
    """
    index, count = episode.header.index, 0
    for count, images in enumerate(episode.frames(final), 1):
        for feature in info.images:
            image = images.get(feature.name)
            found = "is missing" if image is None else f"is {image.dtype} of shape {image.shape}"
            if image is None or image.shape != feature.shape or image.dtype != feature.dtype:
                wanted = f"{feature.dtype} of shape {feature.shape}"
                raise SimfoundryError(f"`{feature.name}` in frame {count - 1} of episode {index} {found}, not {wanted}")
        yield images
    if count != episode.header.length + final:
        raise SimfoundryError(f"episode {index} has images for {count} frames, not {episode.header.length + final}")


def matching_manifest(folder: Path, lengths: Sequence[int]) -> DatasetManifest | None:
    """Return the manifest of a dataset whose episodes have these lengths, or None if SimFoundry did not write it.

    Raises:
        OutputError: If the manifest is invalid, or describes other episodes.
    """
    manifest = read_manifest(folder)
    if manifest is not None and [header.length for header in manifest.headers] != list(lengths):
        raise OutputError(
            f"{folder} contains {len(lengths)} episodes with {sum(lengths)} frames, but its simfoundry.json describes "
            f"{len(manifest.headers)} episodes with {manifest.info.frames} frames; build the dataset again"
        )
    return manifest
