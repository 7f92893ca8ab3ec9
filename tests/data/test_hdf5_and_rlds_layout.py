"""The files of robomimic and RLDS as their own readers look them up."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import google_crc32c
import h5py
import numpy as np
import pytest

from simfoundry.data.dataset.features import FeatureRole
from simfoundry.data.dataset.formats import dataset_format
from simfoundry.data.formats.rlds.read import RldsDataset
from simfoundry.data.formats.rlds.tfrecord import decode_values, encode_example, example_features, record
from simfoundry.errors import OutputError
from tests.data.synthetic import FEATURES, LENGTHS, array_feature, build, description, episode

# Written by tensorflow_datasets 4.9.10: two episodes with an image, tensors, and a sentence.
FOREIGN = Path(__file__).parent / "foreign" / "tfds"


@pytest.fixture(scope="module")
def hdf5(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("robomimic", tmp_path_factory.mktemp("robomimic")) / "dataset.hdf5"


@pytest.fixture(scope="module")
def rlds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("rlds", tmp_path_factory.mktemp("rlds"))


def test_robomimic_finds_its_groups(hdf5: Path) -> None:
    with h5py.File(hdf5) as file:
        data = file["data"]
        assert data.attrs["total"] == sum(LENGTHS)
        environment = json.loads(data.attrs["env_args"])
        assert (environment["env_name"], environment["env_type"]) == ("SimFoundry/Task-v0", 2)
        assert environment["env_kwargs"]["actions"][0]["names"] == list(FEATURES[-1].names)
        assert sorted(data) == ["demo_0", "demo_1", "demo_2"]
        assert {name: list(file["mask"][name]) for name in file["mask"]} == {
            "train": [b"demo_0", b"demo_1"],
            "held_out": [b"demo_2"],
        }
        for k, length in enumerate(LENGTHS):
            demo, wanted = data[f"demo_{k}"], episode(k)
            assert demo.attrs["num_samples"] == length and demo.attrs["instruction"] == wanted.header.instruction
            assert all(len(demo[name]) == length for name in ("actions", "states", "rewards", "dones"))
            assert set(demo["obs"]) == set(demo["next_obs"])
            assert set(demo["obs"]) == {f.name for f in FEATURES if f.role is FeatureRole.OBSERVATION}
            for name in demo["obs"]:
                assert (demo["next_obs"][name][:-1] == demo["obs"][name][1:]).all(), name
            last = list(wanted.frames(final=True))[-1]
            for name in demo["next_obs"]:
                after = wanted.final[name] if name in wanted.final else last[name]
                assert (demo["next_obs"][name][-1] == after).all(), name
            info = demo["datagen_info"]
            assert info["eef_pose"].shape == (length, 4, 4) and info["gripper_action"].shape == (length, 1)
            assert sorted(info["object_poses"]) == ["bowl", "cup"] and list(info["subtask_term_signals"]) == ["grasp"]
            assert set(info.attrs) == {"env_interface_name", "env_interface_type"}


def test_hdf5_has_no_times_and_one_chunk_per_image(hdf5: Path) -> None:
    """Times would change the bytes; larger chunks would decompress many images for one."""
    with h5py.File(hdf5) as file:
        found: list[h5py.Dataset | h5py.Group] = []
        file.visititems(lambda name, one: found.append(one))
        assert len(found) > 50 and all(h5py.h5o.get_info(one.id).mtime == 0 for one in found)
        assert file["data/demo_0/obs/wrist_image"].chunks == (1, 48, 64, 3)
        assert file["data/demo_0/next_obs/wrist_image"].compression == "gzip"


def test_the_hands_of_two_robots_are_kept_apart(tmp_path: Path) -> None:
    """A single array, as MimicGen reads it, would drop one of them."""
    one = episode(0)
    assert one.generation is not None
    left, right = np.zeros((7, 4, 4)), np.ones((7, 4, 4))
    object.__setattr__(one.generation, "eef_pose", {"left": left, "right": right})
    dataset_format("robomimic").write_episode(description(), one, tmp_path)
    with h5py.File(tmp_path / "episode.hdf5") as file:
        poses = file["episode/datagen_info/eef_pose"]
        assert (poses["left"][:] == left).all() and (poses["right"][:] == right).all()
    both = description(environment={"robots": {"left": "a", "right": "b"}})
    assert any("several hands" in text for text in dataset_format("robomimic").losses(both))


def test_rlds_has_the_layout_of_tensorflow_datasets(rlds: Path) -> None:
    """The folders and names by which ``tfds.builder`` finds them, and the number of episodes of each file."""
    names = sorted(path.name for path in (rlds / "cup_demo_1/1.0.0").iterdir())
    assert names == [
        "cup_demo_1-held_out.tfrecord-00000-of-00001",
        "cup_demo_1-train.tfrecord-00000-of-00001",
        "dataset_info.json",
        "features.json",
    ]
    about = json.loads((rlds / "cup_demo_1/1.0.0/dataset_info.json").read_text())
    assert (about["name"], about["version"], about["fileFormat"]) == ("cup_demo_1", "1.0.0", "tfrecord")
    assert [(one["name"], one["shardLengths"]) for one in about["splits"]] == [("train", ["2"]), ("held_out", ["1"])]


def test_features_json_has_the_form_of_tensorflow_datasets(rlds: Path) -> None:
    """Each kind of feature is described with the same keys as in a file that the library itself wrote."""
    ours = json.loads((rlds / "cup_demo_1/1.0.0/features.json").read_text())
    theirs = json.loads((FOREIGN / "features.json").read_text())

    def steps(features: Any) -> Any:
        return features["featuresDict"]["features"]["steps"]["sequence"]["feature"]["featuresDict"]["features"]

    own, foreign = steps(ours), steps(theirs)
    assert own["reward"] == foreign["reward"] and own["is_first"] == foreign["is_first"]
    assert own["language_instruction"] == foreign["language_instruction"]
    assert own["action"] == foreign["action"]
    inner, outer = (one["observation"]["featuresDict"]["features"] for one in (own, foreign))
    assert inner["front"] == outer["cam"] and inner["state"] == outer["state"]
    assert inner["depth_front"] == outer["depth"] and inner["front_mask"] == outer["mask"]
    assert ours["featuresDict"]["features"]["steps"]["sequence"]["length"] == "-1"
    assert set(ours) == set(theirs)


def test_paths_in_names_are_the_paths_of_steps(tmp_path: Path) -> None:
    """As in the profile of DROID, whose loader reads positions and velocities."""
    position, gripper = FEATURES[-1].parts
    named = [
        array_feature("observation/joint_position", FeatureRole.OBSERVATION, position),
        array_feature("action", FeatureRole.ACTION, position, gripper),
        array_feature("action_dict/joint_velocity", FeatureRole.ACTION, position),
    ]
    info = description(tuple(named))
    stored = dataset_format("rlds").read(build("rlds", tmp_path, info))
    features = (tmp_path / "out/cup_demo_1/1.0.0/features.json").read_text()
    assert features.count('"joint_velocity"') == 1 and '"joint_delta"' not in features
    for k in range(len(LENGTHS)):
        wanted = episode(k, info.features)
        for name, values in stored.episode(k).arrays.items():
            assert (values == wanted.arrays[name]).all(), name


def test_a_dataset_of_tensorflow_datasets_is_read() -> None:
    """Its keys are in another order, and its tensors are compressed by another library."""
    stored = RldsDataset(FOREIGN)
    assert [stored.header(k).length for k in range(2)] == [3, 4] and stored.header(1).instruction == "hi ü"
    found = stored.episode(1)
    steps = np.arange(4, dtype=np.float32)
    assert (found.arrays["action"] == np.repeat(steps[:, None], 5, axis=1)).all()
    assert (found.arrays["state"] == steps[:, None] + np.arange(5)).all()
    assert (found.arrays["mask"] == (steps + 7)[:, None, None, None]).all() and found.arrays["mask"].dtype == np.int32
    assert [int(one["cam"].max()) for one in found.frames()] == [0, 1, 2, 3]
    assert (found.rewards == steps).all()


def test_records_are_those_of_tensorflow() -> None:
    """Checksums and messages equal to the bytes that TensorFlow wrote, up to the order of the keys."""
    assert google_crc32c.value(b"123456789") == 0xE3069283  # the check value of CRC-32C (RFC 3720)
    data = next(FOREIGN.glob("*.tfrecord*")).read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    message = data[12 : 12 + length]
    assert record(message) == data[: length + 16]
    values = {key: decode_values(one) for key, one in example_features(memoryview(message)).items()}
    again = encode_example(values)
    assert len(again) == len(message)
    assert {key: bytes(one) for key, one in example_features(memoryview(again)).items()} == {
        key: bytes(one) for key, one in example_features(memoryview(message)).items()
    }
    negative = {"a": np.array([-1, 2**40, -(2**63)])}
    decoded = decode_values(example_features(memoryview(encode_example(negative)))["a"])
    assert isinstance(decoded, np.ndarray) and (decoded == negative["a"]).all()


def test_a_changed_byte_is_found(tmp_path: Path) -> None:
    """TensorFlow would report it during training, after hours."""
    folder = build("rlds", tmp_path)
    path = next(iter(sorted(folder.rglob("*train.tfrecord*"))))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(OutputError, match="is damaged: the checksum of the record at byte"):
        stored = dataset_format("rlds").read(folder)
        for k in range(2):
            stored.episode(k)
