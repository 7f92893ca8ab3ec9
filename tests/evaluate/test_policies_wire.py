"""What comes over the wire is data: sound answers are actions, and everything else is one clear sentence."""

from __future__ import annotations

import io
import pickle
import struct
from contextlib import suppress
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from simfoundry.evaluate.policies.base import ImageSize, PolicyError
from simfoundry.evaluate.policies.codec import GROOT_CODEC, OPENPI_CODEC, CodecError
from simfoundry.evaluate.policies.remote import actions_of, pictures, reading, resize_with_pad
from simfoundry.geometry.frames import Pose, rpy_from_quat
from tests.evaluate.drive import JOINTS, observation, spec_of

DTYPES = st.sampled_from(["|u1", "<f4", ">f4", "<f8", "<i8", "<u2", "|b1", "<f2"]).map(np.dtype)
ARRAYS = arrays.arrays(DTYPES, arrays.array_shapes(min_dims=0, min_side=0, max_side=4))


@given(array=ARRAYS)
def test_arrays_come_back_as_they_were(array: np.ndarray[Any, Any]) -> None:
    for pack, unpack in ((c.pack, c.unpack) for c in (OPENPI_CODEC, GROOT_CODEC)):
        back = unpack(pack({"a": [array], "prompt": "größer"}))
        assert back["prompt"] == "größer"
        assert back["a"][0].dtype == array.dtype and back["a"][0].shape == array.shape
        assert back["a"][0].tobytes() == array.tobytes()


@given(data=st.binary(max_size=200))
def test_any_bytes_are_a_message_or_an_error_of_ours(data: bytes) -> None:
    for unpack in (OPENPI_CODEC.unpack, GROOT_CODEC.unpack):
        with suppress(CodecError):
            unpack(data)


def array(**changed: Any) -> Any:
    sound = {"__ndarray__": True, "data": bytes(32), "dtype": "<f4", "shape": [1, 8]} | changed
    return msgpack.packb({key.encode(): value for key, value in sound.items()})


class Trap:
    """What would run if it were unpickled."""

    def __reduce__(self) -> Any:
        return (pytest.fail, ("it was unpickled",))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (array(dtype="|O", data=pickle.dumps(Trap())), "only plain numbers are allowed"),
        (array(dtype="<c8"), "only plain numbers are allowed"),
        (array(dtype="<M8[s]"), "only plain numbers are allowed"),
        (array(dtype="f4,f4"), "only plain numbers are allowed"),
        (array(dtype="nonsense"), "of unknown type"),
        (array(dtype=[["a", "<f4"]]), "of unknown type"),
        (array(shape=[10**6, 10**6]), "does not fit 32 bytes"),
        (array(shape=[-1, 8]), "the invalid shape [-1, 8]"),
        (array(shape=[1] * 40), "the invalid shape"),
        (array(shape="18"), "without data or shape"),
        (array(data="text"), "without data or shape"),
        (msgpack.packb({b"__npgeneric__": True, b"data": 300, b"dtype": "|u1"}), "out of range for `uint8`"),
        (msgpack.packb({b"__npgeneric__": True, b"data": b"x", b"dtype": "<f4"}), "of unknown type"),
        (b"\x91" * 100_000 + b"\x00", "not valid msgpack"),
        (b"\xdd\xff\xff\xff\xff", "not valid msgpack"),
        (b"\xc6\xff\xff\xff\xff", "not valid msgpack"),
        (b"\x80\x80", "not valid msgpack"),
        (b"", "not valid msgpack"),
        (pickle.dumps(Trap()), "not valid msgpack"),
    ],
)
def test_what_is_no_array_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(CodecError, match=words.replace("[", r"\[")):
        OPENPI_CODEC.unpack(data)


def npy(header: bytes, body: bytes = bytes(8), version: int = 1) -> Any:
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    return msgpack.packb(
        {"__ndarray_class__": True, "as_npy": b"\x93NUMPY" + bytes([version, 0]) + length + header + body}
    )


def pickled() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array([Trap()], dtype=object), allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (msgpack.packb({"__ndarray_class__": True, "as_npy": pickled()}), "only plain numbers are allowed"),
        (npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000)}"), "does not fit 8 bytes"),
        (npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}"), "the invalid shape"),
        (npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': 1}"), "without a shape"),
        (npy(b"{'descr': '<f8', 'fortran_order': False}"), "could not be parsed"),
        (npy(b"{'descr': [('a', '|O')], 'fortran_order': False, 'shape': (1,)}"), "of unknown type"),
        (npy(b"__import__('os').abort()"), "could not be parsed"),
        (npy(b"(" * 9000), "could not be parsed"),
        (npy(b" " * 20_000), "too long"),
        (npy(b"{}", version=3), "not a NumPy file"),
        (msgpack.packb({"__ndarray_class__": True, "as_npy": b"PK\x03\x04"}), "not a NumPy file"),
        (msgpack.packb({"__ndarray_class__": True}), "not a NumPy file"),
        (msgpack.packb({"__ModalityConfig_class__": True, "as_json": "{"}), "without a description"),
        (b"\x91" * 100_000 + b"\x00", "not valid msgpack"),
    ],
)
def test_what_is_no_array_of_groot_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(CodecError, match=words):
        GROOT_CODEC.unpack(data)


@pytest.mark.parametrize("value", [object(), np.array([Trap()], dtype=object), np.zeros(2, "c8"), {1, 2}])
def test_what_cannot_be_said_is_refused(value: Any) -> None:
    for pack in (OPENPI_CODEC.pack, GROOT_CODEC.pack) if not isinstance(value, np.ndarray) else (OPENPI_CODEC.pack,):
        with pytest.raises(CodecError):
            pack({"a": value})


def test_fortran_order_is_read() -> None:
    array = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(GROOT_CODEC.unpack(GROOT_CODEC.pack(array)), np.arange(6.0).reshape(2, 3))


CHUNK = np.hstack([np.tile(JOINTS, (15, 1)), np.linspace(0, 1, 15)[:, None]])


def test_a_chunk_is_cut_to_the_horizon_and_the_gripper_decides() -> None:
    actions = actions_of(spec_of("openpi", "a"), CHUNK, observation().robots)
    assert actions.shape == (8, 8) and actions.dtype == np.float64
    np.testing.assert_array_equal(actions[:, :7], CHUNK[:8, :7])
    np.testing.assert_array_equal(actions[:, 7], np.zeros(8))  # 0.5 itself does not count as closed
    late = actions_of(spec_of("openpi", "a", horizon=15), CHUNK, observation().robots)
    np.testing.assert_array_equal(late[:, 7], [0] * 8 + [1] * 7)


@pytest.mark.parametrize(
    ("gripper", "said", "closed"),
    [
        ({}, [0, 0.3, 1, 1.7], [0, 0.3, 1, 1]),
        ({"open": 1.0, "closed": 0.0}, [1, 0.7, 0, -2], [0, 0.3, 1, 1]),
        ({"open": -1.0, "closed": 1.0}, [-1, 0, 1, 0.5], [0, 0.5, 1, 0.75]),
        ({"open": 0.04, "closed": 0.0, "threshold": 0.5}, [0.04, 0.019, 0, 0.021], [0, 1, 1, 0]),
    ],
)
def test_every_convention_of_the_gripper(gripper: dict[str, float], said: list[float], closed: list[float]) -> None:
    spec = spec_of("openpi", "a", gripper=gripper, horizon=4)
    chunk = np.hstack([np.zeros((4, 7)), np.array(said)[:, None]])
    np.testing.assert_allclose(actions_of(spec, chunk, observation().robots)[:, 7], closed, atol=1e-12)


def test_velocities_from_minus_one_to_one_have_a_unit() -> None:
    spec = spec_of("openpi", "a", action_space="joint_velocity", velocity_unit=3.0, horizon=1)
    chunk = np.array([[0.5, -2.0, 1.0, 0, 0, 0, 0.1, 1.0]])
    expected = [[1.5, -3.0, 3.0, 0, 0, 0, 0.3, 1.0]]
    np.testing.assert_allclose(actions_of(spec, chunk, observation().robots), expected)
    plain = spec_of("openpi", "a", action_space="joint_velocity", horizon=1)
    np.testing.assert_allclose(actions_of(plain, chunk, observation().robots), chunk)


def test_two_arms_have_their_numbers_in_turn() -> None:
    chunk = np.hstack([CHUNK, CHUNK + 1.0])
    actions = actions_of(spec_of("openpi", "a"), chunk, observation(robots=2).robots)
    np.testing.assert_array_equal(actions[:, 8:15], CHUNK[:8, :7] + 1.0)
    np.testing.assert_array_equal(actions[:, 15], np.ones(8))


def broken(step: int, column: int, value: float) -> np.ndarray[Any, Any]:
    chunk = CHUNK.copy()
    chunk[step, column] = value
    return chunk


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (CHUNK[0], "must have shape (horizon, 8), for 7 joints and the gripper of `arm`; got (8,)"),
        (CHUNK[None], "got (1, 15, 8)"),
        (CHUNK[:, :7], "got (15, 7)"),
        (np.zeros((15, 32)), "got (15, 32)"),
        (CHUNK[:5], "5 actions, but its `horizon` is 8; lower `horizon` to 5"),
        (CHUNK[:0], "got (0, 8)"),
        (broken(3, 2, np.nan), "must be finite; number 2 of action 3 (joint 3 of `arm`) is nan"),
        (broken(0, 7, np.inf), "number 7 of action 0 (gripper of `arm`) is inf"),
        (broken(14, 1, -np.inf), "number 1 of action 14 (joint 2 of `arm`) is -inf"),
        (CHUNK.astype(bool), "an array of `bool`"),
        (CHUNK.astype("U8"), "an array of `<U8`"),
        (CHUNK.tolist(), "a `list` instead of an array"),
        (None, "a `NoneType` instead of an array"),
        ({"a": 1}, "a `dict` instead of an array"),
    ],
)
def test_an_answer_that_is_no_chunk_is_told(answer: Any, words: str) -> None:
    with pytest.raises(PolicyError) as raised:
        actions_of(spec_of("openpi", "a"), answer, observation().robots)
    assert words in str(raised.value) and "tested" in str(raised.value)


def test_a_missing_picture_is_told_and_no_other_is_taken() -> None:
    shown = observation()
    less = {name: image for name, image in shown.images.items() if name != "wrist"}
    with pytest.raises(PolicyError, match="tested needs an image from camera `wrist` as"):
        pictures(spec_of("openpi", "a"), type(shown)(0.0, "", shown.robots, less, shown.state))


def test_readings() -> None:
    robots, gripper = observation(robots=2).robots, spec_of("openpi", "a", gripper={"open": 1.0, "closed": 0.0}).gripper
    np.testing.assert_array_equal(reading("joints", robots, gripper), np.tile(JOINTS, 2))
    np.testing.assert_array_equal(reading("gripper", robots, gripper), [0.75, 0.75])
    np.testing.assert_array_equal(reading("joints_gripper", robots, gripper), np.tile([*JOINTS, 0.75], 2))
    hand = reading("hand", robots, gripper)
    np.testing.assert_allclose(hand[:3], [0.4, 0.1, 0.3])
    np.testing.assert_allclose(turned(*hand[3:6]), next(iter(robots.values())).X_BH.rotation, atol=1e-12)


def test_hands_in_every_representation_and_depths_have_their_keys() -> None:
    shown = observation()
    (robot,) = shown.robots.values()
    gripper = spec_of("openpi", "a").gripper
    for name, size in {"hand": 6, "hand_quat": 7, "hand_rotvec": 6, "hand_rot6d": 9, "hand_world": 7}.items():
        found = reading(name, shown.robots, gripper)
        assert found.shape == (size,)
        np.testing.assert_array_equal(found[:3], robot.X_WH.p if name == "hand_world" else robot.X_BH.p)
    np.testing.assert_allclose(reading("hand_rot6d", shown.robots, gripper)[3:], robot.X_BH.rotation[:2].ravel())
    view = {"camera": "left", "size": (16, 18), "kind": "depth"}
    spec = spec_of("openpi", "a", cameras={"depth": view, "color": {**view, "kind": "image"}})
    depth = np.arange(18 * 32, dtype=np.float32).reshape(18, 32)
    found_images = pictures(spec, replace(shown, depths={"left": depth}))
    assert found_images["color"].shape == (18, 16, 3) and found_images["depth"].dtype == np.float32
    assert set(np.unique(found_images["depth"])) <= {0.0, *np.unique(depth)}  # nothing is mixed
    with pytest.raises(PolicyError, match="as `depth`, but it was not rendered"):
        pictures(spec, shown)


def test_actions_of_hands_and_normalized_ones() -> None:
    spec = spec_of("openpi", "a", action_space="hand_delta", frame="hand", rotation="rpy", normalized=True, horizon=2)
    assert str(spec.space) == "hand_delta:hand:rpy:normalized"
    chunk = np.tile([0.1, 0.2, 0.3, -0.1, -0.2, -0.3, 1.0], (2, 1))
    np.testing.assert_allclose(actions_of(spec, chunk, observation().robots), chunk)  # 1 is closed in both
    chunk[:, 6] = 0.0
    assert (actions_of(spec, chunk, observation().robots)[:, 6] == -1).all()


def turned(roll: float, pitch: float, yaw: float) -> Any:
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ y @ x


@pytest.mark.parametrize("angles", [(0.3, -0.7, 2.1), (-3.0, 1.5, 0.2), (0.4, np.pi / 2, 0.0), (0.4, -np.pi / 2, 0.9)])
def test_roll_pitch_yaw_turn_back(angles: tuple[float, float, float]) -> None:
    rotation = turned(*angles)
    np.testing.assert_allclose(turned(*rpy_from_quat(Pose.from_matrix(rotation).q)), rotation, atol=1e-7)


CHECKER = np.indices((45, 80)).sum(axis=0) % 7 * 40
PICTURE = np.stack([CHECKER, CHECKER.T[:45, :45].repeat(2, axis=1)[:, :80], 255 - CHECKER], axis=-1).astype(np.uint8)


@pytest.mark.parametrize(
    ("size", "inner", "total"),
    [
        (ImageSize(224, 224), (slice(49, 175), slice(0, 224)), 5_270_038_109),
        (ImageSize(32, 24), (slice(3, 21), slice(0, 32)), 118_954_344),
        (ImageSize(40, 100), (slice(39, 61), slice(0, 40)), 163_764_738),
        (ImageSize(33, 18), (slice(0, 18), slice(0, 32)), 97_301_925),
    ],
)
def test_pictures_are_fitted_in_and_padded(size: ImageSize, inner: tuple[slice, slice], total: int) -> None:
    """Where the picture lies, and a weighted sum of its pixels: as openpi-client 0.1.2 has them."""
    out = resize_with_pad(PICTURE, size)
    assert out.shape == (size.height, size.width, 3) and out.dtype == np.uint8
    outside = out.copy()
    outside[inner] = 0
    assert not outside.any()
    assert out[inner][0].any() and out[inner][-1].any() and out[inner][:, 0].any() and out[inner][:, -1].any()
    assert int((out.ravel().astype(np.int64) * (np.arange(out.size) % 997)).sum()) == total


def test_a_picture_of_the_right_size_stays_as_it_is() -> None:
    assert resize_with_pad(PICTURE, ImageSize(80, 45)) is PICTURE
