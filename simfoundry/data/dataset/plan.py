"""The plan of a dataset: all of its episodes, before any of them is built."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from simfoundry import __version__
from simfoundry.data.dataset.arrays import array_values, completed_frames, image_features
from simfoundry.data.dataset.contents import DatasetContents, contents_of
from simfoundry.data.dataset.episode import EpisodeHeader
from simfoundry.data.dataset.features import DatasetFeature, DatasetInfo
from simfoundry.data.dataset.formats import StoredDataset, dataset_format
from simfoundry.data.dataset.pictures import PictureSampler, PictureSource
from simfoundry.data.dataset.reading import open_dataset
from simfoundry.data.dataset.sources import (
    SelectedDataset,
    SelectedDemonstrations,
    existing_datasets,
    select_demonstrations,
)
from simfoundry.data.demonstrations import DemonstrationSet
from simfoundry.data.trajectory import TrajectorySampler, frame_count
from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.dataset import DatasetSource, DatasetSpec
from simfoundry.spec.models.dataset_profile import find_profile

# The split that contains all episodes if the document defines none.
TRAIN = "train"


@dataclass(frozen=True)
class EpisodePlan:
    """An episode to build.

    Attributes:
        header: Its description.
        folder: The folder of the demonstrations or of the dataset from which it is built.
        position: The position of the demonstration or of the episode there.
        pictures: The index with which its pictures are drawn, or None for the original pictures.
        keys: For an episode of an existing dataset, the keys of its features there; None for demonstrations.
    """

    header: EpisodeHeader
    folder: Path
    position: int
    pictures: int | None = None
    keys: Mapping[str, str] | None = None


@dataclass(frozen=True)
class DatasetPlan:
    """A dataset to build.

    Attributes:
        info: Its description.
        contents: The values and images that are taken from demonstrations; None if there are only existing datasets.
        episodes: Its episodes, in order.
        formats: The file formats to write.
        pictures: The recipe from which pictures are drawn, if they vary.
        notes: Differences from the demonstrations that apply to all formats, as whole sentences.
    """

    info: DatasetInfo
    contents: DatasetContents | None
    episodes: tuple[EpisodePlan, ...]
    formats: tuple[str, ...]
    pictures: PictureSource | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def digest(self) -> str:
        """The hash of everything that determines the bytes of the episodes."""
        data = {
            "version": __version__,
            "info": self.info.to_json(),
            "contents": repr(self.contents),
            "episodes": [[asdict(one.header), one.pictures, one.keys] for one in self.episodes],
            "formats": self.formats,
        }
        return hashlib.sha256(json.dumps(data, sort_keys=True, default=str).encode()).hexdigest()


@dataclass
class _Draft:
    """An episode whose place in the dataset is not known yet."""

    source: str
    folder: Path
    position: int
    length: int
    split: str
    instruction: str
    origin: dict[str, Any]
    task: str = ""
    success: bool = True
    subtasks: dict[str, int | None] = field(default_factory=dict)
    pictures: int | None = None
    keys: Mapping[str, str] | None = None


def plan_dataset(spec: DatasetSpec, folder: Path, formats: Sequence[str] = ()) -> DatasetPlan:
    """Plan a dataset.

    Args:
        spec: The document.
        folder: The folder that paths in the document are relative to.
        formats: The file formats to write; by default, those of the document or its profile.

    Raises:
        SimfoundryError: If a source, a camera, a format or the recipe of the pictures cannot be used.
    """
    profile = find_profile(spec.profile, folder)
    chosen = tuple(dict.fromkeys(formats or spec.formats or profile.formats))
    for name in chosen:
        dataset_format(name)
    selected, existing = list(select_demonstrations(spec, folder)), list(existing_datasets(spec, folder))
    stored = {one.name: open_dataset(one.folder)[1] for one in existing}
    notes: tuple[str, ...] = ()
    if selected:
        contents, features, notes = _described(spec, folder, selected)
        fps, space = contents.fps, str(contents.space)
    else:
        other = stored[existing[0].name].info
        contents, features = None, _renamed(other.features, existing[0].keys)
        fps, space = other.fps, other.action_space
    pictures = _pictures(spec, folder)
    drafts = [draft for one in selected for draft in _drafts(one, spec, fps, pictures)]
    for one in existing:
        drafts += _stored_drafts(one, stored[one.name], spec, fps)
    order = list(dict.fromkeys((*spec.splits, *(draft.split for draft in drafts))))
    # Episodes of the same task follow each other, so that processes open its world only once.
    places = {key: k for k, key in enumerate(dict.fromkeys((d.source, d.folder, d.task) for d in drafts))}
    drafts.sort(key=lambda draft: (order.index(draft.split), places[draft.source, draft.folder, draft.task]))
    info = DatasetInfo(
        name=spec.name or "dataset",
        fps=fps,
        robot_type=_robot_type(selected, list(stored.values())),
        features=features,
        action_space=space,
        instructions=tuple(dict.fromkeys(draft.instruction for draft in drafts)),
        splits=_ranges(draft.split for draft in drafts),
        episodes=len(drafts),
        frames=sum(draft.length for draft in drafts),
        profile=spec.profile if not spec.profile.endswith((".yaml", ".yml")) else Path(spec.profile).stem,
        license=spec.license or "",
        environment=_environment(selected),
        origin=_origin(selected, existing, stored, pictures),
    )
    episodes = _numbered(drafts, info.instructions, _weights(spec, drafts))
    return DatasetPlan(info, contents, episodes, chosen, pictures, notes)


def _described(
    spec: DatasetSpec, folder: Path, selected: list[SelectedDemonstrations]
) -> tuple[DatasetContents, tuple[DatasetFeature, ...], tuple[str, ...]]:
    """Return the contents and features, and notes on the conversion of actions, from the first demonstration."""
    first = selected[0]
    demonstration = first.demonstrations[first.positions[0]]
    task = first.demonstrations.task_of(demonstration)
    profile = find_profile(spec.profile, folder)
    contents = contents_of(spec, profile, task.scene, task.control_hz, demonstration.action_space)
    robots = demonstration.about["robots"]
    for one in selected:
        for position in one.positions:
            _check_robots(robots, one.facts(position))
    with TrajectorySampler(task) as sampler:
        values = array_values(contents, sampler.sample(demonstration, contents.fps), sampler)
    observed = [feature for feature in values.features if feature.name in values.final]
    actions = [feature for feature in values.features if feature.name not in values.final]
    notes = tuple(
        f"`{key}` in {contents.actions[key].space}, converted from {demonstration.action_space} at "
        f"{demonstration.action_hz:g} Hz, is approximate: {loss}."
        for key, loss in values.losses.items()
    )
    return contents, (*observed, *image_features(contents), *actions), notes


def _check_robots(robots: Mapping[str, str], facts: Mapping[str, Any]) -> None:
    if facts["robots"] != robots:
        raise SimfoundryError(
            f"task `{facts['task']}` was recorded with the robots {_listed(facts['robots'])}, but others with "
            f"{_listed(robots)}; build a dataset for each"
        )


def _listed(robots: Mapping[str, str]) -> str:
    return ", ".join(f"`{name}` ({kind})" for name, kind in robots.items())


def _renamed(features: Iterable[DatasetFeature], keys: Mapping[str, str]) -> tuple[DatasetFeature, ...]:
    names = {theirs: ours for ours, theirs in keys.items()}
    return tuple(replace(feature, name=names.get(feature.name, feature.name)) for feature in features)


def _pictures(spec: DatasetSpec, folder: Path) -> PictureSource | None:
    wanted = spec.pictures
    return PictureSource(folder / wanted.recipe, wanted.seed, wanted.split or "") if wanted is not None else None


def _drafts(
    one: SelectedDemonstrations, spec: DatasetSpec, fps: float, pictures: PictureSource | None
) -> Iterable[_Draft]:
    """Yield the episodes of a folder of demonstrations; several for each if the pictures vary."""
    copies: list[int | None] = [None]
    if spec.pictures is not None:
        copies = [*([None] if spec.pictures.keep_original else []), *range(spec.pictures.count)]
    samplers = _PictureSamplers(pictures, one.demonstrations)
    for k, position in enumerate(one.positions):
        facts = one.facts(position)
        control_hz = float(facts["control_hz"])
        length = frame_count(int(facts["steps"]), control_hz, fps)
        origin = {"source": one.name, **{key: facts[key] for key in ("task", "index", "trajectory")}}
        for copy in copies:
            index = None if copy is None or spec.pictures is None else facts["index"] * spec.pictures.count + copy + 1
            yield _Draft(
                source=one.name,
                folder=one.demonstrations.folder.resolve(),
                position=position,
                length=length,
                split=_split(one.source, spec, k, len(one.positions)),
                instruction=samplers.instruction(position, index) or str(facts["instruction"]),
                origin=origin if index is None else {**origin, "pictures": index},
                task=str(facts["document"]),
                subtasks=completed_frames(facts["subtasks"], control_hz, fps, length),
                pictures=index,
            )


class _PictureSamplers:
    """The samplers of pictures for the tasks of a folder of demonstrations, each created on first use."""

    def __init__(self, source: PictureSource | None, demonstrations: DemonstrationSet) -> None:
        self._source, self._demonstrations = source, demonstrations
        self._samplers: dict[str, PictureSampler] = {}

    def instruction(self, position: int, index: int | None) -> str:
        """Return the instruction that is drawn for an episode, or an empty string if it does not vary."""
        if index is None or self._source is None:
            return ""
        document = str(self._demonstrations.facts(position)["document"])
        if document not in self._samplers:
            if self._samplers and not next(iter(self._samplers.values())).varies_instruction:
                return ""  # loading tasks takes time
            task = self._demonstrations.task_of(self._demonstrations[position])
            self._samplers[document] = PictureSampler(self._source, task)
        return self._samplers[document].instruction(index)


def _stored_drafts(one: SelectedDataset, stored: StoredDataset, spec: DatasetSpec, fps: float) -> Iterable[_Draft]:
    """Yield the episodes of an existing dataset."""
    if abs(stored.info.fps - fps) > 1e-3 * fps:
        raise SimfoundryError(
            f"{one.folder} has {stored.info.fps:g} frames per second, but the dataset {fps:g}; set `fps: "
            f"{stored.info.fps:g}`, because recorded data cannot be resampled"
        )
    count = len(stored) if one.source.count is None else min(one.source.count, len(stored))
    for k in range(count):
        header = stored.header(k)
        yield _Draft(
            source=one.name,
            folder=one.folder,
            position=k,
            length=header.length,
            split=_split(one.source, spec, k, count),
            instruction=header.instruction,
            origin={"source": one.name, "dataset": stored.info.name, "index": k},
            success=header.success,
            subtasks=dict(header.subtasks),
            keys=one.keys,
        )


def _split(source: DatasetSource, spec: DatasetSpec, k: int, count: int) -> str:
    """Return the split of the k-th of ``count`` demonstrations of a source."""
    if source.split is not None:
        return source.split
    share = (k + 0.5) / count
    for name, split in spec.splits.items():
        low, high = split.ends
        if low <= share < high:
            return name
    return TRAIN


def _ranges(splits: Iterable[str]) -> dict[str, tuple[int, int]]:
    """Return the first episode of each split and the one after its last, from the split of each episode."""
    found: dict[str, tuple[int, int]] = {}
    for k, name in enumerate(splits):
        found[name] = (found.get(name, (k, k))[0], k + 1)
    return found


def _weights(spec: DatasetSpec, drafts: Sequence[_Draft]) -> dict[str, float]:
    """Return how often each frame of a source is drawn, relative to the mean of all frames."""
    frames = dict.fromkeys(spec.sources, 0)
    for draft in drafts:
        frames[draft.source] += draft.length
    shares = {name: source.share for name, source in spec.sources.items() if source.share is not None}
    rest = {name: source.weight * frames[name] for name, source in spec.sources.items() if name not in shares}
    left, total = 1.0 - sum(shares.values()), sum(rest.values())
    mass = {**shares, **{name: left * weighted / total for name, weighted in rest.items()}}
    every = sum(frames.values())
    return {name: mass[name] * every / frames[name] for name in frames}


def _numbered(
    drafts: Sequence[_Draft], instructions: tuple[str, ...], weights: Mapping[str, float]
) -> tuple[EpisodePlan, ...]:
    """Return the episodes with their places in the dataset."""
    found, first = [], 0
    for index, draft in enumerate(drafts):
        header = EpisodeHeader(
            index=index,
            first_frame=first,
            length=draft.length,
            instruction=draft.instruction,
            task_index=instructions.index(draft.instruction),
            split=draft.split,
            weight=round(weights[draft.source], 9),
            success=draft.success,
            subtasks=draft.subtasks,
            source=draft.origin,
        )
        found.append(EpisodePlan(header, draft.folder, draft.position, draft.pictures, draft.keys))
        first += draft.length
    return tuple(found)


def _robot_type(selected: Sequence[SelectedDemonstrations], stored: Sequence[StoredDataset]) -> str:
    if selected:
        return "+".join(map(str, selected[0].facts(selected[0].positions[0])["robots"].values()))
    return stored[0].info.robot_type


def _environment(selected: Sequence[SelectedDemonstrations]) -> dict[str, Any]:
    if not selected:
        return {}
    facts = selected[0].facts(selected[0].positions[0])
    tasks = list(dict.fromkeys(str(one.facts(position)["task"]) for one in selected for position in one.positions))
    keys = ("engine", "engine_version", "version", "control_hz", "robots", "objects")
    return {**{key: facts[key] for key in keys}, "tasks": tasks}


def _origin(
    selected: Sequence[SelectedDemonstrations],
    existing: Sequence[SelectedDataset],
    stored: Mapping[str, StoredDataset],
    pictures: PictureSource | None,
) -> dict[str, Any]:
    """Return the digests of the sources. Folders are not included, so that a dataset does not depend on them."""
    keys = ("task", "policy", "policy_digest", "seed", "starts")
    recorded = []
    for one in selected:
        tasks = {str(facts["document"]): facts for facts in map(one.facts, one.positions)}
        recorded += [{"source": one.name, **{key: facts[key] for key in keys}} for facts in tasks.values()]
    drawn = {}
    if pictures is not None:
        digest = hashlib.sha256(pictures.recipe.read_bytes()).hexdigest()
        drawn = {"pictures": {"recipe": digest, "seed": pictures.seed, "split": pictures.split}}
    infos = {name: json.dumps(found.info.to_json(), sort_keys=True) for name, found in stored.items()}
    others = [
        {"source": one.name, "dataset": one.folder.name, "info": hashlib.sha256(infos[one.name].encode()).hexdigest()}
        for one in existing
    ]
    return {"demonstrations": recorded, **({"datasets": others} if others else {}), **drawn}
