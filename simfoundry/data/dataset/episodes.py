"""Build the episodes of a dataset from demonstrations and from existing datasets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.attempt import ENGINE
from simfoundry.data.dataset.arrays import array_values, generation_data, simulation_states
from simfoundry.data.dataset.contents import DatasetContents
from simfoundry.data.dataset.episode import Episode, Images
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo
from simfoundry.data.dataset.formats import StoredDataset
from simfoundry.data.dataset.pictures import PictureSampler, PictureSource
from simfoundry.data.dataset.plan import DatasetPlan, EpisodePlan
from simfoundry.data.dataset.reading import open_dataset
from simfoundry.data.dataset.rendering import RenderedFrames
from simfoundry.data.demonstrations import Demonstration, DemonstrationSet, read_demonstrations
from simfoundry.data.trajectory import TrajectorySampler
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.evaluate.policies.remote import resize_with_pad
from simfoundry.evaluate.rollouts.control import check_cameras
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World


class EpisodeBuilder:
    """Builds episodes of one dataset. Close it after use.

    The last source stays open, because consecutive episodes usually have the same source.
    """

    def __init__(self, info: DatasetInfo, contents: DatasetContents | None, pictures: PictureSource | None) -> None:
        self._info, self._contents, self._pictures = info, contents, pictures
        self._folder: Path | None = None
        self._source: _OpenDemonstrations | StoredDataset | None = None
        self._world: World | None = None

    @classmethod
    def of(cls, plan: DatasetPlan) -> EpisodeBuilder:
        """Return the builder of a plan."""
        return cls(plan.info, plan.contents, plan.pictures)

    def close(self) -> None:
        """Close all worlds."""
        self._close_world()
        if isinstance(self._source, _OpenDemonstrations):
            self._source.close()
        self._source = self._folder = None

    def _close_world(self) -> None:
        if self._world is not None:
            self._world.close()
        self._world = None

    def build(self, planned: EpisodePlan) -> Episode:
        """Return an episode. It can be used until the next one is built, because its images are rendered when read.

        Raises:
            SimfoundryError: If the source does not have the features of the dataset.
        """
        self._close_world()
        if self._folder != planned.folder:
            self.close()
            is_stored = planned.keys is not None
            self._source = open_dataset(planned.folder)[1] if is_stored else _OpenDemonstrations(planned.folder)
            self._folder = planned.folder
        if isinstance(self._source, _OpenDemonstrations):
            return self._recorded(self._source, planned)
        assert self._source is not None
        return stored_episode(self._source.episode(planned.position), planned, self._info)

    def _recorded(self, source: _OpenDemonstrations, planned: EpisodePlan) -> Episode:
        contents, header = self._contents, planned.header
        assert contents is not None
        demonstration = source.demonstrations[planned.position]
        sampler = source.sampler(demonstration)
        check_cameras(sampler.task.scene, _sizes(contents), "the dataset")
        trajectory = sampler.sample(demonstration, contents.fps)
        values = array_values(contents, trajectory, sampler)
        _check_features(values.features, self._info, str(source.demonstrations.folder))
        if trajectory.length != header.length:
            raise OutputError(f"{planned.folder} has changed while the dataset was built; build it again")
        names = {key: tuple(map(str, demonstration.about[key])) for key in ("objects", "joints", "motions")}
        ends = np.arange(header.length) == header.length - 1
        return Episode(
            header=header,
            arrays=values.arrays,
            final=values.final,
            images=RenderedFrames(contents.views, trajectory, lambda: self._opened(source, sampler, planned), names),
            rewards=(ends & header.success).astype(np.float32),
            dones=ends,
            states=simulation_states(trajectory),
            generation=generation_data(trajectory, sampler, names["objects"], header.subtasks),
        )

    def _opened(self, source: _OpenDemonstrations, sampler: TrajectorySampler, planned: EpisodePlan) -> World:
        """Return the world in which the images of an episode are rendered."""
        if planned.pictures is None or self._pictures is None:
            return sampler.world
        if self._world is None:
            scene = source.pictures(self._pictures, sampler).sample(planned.pictures).scene
            self._world = open_world(scene, ENGINE)
        return self._world


class _OpenDemonstrations:
    """A folder of demonstrations with the task of the last one, a world for rendering, and the recipe of pictures."""

    def __init__(self, folder: Path) -> None:
        self.demonstrations: DemonstrationSet = read_demonstrations(folder)
        self._sampler: tuple[Path, TrajectorySampler] | None = None
        self._pictures: PictureSampler | None = None

    def sampler(self, demonstration: Demonstration) -> TrajectorySampler:
        """Return the sampler for the task of a demonstration."""
        if self._sampler is None or self._sampler[0] != demonstration.document:
            self.close()
            self._sampler = demonstration.document, TrajectorySampler(self.demonstrations.task_of(demonstration))
        return self._sampler[1]

    def pictures(self, source: PictureSource, sampler: TrajectorySampler) -> PictureSampler:
        """Return the sampler of pictures for the task of a sampler, which is created on first use."""
        if self._pictures is None:
            self._pictures = PictureSampler(source, sampler.task)
        return self._pictures

    def close(self) -> None:
        """Close the world."""
        if self._sampler is not None:
            self._sampler[1].close()
        self._sampler = self._pictures = None


def _sizes(contents: DatasetContents) -> dict[str, ImageSize]:
    return {view.camera: view.render for view in contents.views.values()}


def _check_features(features: tuple[DatasetFeature, ...], info: DatasetInfo, place: str) -> None:
    """Check that a source has the features of the dataset.

    Raises:
        SimfoundryError: If it has not. The message names the first difference.
    """
    for feature in features:
        wanted = info.feature(feature.name)
        if (feature.shape, feature.names) != (wanted.shape, wanted.names):
            ours, theirs = ", ".join(wanted.names), ", ".join(feature.names)
            raise SimfoundryError(
                f"`{feature.name}` has the values {theirs} in {place}, but {ours} in the dataset; "
                "use only entries that all sources have in common"
            )


@dataclass(frozen=True)
class _DecodedFrames:
    """The images of an episode of an existing dataset, resized and renamed."""

    episode: Episode
    features: tuple[DatasetFeature, ...]
    keys: Mapping[str, str]

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of each frame. If ``final`` is set, the last images are repeated."""
        last: Images = {}
        for images in self.episode.frames():
            last = {feature.name: self._resized(images, feature) for feature in self.features}
            yield last
        if final:
            yield last

    def _resized(self, images: Images, feature: DatasetFeature) -> NDArray[Any]:
        image = images[self.keys.get(feature.name, feature.name)]
        height, width, channels = feature.shape
        if image.shape == feature.shape:
            return image
        flat = image if channels == 3 else image[..., 0]
        return resize_with_pad(flat, ImageSize(width, height)).reshape(height, width, channels)


def stored_episode(episode: Episode, planned: EpisodePlan, info: DatasetInfo) -> Episode:
    """Return an episode of an existing dataset with the features of another dataset.

    Raises:
        SimfoundryError: If the existing dataset lacks a feature, or has it with another shape.
    """
    keys = planned.keys or {}
    arrays: dict[str, NDArray[Any]] = {}
    final: dict[str, NDArray[Any]] = {}
    for feature in info.arrays:
        key = keys.get(feature.name, feature.name)
        found = episode.arrays.get(key)
        if found is None or found.shape[1:] != feature.shape:
            what = "it is missing" if found is None else f"its shape is {found.shape[1:]}, not {feature.shape}"
            raise SimfoundryError(
                f"feature `{key}` of {planned.folder} cannot be used as `{feature.name}`: {what}; it has "
                f"{', '.join(episode.arrays)}; name its keys under `keys`"
            )
        arrays[feature.name] = found.astype(feature.dtype)
        if key in episode.final:
            final[feature.name] = episode.final[key].astype(feature.dtype)
    if len(episode.rewards) != planned.header.length:
        raise OutputError(f"{planned.folder} states a length for episode {planned.position} that it does not have")
    return replace(
        episode,
        header=planned.header,
        arrays=arrays,
        final=final,
        images=_DecodedFrames(episode, info.images, keys),
    )
