"""Robomimic's HDF5, with the data that MimicGen needs: one file with all episodes, in which each is a group."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, GenerationData
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureRole
from simfoundry.data.dataset.formats import StagedEpisode, StoredDataset
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.checks import checked_frames
from simfoundry.data.formats.hdf5 import new_hdf5_file
from simfoundry.data.formats.robomimic_read import DATASET, RobomimicDataset, is_robomimic
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.extras import need_extra

if TYPE_CHECKING:
    import h5py

_EPISODE = "episode.hdf5"

# Robomimic's number for Gymnasium environments (`EnvType.GYM_TYPE`), and the name under which ours is registered.
_GYM_TYPE, _ENVIRONMENT = 2, "SimFoundry/Task-v0"

# Rendered images are as small at level 1 as in PNG (2 % of their pixels); HDF5's default of 4 takes twice as long and
# saves another quarter. Images with fine texture are twice as large as in PNG.
_GZIP = {"compression": "gzip", "compression_opts": 1, "shuffle": False}


class RobomimicFormat:
    """The format of robomimic and MimicGen."""

    def check(self, info: DatasetInfo) -> None:
        """Check that robomimic can store a dataset.

        Raises:
            SimfoundryError: If the name of a feature is impossible, or if a package is missing.
        """
        need_extra("data", "robomimic datasets")
        for feature in info.features:
            if "/" in feature.name:
                raise SimfoundryError(f"`{feature.name}` contains a slash, which separates groups in HDF5; rename it")
        if not _actions(info):
            raise SimfoundryError("robomimic requires actions, but no feature is an action")

    def losses(self, info: DatasetInfo) -> Sequence[str]:
        """Return what robomimic does not store, or changes."""
        found = [
            "Robomimic does not store statistics, because it computes them.",
            "Robomimic ignores instructions, which are stored as attributes.",
        ]
        if len(_actions(info)) > 1:
            names = ", ".join(f"`{feature.name}`" for feature in _actions(info))
            found.append(f"Robomimic has one array of actions, in which {names} are joined in this order.")
        if len(info.environment.get("robots", {})) > 1:
            found.append("MimicGen reads one hand; the poses of several hands are in groups with one array per robot.")
        return found

    def write_episode(self, info: DatasetInfo, episode: Episode, folder: Path) -> None:
        """Stage an episode as a file with one group."""
        with new_hdf5_file(folder / _EPISODE) as file:
            group = file.create_group("episode")
            header = episode.header
            group.attrs["num_samples"] = header.length
            group.attrs["instruction"] = header.instruction
            actions = [episode.arrays[feature.name].reshape(header.length, -1) for feature in _actions(info)]
            group["actions"] = np.concatenate(actions, axis=1)
            group["states"], group["rewards"] = episode.states, episode.rewards
            group["dones"] = episode.dones.astype(np.int64)
            for feature in info.arrays:
                if feature.role is FeatureRole.OBSERVATION:
                    values = episode.arrays[feature.name]
                    last = episode.final.get(feature.name, values[-1])
                    group[f"obs/{feature.name}"] = values
                    group[f"next_obs/{feature.name}"] = np.concatenate([values[1:], last[None]])
            _write_images(group, info, episode)
            if episode.generation is not None:
                _write_generation(group.create_group("datagen_info"), episode.generation)

    def assemble(
        self,
        info: DatasetInfo,
        staged: Sequence[StagedEpisode],
        statistics: Mapping[str, FeatureStatistics],
        out: Path,
    ) -> None:
        """Copy the groups of the episodes into one file, and write the splits."""
        import h5py

        with new_hdf5_file(out / DATASET) as file:
            data = file.create_group("data")
            data.attrs["total"] = info.frames
            data.attrs["env_args"] = json.dumps(_environment(info))
            for one in staged:
                with h5py.File(one.folder / _EPISODE, "r") as source:
                    source.copy("episode", data, name=f"demo_{one.header.index}")
            for name, (first, end) in info.splits.items():
                demos = [f"demo_{k}".encode() for k in range(first, end)]
                file[f"mask/{name}"] = np.array(demos, dtype=f"S{max(map(len, demos), default=1)}")

    def recognizes(self, folder: Path) -> bool:
        """Return True if a folder contains a dataset in this format."""
        return is_robomimic(folder)

    def read(self, folder: Path) -> StoredDataset:
        """Open a dataset."""
        return RobomimicDataset(folder)


def _actions(info: DatasetInfo) -> list[DatasetFeature]:
    return [feature for feature in info.arrays if feature.role is FeatureRole.ACTION]


def _write_images(group: h5py.Group, info: DatasetInfo, episode: Episode) -> None:
    """Write the images of each frame, one chunk per image, in one pass. Each is compressed once and written twice."""
    length = episode.header.length
    stored = {
        (place, feature.name): group.create_dataset(
            f"{place}/{feature.name}", (length, *feature.shape), feature.dtype, chunks=(1, *feature.shape), **_GZIP
        )
        for place in ("obs", "next_obs")
        for feature in info.images
    }
    if not info.images:
        return
    for t, images in enumerate(checked_frames(info, episode, final=True)):
        for feature in info.images:
            here, before = stored["obs", feature.name], stored["next_obs", feature.name]
            start = (0,) * len(feature.shape)
            if t == length:
                before[t - 1] = images[feature.name]
                continue
            here[t] = images[feature.name]
            if t > 0:
                _, chunk = here.id.read_direct_chunk((t, *start))
                before.id.write_direct_chunk((t - 1, *start), chunk)


def _write_generation(group: h5py.Group, data: GenerationData) -> None:
    """Write MimicGen's ``datagen_info``. With several robots, the data of each hand are in a group of its own."""
    group.attrs["env_interface_name"], group.attrs["env_interface_type"] = _ENVIRONMENT, "simfoundry"
    hands: Mapping[str, Mapping[str, NDArray[Any]]] = {
        "eef_pose": data.eef_pose,
        "target_pose": data.target_pose,
        "gripper_action": data.gripper_action,
    }
    for name, robots in hands.items():
        for robot, values in robots.items():
            group[name if len(robots) == 1 else f"{name}/{robot}"] = values
    for name, values in data.object_poses.items():
        group[f"object_poses/{name}"] = values
    for name, signal in data.subtask_term_signals.items():
        group[f"subtask_term_signals/{name}"] = signal


def _environment(info: DatasetInfo) -> dict[str, Any]:
    """Return robomimic's ``env_args``, and what describes the dataset beyond them."""
    features = [{"name": f.name, "names": list(f.names)} for f in _actions(info)]
    about = {"action_space": info.action_space, "control_freq": info.fps, "robots": info.robot_type}
    return {
        "env_name": _ENVIRONMENT,
        "env_type": _GYM_TYPE,
        "type": _GYM_TYPE,
        "env_kwargs": {**about, "actions": features, **dict(info.environment)},
    }


FORMAT = RobomimicFormat()
