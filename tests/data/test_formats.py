"""Every format: what was written is read, twice written is the same bytes, and invalid files are refused."""

from __future__ import annotations

import json
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simfoundry.data.dataset.episode import Episode
from simfoundry.data.dataset.features import FeatureKind, FeatureRole
from simfoundry.data.dataset.formats import FORMATS, DatasetFormat, dataset_format
from simfoundry.data.formats.lerobot.schema import is_video
from simfoundry.errors import OutputError, SimfoundryError
from tests.data.synthetic import FEATURES, LENGTHS, array_feature, build, description, episode, statistics_of

NAMES = ("lerobot-v2.1", "lerobot-v3", "robomimic", "rlds")
LOSSLESS = ("robomimic", "rlds")  # they have no videos


@pytest.fixture(scope="module", params=NAMES)
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """The name of a format, and the synthetic dataset in it."""
    return request.param, build(request.param, tmp_path_factory.mktemp("dataset"))


def files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_the_names_are_those_of_the_documentation() -> None:
    assert tuple(FORMATS.built_in) == NAMES


def test_what_was_written_is_read(built: tuple[str, Path]) -> None:
    """Arrays and images to the bit, except in videos; and the whole description of each episode."""
    name, folder = built
    assert [other for other in NAMES if dataset_format(other).recognizes(folder)] == [name]
    stored = dataset_format(name).read(folder)
    assert stored.info == description() and len(stored) == len(LENGTHS)
    for k in range(len(LENGTHS)):
        found, wanted = stored.episode(k), episode(k)
        assert found.header == wanted.header
        assert (found.rewards == wanted.rewards).all() and (found.dones == wanted.dones).all()
        assert set(found.arrays) == set(wanted.arrays)
        for key, values in wanted.arrays.items():
            assert found.arrays[key].dtype == values.dtype and (found.arrays[key] == values).all(), key
        pictures = list(zip(found.frames(final=True), wanted.frames(final=True), strict=True))
        for feature in (one for one in FEATURES if one.is_image):
            for one, other in pictures if name == "robomimic" else pictures[:-1]:
                image, exact = one[feature.name], other[feature.name]
                assert (image.dtype, image.shape) == (exact.dtype, exact.shape)
                is_lossy = is_video(feature) and name not in LOSSLESS
                assert psnr(image, exact) > 26 if is_lossy else (image == exact).all(), feature.name


def test_robomimic_keeps_everything(tmp_path: Path) -> None:
    """The state of the simulation, MimicGen's data, and the observation after the last action."""
    stored = dataset_format("robomimic").read(build("robomimic", tmp_path))
    for k in range(len(LENGTHS)):
        found, wanted = stored.episode(k), episode(k)
        assert (found.states == wanted.states).all()
        assert set(found.final) == set(wanted.final)
        assert all((found.final[key] == value).all() for key, value in wanted.final.items())
        assert found.generation is not None and wanted.generation is not None
        for part in ("eef_pose", "target_pose", "gripper_action", "object_poses", "subtask_term_signals"):
            ours, theirs = getattr(found.generation, part), getattr(wanted.generation, part)
            assert set(ours) == set(theirs) and all((ours[key] == theirs[key]).all() for key in theirs), part


@pytest.mark.parametrize("name", NAMES)
def test_a_dataset_without_our_manifest_is_read(name: str, tmp_path: Path) -> None:
    """As those of others are: with the features, splits, sentences and arrays that the format itself contains."""
    stored = dataset_format(name).read(build(name, tmp_path, manifest=False))
    assert dict(stored.info.splits) == dict(description().splits)
    if name.startswith("lerobot"):
        assert (stored.info.fps, stored.info.robot_type) == (15.0, "demo_arm")
    for k in range(len(LENGTHS)):
        found, wanted = stored.episode(k), episode(k)
        for key in ("index", "first_frame", "length", "instruction", "task_index", "split"):
            assert getattr(found.header, key) == getattr(wanted.header, key), key
        action = next(f.name for f in stored.info.features if f.role is FeatureRole.ACTION)
        state = next(f.name for f in stored.info.features if f.name in ("observation.state", "state"))
        assert (found.arrays[action] == wanted.arrays["action"]).all()
        assert (found.arrays[state] == wanted.arrays["observation.state"]).all()
        assert len(list(found.frames())) == LENGTHS[k]


def psnr(image: NDArray[Any], exact: NDArray[Any]) -> float:
    return float(10 * np.log10(255.0**2 / np.mean((image.astype(np.float64) - exact) ** 2)))


def test_the_same_dataset_gives_the_same_bytes(built: tuple[str, Path], tmp_path: Path) -> None:
    name, folder = built
    assert files(build(name, tmp_path)) == files(folder)


def test_statistics_are_those_of_numpy(built: tuple[str, Path]) -> None:
    """In the formats that have some."""
    name, folder = built
    stored = dataset_format(name).read(folder)
    wanted = statistics_of(FEATURES, [episode(k) for k in range(len(LENGTHS))])
    for key, found in stored.statistics.items():
        values = wanted[key]
        assert found.count == sum(LENGTHS)
        for part in ("min", "max", "mean", "std"):
            assert getattr(found, part).ravel() == pytest.approx(getattr(values, part).ravel(), rel=1e-12), (key, part)
        for quantile, value in found.quantiles.items():
            assert value.ravel() == pytest.approx(values.quantiles[quantile].ravel(), rel=1e-12)
    expected = {f.name for f in FEATURES if f.name != "observation.images.front_mask"}
    assert set(stored.statistics) == (set() if name in LOSSLESS else expected)


def test_an_episode_with_a_wrong_number_of_images_is_refused(built: tuple[str, Path], tmp_path: Path) -> None:
    """Readers would accept it, and show later images at earlier times."""
    form, info, whole = dataset_format(built[0]), description(), episode(0)
    short_one = replace(whole, images=episode(1).images)
    with pytest.raises(SimfoundryError, match=r"episode 0 has images for \d frames, not \d"):
        form.write_episode(info, short_one, tmp_path)
    renamed = [replace(f, shape=(40, 40, 3)) if f.name == "wrist_image" else f for f in FEATURES]
    tmp_path = tmp_path / "other"
    tmp_path.mkdir()
    with pytest.raises(SimfoundryError, match=r"`wrist_image` in frame 0 of episode 0 is uint8 of shape \(48, 64, 3\)"):
        form.write_episode(description(tuple(renamed)), whole, tmp_path)


def test_a_dataset_without_images_is_written(built: tuple[str, Path], tmp_path: Path) -> None:
    form = dataset_format(built[0])
    features = tuple(feature for feature in FEATURES if not feature.is_image)
    stored = form.read(build(built[0], tmp_path, description(features)))
    assert [len(list(stored.episode(k).frames(final=True))) for k in range(3)] == [n + 1 for n in LENGTHS]


def damage_json(folder: Path, name: str) -> Path:
    path = next(iter(sorted(folder.rglob(name))))
    path.write_bytes(path.read_bytes()[:-40])
    return path


def truncate(folder: Path, name: str) -> Path:
    path = next(iter(sorted(folder.rglob(name))))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def remove(folder: Path, name: str) -> Path:
    path = next(iter(sorted(folder.rglob(name))))
    path.unlink()
    return path


DAMAGES: list[tuple[str, Callable[[Path, str], Path], str]] = [
    ("lerobot-v2.1", damage_json, "info.json"),
    ("lerobot-v2.1", damage_json, "episodes.jsonl"),
    ("lerobot-v2.1", remove, "tasks.jsonl"),
    ("lerobot-v2.1", remove, "episode_000000.parquet"),
    ("lerobot-v2.1", truncate, "episode_000000.parquet"),
    ("lerobot-v2.1", remove, "episode_000000.mp4"),
    ("lerobot-v2.1", truncate, "episode_000002.mp4"),
    ("lerobot-v3", truncate, "file-000.parquet"),
    ("lerobot-v3", truncate, "file-000.mp4"),
    ("lerobot-v3", remove, "tasks.parquet"),
    ("robomimic", truncate, "dataset.hdf5"),
    ("rlds", truncate, "*.tfrecord*"),
    ("rlds", remove, "*.tfrecord*"),
    ("rlds", damage_json, "features.json"),
]


@pytest.mark.parametrize(("name", "damage", "file"), DAMAGES)
def test_damaged_files_are_refused_by_name(
    name: str, damage: Callable[[Path, str], Path], file: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """When the dataset is opened, or when the episode is read; never with a traceback, and never with less data."""
    folder = _pristine(name, tmp_path_factory)
    path = damage(folder, file)
    with pytest.raises(OutputError, match=path.name.replace("*", ".*").split("-of-")[0]):
        read_everything(dataset_format(name), folder)


_BUILT: dict[str, Path] = {}


def _pristine(name: str, factory: pytest.TempPathFactory) -> Path:
    if name not in _BUILT:
        _BUILT[name] = build(name, factory.mktemp("pristine"))
    return Path(shutil.copytree(_BUILT[name], factory.mktemp("copy") / "dataset"))


def read_everything(form: DatasetFormat, folder: Path) -> list[Episode]:
    stored = form.read(folder)
    found = [stored.episode(k) for k in range(len(stored))]
    for one in found:
        list(one.frames())
    return found


def test_a_path_outside_the_dataset_is_refused(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The patterns in ``info.json`` are of others: no other folder, and no attributes of Python objects."""
    for pattern in ("../{episode_index:06d}.parquet", "/etc/{episode_index}", "{episode_index.__class__}"):
        folder = _pristine("lerobot-v2.1", tmp_path_factory)
        info = folder / "meta/info.json"
        text = info.read_text()
        info.write_text(text.replace("data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet", pattern))
        with pytest.raises(OutputError, match=r"outside the dataset|unknown field"):
            dataset_format("lerobot-v2.1").read(folder)


def test_impossible_names_and_sizes_are_refused_before_anything_is_written() -> None:
    part = FEATURES[-1].parts[0]
    slash = array_feature("a/b", FeatureRole.OBSERVATION, part)
    for name in ("lerobot-v2.1", "lerobot-v3", "robomimic"):
        with pytest.raises(SimfoundryError, match="`a/b` contains a slash"):
            dataset_format(name).check(description((*FEATURES, slash)))
    timestamp = array_feature("timestamp", FeatureRole.OBSERVATION, part)
    with pytest.raises(SimfoundryError, match="a feature cannot be called `timestamp`"):
        dataset_format("lerobot-v3").check(description((*FEATURES, timestamp)))
    odd = [replace(f, shape=(47, 64, 3)) if f.kind is FeatureKind.VIDEO else f for f in FEATURES]
    with pytest.raises(SimfoundryError, match="has the size 64 x 47"):
        dataset_format("lerobot-v2.1").check(description(tuple(odd)))
    same = array_feature("observation.images.gripper", FeatureRole.OBSERVATION, part)
    with pytest.raises(SimfoundryError, match="would both be called `observation/gripper`"):
        dataset_format("rlds").check(description((*FEATURES, same)))
    still = tuple(feature for feature in FEATURES if feature.role is not FeatureRole.ACTION)
    for name in ("robomimic", "rlds"):
        with pytest.raises(SimfoundryError, match="requires actions"):
            dataset_format(name).check(description(still))


def test_losses_are_whole_sentences() -> None:
    for name in NAMES:
        losses = dataset_format(name).losses(description())
        assert losses and all(text[0].isupper() or text[0] == "`" for text in losses)
        assert all(text.endswith(".") for text in losses)
    assert any("H.264" in text for text in dataset_format("lerobot-v3").losses(description()))
    plain = description(tuple(f for f in FEATURES if not f.is_image))
    assert not any("H.264" in text for text in dataset_format("lerobot-v3").losses(plain))


@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_an_error_that_names_the_file(name: str, tmp_path: Path) -> None:
    """At any point. HDF5 would print a traceback for each object and then crash, so this needs a stream of our own."""
    for limit in (1, 600, 3000):
        place = tmp_path / str(limit)
        place.mkdir()
        with largest_file(limit), pytest.raises(OSError, match="File too large") as caught:
            dataset_format(name).write_episode(description(), episode(2), place)
        assert str(place) in str(caught.value) and "\n" not in str(caught.value)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file of this process become larger than ``size`` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_splits_of_others_that_are_incomplete_are_one_split(tmp_path: Path) -> None:
    """Some datasets keep the splits of an earlier state, or have none."""
    folder = build("lerobot-v2.1", tmp_path, manifest=False)
    info = folder / "meta/info.json"
    text = info.read_text()
    for wrong in ('{"train": "0:2"}', '{"train": "0:2", "held_out": "1:3"}', "{}", '{"train": "0:4"}'):
        info.write_text(json.dumps({**json.loads(text), "splits": json.loads(wrong)}))
        assert dict(dataset_format("lerobot-v2.1").read(folder).info.splits) == {"train": (0, 3)}
    info.write_text(json.dumps({**json.loads(text), "splits": {"b": "1:3", "a": "0:1"}}))
    assert dict(dataset_format("lerobot-v2.1").read(folder).info.splits) == {"a": (0, 1), "b": (1, 3)}
