"""LeRobot's files as its own code reads them: what it accepts without an error although it is wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simfoundry.data.dataset.features import FeatureKind
from simfoundry.data.formats.images import decode_image
from simfoundry.data.formats.lerobot import v3
from simfoundry.data.formats.video import decode_video
from tests.data.synthetic import FEATURES, INSTRUCTIONS, LENGTHS, build, description, episode, image_feature, pictures

FRONT = "observation.images.front"


@pytest.fixture(scope="module")
def v21_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("lerobot-v2.1", tmp_path_factory.mktemp("v21"))


@pytest.fixture(scope="module")
def v3_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("lerobot-v3", tmp_path_factory.mktemp("v3"))


def lines(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_sentences_are_the_index_of_the_tasks_in_v3(v3_folder: Path) -> None:
    """As an ordinary column, LeRobot returns the number of the task in place of its sentence."""
    table = pq.read_table(v3_folder / "meta/tasks.parquet")
    pandas = json.loads(table.schema.metadata[b"pandas"])
    assert pandas["index_columns"] == ["task"]
    assert {one["name"] for one in pandas["columns"]} == {"task", "task_index"}
    assert table["task"].to_pylist() == list(INSTRUCTIONS) and table["task_index"].to_pylist() == [0, 1]


def test_columns_have_the_types_of_lerobot(v21_folder: Path, v3_folder: Path) -> None:
    """Lists of fixed size, single numbers for the shape (1,), and hints that every version of ``datasets`` knows."""
    for path in (v21_folder / "data/chunk-000/episode_000000.parquet", v3_folder / "data/chunk-000/file-000.parquet"):
        columns = pq.read_schema(path)
        assert columns.field("observation.state").type == pa.list_(pa.float32(), 5)
        assert columns.field("gripper").type == pa.float32()
        assert columns.field("wrist_image").type == pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        assert columns.field("observation.depth.front").type == pa.list_(pa.list_(pa.float32()))
        assert columns.field("timestamp").type == pa.float32() and columns.field("index").type == pa.int64()
        assert FRONT not in columns.names
        hints = json.loads(columns.metadata[b"huggingface"])["info"]["features"]
        assert set(hints) == set(columns.names)
        vector = {"feature": {"dtype": "float32", "_type": "Value"}, "length": 5, "_type": "Sequence"}
        assert hints["observation.state"] == vector  # `List` is unknown before datasets 4
        assert hints["wrist_image"] == {"_type": "Image"}
        assert hints["observation.depth.front"] == {"shape": [48, 64], "dtype": "float32", "_type": "Array2D"}


def test_info_describes_every_column(v21_folder: Path, v3_folder: Path) -> None:
    for folder, version in ((v21_folder, "v2.1"), (v3_folder, "v3.0")):
        info = json.loads((folder / "meta/info.json").read_text())
        assert (info["codebase_version"], info["total_episodes"], info["total_frames"]) == (version, 3, 20)
        assert info["splits"] == {"train": "0:2", "held_out": "2:3"}
        assert info["fps"] == 15 and isinstance(info["fps"], int)
        features = info["features"]
        assert features[FRONT]["dtype"] == "video" and features[FRONT]["shape"] == [48, 64, 3]
        assert features[FRONT]["info"]["video.codec"] == "h264" and features[FRONT]["info"]["video.fps"] == 15
        assert features["wrist_image"]["dtype"] == "image"
        assert features["observation.depth.front"]["shape"] == [48, 64]
        assert features["action"]["names"] == list(FEATURES[-1].names)
        table = next(iter(sorted((folder / "data").rglob("*.parquet"))))
        assert set(pq.read_schema(table).names) == {name for name, one in features.items() if one["dtype"] != "video"}


def test_statistics_of_images_have_three_axes_and_end_at_one(v21_folder: Path, v3_folder: Path) -> None:
    """LeRobot refuses the whole dataset if a feature with ``image`` in its name has statistics of another shape."""
    rows = [row["stats"] for row in lines(v21_folder / "meta/episodes_stats.jsonl")]
    for stats in (*rows, json.loads((v3_folder / "meta/stats.json").read_text())):
        for name in (FRONT, "wrist_image"):
            for key in set(stats[name]) - {"count"}:
                values = np.array(stats[name][key])
                assert values.shape == (3, 1, 1) and values.min() >= 0 and values.max() <= 1
        assert "observation.images.front_mask" not in stats and "observation.depth.front" in stats
        assert all(np.array(one["count"]).shape == (1,) for one in stats.values())
        assert np.array(stats["gripper"]["mean"]).shape == (1,)
        assert set(stats) >= {"timestamp", "frame_index", "episode_index", "index", "task_index"}
    red = np.stack([pictures(0, t)[FRONT][..., 0] for t in range(LENGTHS[0])]) / 255
    assert np.array(rows[0][FRONT]["mean"])[0, 0, 0] == pytest.approx(red.mean(), rel=1e-12)
    assert np.array(rows[0][FRONT]["std"])[0, 0, 0] == pytest.approx(red.std(), rel=1e-12)


def test_times_of_episodes_in_v3_are_exact(v3_folder: Path) -> None:
    """An episode of one frame is between two others."""
    table = pq.read_table(v3_folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    starts = [0, 7, 8]
    for row, start, length in zip(table, starts, LENGTHS, strict=True):
        assert row[f"videos/{FRONT}/from_timestamp"] == start / 15
        assert row[f"videos/{FRONT}/to_timestamp"] == (start + length) / 15
        assert (row["dataset_from_index"], row["dataset_to_index"], row["length"]) == (start, start + length, length)
        assert row["tasks"] == [episode(row["episode_index"]).header.instruction]
        assert np.array(row[f"stats/{FRONT}/mean"]).shape == (3, 1, 1)
    video = v3_folder / f"videos/{FRONT}/chunk-000/file-000.mp4"
    assert len(list(decode_video(video))) == sum(LENGTHS)


def test_large_datasets_are_divided_into_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each file starts again at the time 0; files are numbered within folders."""
    monkeypatch.setattr(v3, "DATA_MB", 0)
    monkeypatch.setattr(v3, "VIDEO_MB", 0)
    monkeypatch.setattr(v3, "CHUNK_SIZE", 2)
    folder = build("lerobot-v3", tmp_path)
    files = ["chunk-000/file-000", "chunk-000/file-001", "chunk-001/file-000"]
    assert sorted(p.relative_to(folder / "data").as_posix() for p in (folder / "data").rglob("*.parquet")) == [
        f"{name}.parquet" for name in files
    ]
    rows = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for row, name, length in zip(rows, files, LENGTHS, strict=True):
        place = f"chunk-{row['data/chunk_index']:03d}/file-{row['data/file_index']:03d}"
        assert place == name == f"chunk-{row[f'videos/{FRONT}/chunk_index']:03d}/" + name.split("/")[1]
        assert (row[f"videos/{FRONT}/from_timestamp"], row[f"videos/{FRONT}/to_timestamp"]) == (0.0, length / 15)
    stored = v3.FORMAT.read(folder)
    for k in range(len(LENGTHS)):
        found = stored.episode(k)
        assert (found.arrays["action"] == episode(k).arrays["action"]).all()
        assert len(list(found.frames())) == LENGTHS[k]


def test_openpi_finds_flat_names_and_png_images(tmp_path: Path) -> None:
    """``LeRobotDROIDDataConfig`` takes these keys as they are, and images, not videos."""
    names = {"exterior_image_1_left", "exterior_image_2_left", "wrist_image_left"}
    features = (*(one for one in FEATURES if not one.is_image), *(image_feature(n, FeatureKind.IMAGE) for n in names))
    info = description(tuple(features))
    one = episode(0, info.features)
    frames = [{name: pictures(0, t)["wrist_image"] for name in names} for t in range(LENGTHS[0])]

    class Same:
        def frames(self, final: bool = False) -> Any:
            yield from frames

    object.__setattr__(one, "images", Same())
    v3.FORMAT.write_episode(info, one, tmp_path)
    table = pq.read_table(tmp_path / "episode.parquet")
    assert not list(tmp_path.glob("*.mp4"))
    for name in names:
        for t, value in enumerate(table[name].to_pylist()):
            assert value["bytes"].startswith(b"\x89PNG") and value["path"] is None
            assert (decode_image(value["bytes"], (48, 64, 3)) == frames[t][name]).all()


def test_gr00t_finds_its_modalities(v21_folder: Path) -> None:
    """Every range is in its column, statistics are sliced like it, and the sentence is looked up by index."""
    modality = json.loads((v21_folder / "meta/modality.json").read_text())
    stats = json.loads((v21_folder / "meta/stats.json").read_text())
    table = pq.read_table(v21_folder / "data/chunk-000/episode_000000.parquet")
    assert modality["state"]["joint_position"] == {"start": 0, "end": 4, "original_key": "observation.state"}
    assert modality["state"]["gripper_position"] == {"start": 4, "end": 5, "original_key": "observation.state"}
    assert modality["action"]["joint_delta"] == {"start": 0, "end": 4, "original_key": "action", "absolute": False}
    assert "absolute" not in modality["action"]["gripper_target"]
    assert modality["video"] == {"front": {"original_key": FRONT}}
    assert modality["annotation"] == {"human.task_description": {"original_key": "task_index"}}
    assert modality["annotation"]["human.task_description"]["original_key"] in table.column_names
    for groups in (modality["state"], modality["action"]):
        for group in groups.values():
            column = stats[group["original_key"]]
            assert set(column) == {"mean", "std", "min", "max", "q01", "q99"}
            for values in column.values():
                assert len(values[group["start"] : group["end"]]) == group["end"] - group["start"]
    tasks = {row["task_index"]: row["task"] for row in lines(v21_folder / "meta/tasks.jsonl")}
    assert tasks == dict(enumerate(INSTRUCTIONS))
    rows = np.concatenate([episode(k).arrays["action"] for k in range(3)])
    assert stats["action"]["q99"] == pytest.approx(np.quantile(rows.astype(np.float64), 0.99, axis=0).tolist())
