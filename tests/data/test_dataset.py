"""Datasets: what a demonstration is made into, the same bytes whatever happens, and nothing that is half written."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.api.datasets import dataset_plan
from simfoundry.data.dataset.build import build_dataset
from simfoundry.data.dataset.checking import check_stored
from simfoundry.data.dataset.episodes import EpisodeBuilder
from simfoundry.data.dataset.manifest import read_manifest
from simfoundry.data.dataset.statistics import QUANTILES, FeatureStatistics, PixelCounts
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.render.gl import Engine, choose_engine
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.data.push_dataset import document_of, plan_of
from tests.data.test_record import bytes_of

pytestmark = [
    pytest.mark.usefixtures("plain"),
    pytest.mark.skipif(choose_engine() is Engine.RAYCAST, reason="no GL driver"),
]

LIGHT = """\
simfoundry: cousins/1
name: looks
twin: push.task.yaml
vary:
  object.block.color: {choose: [red, blue, "#20a040"]}
  camera.front.pose: {shift: 0.05}
  instruction: {choose: [Push it., Shove it.]}
"""


@pytest.mark.slow  # 2 s
def test_a_dataset_contains_the_demonstrations(demos: Path, built: Path) -> None:
    found, stored = sf.demonstrations(demos), sf.dataset(built)
    assert stored.info.episodes == len(stored) == 4 and stored.info.fps == 15.0
    assert [feature.name for feature in stored.info.features] == [
        "observation.state",
        "observation.images.front",
        "action",
    ]
    assert stored.info.splits == {"train": (0, 3), "held_out": (3, 4)}
    first = 0
    for k, demo in enumerate(found):
        header, episode = stored.header(k), stored.episode(k)
        assert (header.length, header.first_frame, header.instruction) == (demo.steps, first, "Push the block away.")
        assert header.source["trajectory"] == demo.trajectory
        state = np.column_stack([demo.states["arm/joints"], demo.states["arm/gripper"]]).astype(np.float32)
        np.testing.assert_array_equal(episode.arrays["observation.state"], state[:-1])
        np.testing.assert_array_equal(episode.final["observation.state"], state[-1])
        np.testing.assert_array_equal(episode.arrays["action"], demo.actions.astype(np.float32))
        assert episode.rewards.tolist() == [0.0] * (demo.steps - 1) + [1.0] == episode.dones.astype(float).tolist()
        assert header.subtasks["away"] == (demo.subtasks["away"] or 0) - 1
        first += demo.steps


@pytest.mark.slow  # 2 s
def test_images_are_those_of_the_replay_at_every_size(demos: Path, built: Path, tmp_path: Path) -> None:
    """The images of a dataset equal, pixel for pixel, those that are rendered while the physics is replayed."""
    small = {"small": {"camera": "front", "size": (32, 24)}, "large": {"camera": "front", "size": (64, 48)}}
    build_dataset(plan_of(demos, cameras=small), tmp_path / "two")
    found, both, one = sf.demonstrations(demos), sf.dataset(tmp_path / "two"), sf.dataset(built)
    with found.open() as world:
        world.render("front", 64, 48)  # the renderer for both sizes
        for k in (0, 2):
            frames, alone = list(both.episode(k).frames(final=True)), list(one.episode(k).frames(final=True))
            for _, pictures, picture in zip(found.replay(found[k], world), frames, alone, strict=True):
                np.testing.assert_array_equal(pictures["small"], world.render("front", 32, 24))
                np.testing.assert_array_equal(pictures["large"], world.render("front", 64, 48))
                np.testing.assert_array_equal(pictures["small"], picture["observation.images.front"])
            assert not np.array_equal(frames[0]["large"], frames[-1]["large"])
            np.testing.assert_array_equal(both.episode(k).states, one.episode(k).states)


def test_depths_and_masks_and_readings(demos: Path, tmp_path: Path) -> None:
    views = {
        "depth": {"camera": "top", "size": (24, 24), "kind": "depth"},
        "mask": {"camera": "top", "size": (32, 24), "render": (32, 32), "kind": "mask"},
        "tip": {"camera": "tip", "size": (32, 24)},
    }
    state = {"hand": ("hand_quat",), "all": ("objects", "object_joints", "joints")}
    plan = plan_of(demos, cameras=views, state=state, action_space="joint_delta", fps=7.5)
    build_dataset(plan, tmp_path / "out")
    stored = sf.dataset(tmp_path / "out")
    shapes = {feature.name: (feature.shape, feature.dtype) for feature in stored.info.features}
    assert shapes["depth"] == ((24, 24, 1), "float32") and shapes["mask"] == ((24, 32, 1), "int32")
    assert shapes["all"] == ((4 * 7 + 2,), "float32") and shapes["hand"] == ((7,), "float32")
    images = next(stored.episode(1).frames())
    assert 0.9 < np.median(images["depth"]) < 1.3 and set(np.unique(images["mask"])) >= {0, 1, 2}
    assert np.all(images["mask"][:, :4] == 0)  # the padding beside a square image
    assert stored.info.action_space == "joint_delta" and "changed within frames" in read(tmp_path / "out").notes[0]
    assert check_stored(tmp_path / "out") == []


def read(folder: Path) -> Any:
    found = read_manifest(folder)
    assert found is not None
    return found


def test_statistics_are_those_of_numpy(built: Path) -> None:
    stored = sf.dataset(built)
    for name in ("observation.state", "action"):
        values = np.concatenate([stored.episode(k).arrays[name] for k in range(4)]).astype(np.float64)
        found = stored.statistics[name]
        np.testing.assert_array_equal(found.min, values.min(axis=0))
        np.testing.assert_array_equal(found.mean, values.mean(axis=0))
        np.testing.assert_array_equal(found.std, values.std(axis=0))
        for key, q in QUANTILES.items():
            np.testing.assert_array_equal(found.quantiles[key], np.quantile(values, q, axis=0))
        assert found.count == len(values) == stored.info.frames
    pixels = [images["observation.images.front"] for k in range(4) for images in stored.episode(k).frames()]
    _same(stored.statistics["observation.images.front"], np.reshape(pixels, (-1, 3)))


@pytest.mark.parametrize("seed", range(4))
def test_statistics_of_counted_pixels_are_those_of_numpy(seed: int) -> None:
    random = np.random.default_rng(seed)
    images = random.integers(0, 20 + 80 * seed, (3, 5, 4, 3)).clip(0, 255).astype(np.uint8)
    counts = PixelCounts.of(images[:1]) + PixelCounts.of(images[1:])
    _same(counts.statistics(), images.reshape(-1, 3))
    assert counts.statistics().count == 3
    depths = random.integers(0, 3000, (2, 6, 5, 1)).astype(np.float32) / 1000
    _same(PixelCounts.of(depths).statistics(), depths.reshape(-1, 1).astype(np.float64), 1e-6)


def _same(found: FeatureStatistics, pixels: np.ndarray, tolerance: float = 1e-9) -> None:
    for key in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(getattr(found, key), getattr(pixels, key)(axis=0), atol=tolerance)
    for key, q in QUANTILES.items():
        np.testing.assert_allclose(found.quantiles[key], np.quantile(pixels, q, axis=0), atol=tolerance)


# -- selection --------------------------------------------------------------------------------------------------------


def test_filters_counts_and_splits(demos: Path) -> None:
    lengths = [int(head["steps"]) for head in sf.demonstrations(demos).heads]
    longest = max(lengths) / 15
    kept = plan_of(demos, filter={"duration": (0.0, longest - 0.01), "subtasks": ("away",)})
    assert kept.info.episodes == sum(length < max(lengths) for length in lengths)
    assert plan_of(demos, sources={"a": {"demonstrations": str(demos), "count": 2}}).info.episodes == 2
    with pytest.raises(SimfoundryError, match="no sub-task `awy`; did you mean `away`"):
        plan_of(demos, filter={"subtasks": ("awy",)})
    with pytest.raises(SimfoundryError, match="no demonstration of source `expert` passes the filter"):
        plan_of(demos, filter={"duration": (100.0, 200.0)})
    with pytest.raises(SimfoundryError, match="record some with `simfoundry record`"):
        plan_of(demos.parent / "nothing")
    with pytest.raises(SimfoundryError, match=r"camera `frnt`.*did you mean `front`"):
        plan_of(demos, cameras={"image": {"camera": "frnt", "size": (32, 24)}})


def test_weights_and_shares(demos: Path) -> None:
    """The sum over the frames of a source of their weights is its share of all draws."""

    def shares(a: dict[str, Any], b: dict[str, Any]) -> list[float]:
        where = {"demonstrations": str(demos)}
        plan = plan_of(demos, sources={"a": where | {"count": 1} | a, "b": where | b})
        drawn = {"a": 0.0, "b": 0.0}
        for one in plan.episodes:
            drawn[one.header.source["source"]] += one.header.weight * one.header.length
        assert sum(drawn.values()) == pytest.approx(plan.info.frames)
        return [drawn["a"] / plan.info.frames, drawn["b"] / plan.info.frames]

    lengths = [int(head["steps"]) for head in sf.demonstrations(demos).heads]
    natural = lengths[0] / (lengths[0] + sum(lengths))
    assert shares({}, {})[0] == pytest.approx(natural)
    assert shares({"share": 0.5}, {}) == pytest.approx([0.5, 0.5])
    assert shares({"weight": 3.0}, {})[0] == pytest.approx(3 * lengths[0] / (3 * lengths[0] + sum(lengths)))


def test_pictures_vary_while_everything_else_is_the_same(demos: Path, bench: Path, tmp_path: Path) -> None:
    recipe = bench.parent / "looks.cousins.yaml"
    recipe.write_text(LIGHT)
    pictures = {"recipe": os.path.relpath(recipe, demos.parent), "count": 3, "keep_original": True}
    sources = {"a": {"demonstrations": str(demos), "count": 2}}
    plan = plan_of(demos, pictures=pictures, sources=sources)
    build_dataset(plan, tmp_path / "out")
    stored = sf.dataset(tmp_path / "out")
    assert len(stored) == 8 and len(stored.info.instructions) == 3
    first = [next(iter(stored.episode(k).frames()))["observation.images.front"] for k in range(4)]
    assert len({image.tobytes() for image in first}) == 4
    for k in range(1, 4):
        for name, values in stored.episode(0).arrays.items():
            np.testing.assert_array_equal(values, stored.episode(k).arrays[name])
        assert stored.header(k).source["pictures"] == k + 3 * stored.header(0).source["index"]
    assert check_stored(tmp_path / "out") == []
    recipe.write_text(LIGHT + "  object.block.mass: {times: [0.5, 2]}\n")
    with pytest.raises(SimfoundryError, match="changes more than the pictures of task `push`"):
        EpisodeBuilder.of(plan_of(demos, pictures=pictures)).build(plan.episodes[1]).frames().__next__()
    (bench.parent / "looks.dataset.yaml").write_text(
        "simfoundry: dataset/1\nname: looks\nsources: {a: {demonstrations: demos}}\n"
        "pictures: {recipe: looks.cousins.yaml}\n"
    )
    checked = run("check", bench.parent / "looks.dataset.yaml")
    assert checked.code == 1 and "`object.block.mass` in `looks.cousins.yaml` changes more than pictures" in checked.err


def test_existing_datasets_are_mixed_in(demos: Path, built: Path, tmp_path: Path) -> None:
    sources = {"sim": {"demonstrations": str(demos), "count": 1}, "real": {"dataset": str(built), "share": 0.25}}
    build_dataset(plan_of(demos, sources=sources), tmp_path / "mix")
    mix, stored = sf.dataset(tmp_path / "mix"), sf.dataset(built)
    assert len(mix) == 5 and mix.header(1).source == {"source": "real", "dataset": "push", "index": 0}
    np.testing.assert_array_equal(mix.episode(3).arrays["action"], stored.episode(2).arrays["action"])
    frames = zip(mix.episode(3).frames(), stored.episode(2).frames(), strict=True)
    assert all(np.array_equal(a["observation.images.front"], b["observation.images.front"]) for a, b in frames)
    with pytest.raises(SimfoundryError, match="set `fps: 15`"):
        plan_of(demos, sources=sources, fps=30.0)
    plan = plan_of(demos, sources=sources, state={"observation.state": ("joints",)})
    with pytest.raises(SimfoundryError, match=r"its shape is \(3,\), not \(2,\).*name its keys under `keys`"):
        build_dataset(plan, tmp_path / "wrong")
    assert not (tmp_path / "wrong").exists()


# -- the same bytes, and faults ---------------------------------------------------------------------------------------


@pytest.mark.slow  # 4 s: it builds several times
def test_the_bytes_do_not_depend_on_processes_or_kills(demos: Path, built: Path, tmp_path: Path) -> None:
    out, document = tmp_path / "out", document_of(demos, tmp_path)
    command = [sys.executable, "-m", "simfoundry", "dataset", "build", str(document), "-o", str(out), "-j", "2"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    staged = tmp_path / ".out.building" / "episodes"
    while process.poll() is None and not list(staged.glob("[0-9]*")):
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not out.exists() and (tmp_path / ".out.building").is_dir()
    done = run("dataset", "build", document, "-o", out, "--json")
    assert done.code == 0 and done.json["episodes"] == 4
    assert bytes_of(out) == bytes_of(built) and not (tmp_path / ".out.building").exists()
    times = {path: path.stat().st_mtime_ns for path in out.iterdir()}
    assert run("dataset", "build", document, "-o", out).code == 0
    assert times == {path: path.stat().st_mtime_ns for path in out.iterdir()}  # nothing is built again


@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_full_disk_is_one_sentence_and_no_dataset(
    demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jobs: str
) -> None:
    out, document = tmp_path / "out", document_of(demos, tmp_path)
    monkeypatch.setenv("PLAIN_FAULT", "2")
    done = run("dataset", "build", document, "-o", out, "-j", jobs)
    assert done.code == 2 and "No space left on device" in done.one_line("episode.npz")
    assert not out.exists() and run("dataset", "check", tmp_path).code == 2
    monkeypatch.delenv("PLAIN_FAULT")
    assert run("dataset", "build", document, "-o", out).code == 0 and len(sf.dataset(out)) == 4


def test_folders_of_others_are_refused(demos: Path, built: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = run("dataset", "build", demos, "-f", "plain", "-o", tmp_path / "file" / "out")
    assert done.code == 2 and len(done.err.splitlines()) == 1
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").touch()
    with pytest.raises(OutputError, match="is not a dataset of SimFoundry"):
        build_dataset(plan_of(demos), tmp_path / "photos")
    with pytest.raises(OutputError, match="contains a different dataset"):
        build_dataset(plan_of(demos), built)
    with pytest.raises(SimfoundryError, match="no dataset format is called `lerobt`"):
        dataset_plan(demos, ["lerobt"])
    with pytest.raises(SimfoundryError, match="no dataset profile is called `gr01t`; did you mean `gr00t`"):
        dataset_plan(demos, [], "gr01t")
    with pytest.raises(SimfoundryError, match="`jobs` must be between 1 and 256"):
        sf.build_dataset(demos, tmp_path / "x", jobs=0)
    with pytest.raises(OutputError, match="does not contain a dataset in a known format"):
        sf.dataset(tmp_path / "photos")


# -- show and check ---------------------------------------------------------------------------------------------------


@pytest.mark.slow  # 3 s
def test_a_dataset_is_shown_in_text_and_on_a_page(built: Path, tmp_path: Path) -> None:
    shown = run("dataset", "show", built, "--page", tmp_path / "page.html", "--episodes", "2")
    assert shown.code == 0 and "push: 4 episodes" in shown.out and "train 3, held_out 1" in shown.out
    assert re.search(r"joint_2 +-?0", shown.out) and "note: Sub-tasks are not stored." in shown.out
    page = (tmp_path / "page.html").read_text()
    assert page.count("data:video/webm;base64,") == 2 and page.count("<polyline") == 12
    assert not re.search(r'(?:src|href)="(?!data:)', page) and "Push the block away." in page
    data = run("dataset", "show", built, "--json").json
    assert data["features"]["action"]["shape"] == [3] and data["splits"] == {"train": 3, "held_out": 1}
    assert data["statistics"]["action"]["count"] == data["frames"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("profile: lerobot", "profile: lerobt", "no dataset profile is called `lerobt`; did you mean `lerobot`"),
        ("camera: front", "camera: frnt", "no camera of scene `bench` is called `frnt`"),
        ("profile: lerobot", "formats: [lerobot-v9]", "no dataset format is called `lerobot-v9`"),
        (
            "{until: 0.9}",
            "{until: 0.8}",
            "`validation` starts at 0.9, but `train` ends at 0.8; splits must not leave a",
        ),
        ("profile: lerobot", "frame: hand", "`frame` has no effect on the default action space"),
        (
            "{demonstrations: recorded}",
            "{demonstrations: recorded, share: 0.5}",
            "the shares of the sources must add up to 1",
        ),
        ("image: {camera", "action: {camera", "`action` is the key of the actions in profile `lerobot`"),
        ("profile: lerobot", "state: {state: []}", "1"),
        ("{demonstrations: recorded}", "{}", "specify either `demonstrations` or `dataset`"),
        ("{demonstrations: recorded}", "{demonstrations: recorded, keys: {a: b}}", "`keys` requires `dataset`"),
    ],
)
def test_documents_are_checked(demos: Path, bench: Path, old: str, new: str, words: str) -> None:
    folder = bench.parent
    text = (
        "simfoundry: dataset/1\nname: push\nprofile: lerobot\nsources: {a: {demonstrations: recorded}}\n"
        "cameras: {image: {camera: front, size: [32, 24]}}\nsplits: {train: {until: 0.9}, validation: {from: 0.9}}\n"
    )
    if not (folder / "recorded").exists():
        shutil.copytree(demos, folder / "recorded")
        index = (folder / "recorded" / "demonstrations.json").read_text()
        named = json.loads(index)["document"]
        (folder / "recorded" / "demonstrations.json").write_text(index.replace(named, "../push.task.yaml"))
    path = folder / "checked.dataset.yaml"
    path.write_text(text)
    assert run("check", path).code == 0, run("check", path).err
    path.write_text(text.replace(old, new))
    done = run("check", path)
    assert done.code == 1 and words in done.err, done.err


def test_the_example_is_sound() -> None:
    assert run("check", REPOSITORY / "specs" / "datasets").code == 0
