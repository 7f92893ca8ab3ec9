"""A small dataset without a simulation: three episodes with every kind of feature, of different lengths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode, EpisodeHeader, GenerationData, Images
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo, FeatureKind, FeaturePart, FeatureRole
from simfoundry.data.dataset.formats import StagedEpisode, dataset_format
from simfoundry.data.dataset.manifest import DatasetManifest, write_manifest
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.signals import ImageKind

LENGTHS, FPS = (7, 1, 12), 15.0
HEIGHT, WIDTH = 48, 64
INSTRUCTIONS = ("Put the cup in the bowl.", "Gib die Tasse in die Schüssel.")


def image_feature(name: str, kind: FeatureKind, image: ImageKind = ImageKind.COLOR) -> DatasetFeature:
    dtype, channels = {"image": ("uint8", 3), "depth": ("float32", 1), "mask": ("int32", 1)}[image.value]
    names = ("height", "width", "channels")
    shape = (HEIGHT, WIDTH, channels)
    return DatasetFeature(name, FeatureRole.OBSERVATION, kind, dtype, shape, names, camera="front", image=image)


def array_feature(name: str, role: FeatureRole, *parts: FeaturePart) -> DatasetFeature:
    size = parts[-1].stop
    names = tuple(f"{part.name}_{k}" for part in parts for k in range(part.stop - part.start))
    return DatasetFeature(name, role, FeatureKind.ARRAY, "float32", (size,), names, parts)


FEATURES = (
    array_feature(
        "observation.state",
        FeatureRole.OBSERVATION,
        FeaturePart("joint_position", 0, 4, "rad", "joints"),
        FeaturePart("gripper_position", 4, 5, "", "gripper"),
    ),
    array_feature("gripper", FeatureRole.OBSERVATION, FeaturePart("gripper", 0, 1, "", "gripper")),
    image_feature("observation.images.front", FeatureKind.VIDEO),
    image_feature("wrist_image", FeatureKind.IMAGE),
    image_feature("observation.depth.front", FeatureKind.IMAGE, ImageKind.DEPTH),
    image_feature("observation.images.front_mask", FeatureKind.IMAGE, ImageKind.MASK),
    array_feature(
        "action",
        FeatureRole.ACTION,
        FeaturePart("joint_delta", 0, 4, "rad", "joint_delta"),
        FeaturePart("gripper_target", 4, 5, "", "gripper"),
    ),
)


def description(features: tuple[DatasetFeature, ...] = FEATURES, **changes: Any) -> DatasetInfo:
    about = {
        "name": "Cup-demo 1",
        "fps": FPS,
        "robot_type": "demo_arm",
        "features": features,
        "action_space": "joint_delta",
        "instructions": INSTRUCTIONS,
        "splits": {"train": (0, 2), "held_out": (2, 3)},
        "episodes": len(LENGTHS),
        "frames": sum(LENGTHS),
        "environment": {"engine": "mujoco", "tasks": ["cup"], "robots": {"arm": "demo_arm"}, "control_hz": 15},
    }
    return DatasetInfo(**{**about, **changes})


def pictures(episode: int, frame: int) -> Images:
    """The images of a frame: gradients and a disc with saturated edges, depth, and a mask with a large index."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    disc = (x - 10 - 3 * frame) ** 2 + (y - 20 - episode) ** 2 < 60
    color = np.stack([3 * x + 20, 40 + 4 * y, 200 - 2 * x + 5 * episode], axis=-1)
    color[disc] = (230, 40, 30)
    depth = (0.4 + 0.01 * x + 0.003 * frame)[..., None].astype(np.float32)
    mask = (disc * (episode + 70000))[..., None].astype(np.int32)
    found = {ImageKind.COLOR: np.clip(color, 0, 255).astype(np.uint8), ImageKind.DEPTH: depth, ImageKind.MASK: mask}
    return {f.name: found[f.image] for f in FEATURES if f.image is not None}


@dataclass(frozen=True)
class Pictures:
    """The images of an episode."""

    episode: int
    length: int

    def frames(self, final: bool = False) -> Iterator[Images]:
        for frame in range(self.length + final):
            yield pictures(self.episode, frame)


def episode(k: int, features: tuple[DatasetFeature, ...] = FEATURES) -> Episode:
    length, rng = LENGTHS[k], np.random.default_rng(k)
    header = EpisodeHeader(
        index=k,
        first_frame=sum(LENGTHS[:k]),
        length=length,
        instruction=INSTRUCTIONS[k % 2],
        task_index=k % 2,
        split="held_out" if k == 2 else "train",
        subtasks={"grasp": length // 2, "place": None},
        source={"dataset": "demos", "index": k},
    )
    arrays = {f.name: rng.normal(size=(length + 1, *f.shape)).astype(f.dtype) for f in features if not f.is_image}
    final = {f.name: arrays[f.name][-1] for f in features if f.name in arrays and f.role is FeatureRole.OBSERVATION}
    rewards, dones = np.zeros(length, np.float32), np.zeros(length, np.bool_)
    rewards[-1], dones[-1] = 1, True
    return Episode(
        header,
        {name: values[:-1] for name, values in arrays.items()},
        final,
        Pictures(k, length),
        rewards,
        dones,
        rng.normal(size=(length, 6)),
        _generation(length, rng),
    )


def _generation(length: int, rng: np.random.Generator) -> GenerationData:
    def poses() -> Array:
        return rng.normal(size=(length, 4, 4))

    signals: Mapping[str, NDArray[np.int64]] = {"grasp": (np.arange(length) >= length // 2).astype(np.int64)}
    gripper = {"arm": rng.random((length, 1))}
    return GenerationData({"arm": poses()}, {"arm": poses()}, gripper, {"cup": poses(), "bowl": poses()}, signals)


def statistics_of(features: tuple[DatasetFeature, ...], episodes: list[Episode]) -> dict[str, FeatureStatistics]:
    """Statistics over the frames of episodes, by numpy; those of images over all pixels."""
    found = {}
    for f in features:
        if f.is_image:
            pixels = [frame[f.name] for one in episodes for frame in one.frames()]
            values = np.stack(pixels).reshape(-1, f.shape[-1])
            one = FeatureStatistics.of(values)
            found[f.name] = FeatureStatistics(one.min, one.max, one.mean, one.std, len(pixels), one.quantiles)
        else:
            found[f.name] = FeatureStatistics.of(np.concatenate([one.arrays[f.name] for one in episodes]))
    return found


def build(name: str, folder: Path, info: DatasetInfo | None = None, manifest: bool = True) -> Path:
    """Write the dataset in a format, as the builder does; returns its folder."""
    form = dataset_format(name)
    info = info or description()
    episodes = [episode(k, info.features) for k in range(len(LENGTHS))]
    form.check(info)
    staged = []
    for one in episodes:
        place = folder / "staging" / f"{one.header.index:06d}"
        place.mkdir(parents=True)
        form.write_episode(info, one, place)
        staged.append(StagedEpisode(one.header, place, statistics_of(info.features, [one])))
    out = folder / "out"
    out.mkdir()
    total = statistics_of(info.features, episodes)
    form.assemble(info, staged, total, out)
    if manifest:
        headers = [one.header for one in episodes]
        write_manifest(out, DatasetManifest(name, "digest", info, headers, total, form.losses(info)))
    return out
