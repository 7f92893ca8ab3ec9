"""Policies that need no server, which one a text means, and policy documents."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.evaluate.entries import ExpertChoice, RandomChoice, ReplayChoice, open_policy, parse_policy
from simfoundry.evaluate.policies import lerobot
from simfoundry.evaluate.policies.base import ImageSize, Policy, PolicyError
from simfoundry.evaluate.policies.groot import GrootPolicy
from simfoundry.evaluate.policies.open_loop import HORIZON, STEP, RandomPolicy, load_replay
from simfoundry.evaluate.policies.openpi import OpenpiPolicy, RoboarenaPolicy
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load
from simfoundry.spec.models.policy import PolicySpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.signals import ActionSpace
from tests.evaluate.drive import JOINTS, observation, spec_of

REPOSITORY = Path(__file__).parents[2]
ACTIONS = np.hstack([JOINTS + 0.02 * np.arange(20)[:, None], np.arange(20)[:, None] > 9])


def test_random_walks_from_where_the_robots_are() -> None:
    policy: Policy = RandomPolicy()
    policy.reset("", 7)
    chunk = policy.infer(observation(0, robots=2))
    assert chunk.shape == (HORIZON, 16) and policy.cameras == {}
    steps = np.diff(np.vstack([np.tile([*JOINTS, 0], 2), chunk]), axis=0)
    joints = [c for c in range(16) if c % 8 != 7]
    assert np.abs(steps[:, joints]).max() <= STEP and np.ptp(steps[:, joints]) > STEP
    assert set(chunk[:, [7, 15]].ravel()) <= {0.0, 1.0}


def test_random_is_the_same_from_the_same_seed() -> None:
    def walk(seed: int) -> list[bytes]:
        policy = RandomPolicy()
        policy.reset("", seed)
        return [policy.infer(observation(k)).tobytes() for k in range(3)]

    assert walk(3) == walk(3) != walk(4)


def stored(folder: Path, suffix: str, actions: Any = ACTIONS, **more: Any) -> Path:
    path = folder / f"rollout{suffix}"
    if suffix == ".npy":
        np.save(path, actions)
    elif suffix == ".npz":
        np.savez_compressed(path, actions=actions, **more)
    else:
        path.write_text(json.dumps({"actions": np.asarray(actions).tolist(), **more}))
    return path


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".json"])
def test_a_recording_is_repeated_and_then_held(tmp_path: Path, suffix: str) -> None:
    policy = load_replay(stored(tmp_path, suffix))
    assert (policy.name, policy.action_space) == (f"replay:rollout{suffix}", ActionSpace.JOINT_POSITION)
    for rollout in range(2):
        policy.reset("", rollout)
        np.testing.assert_array_equal(policy.infer(observation(0)), ACTIONS)
        np.testing.assert_array_equal(policy.infer(observation(20)), ACTIONS[-1:])
        np.testing.assert_array_equal(policy.infer(observation(21)), ACTIONS[-1:])


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_recorded_velocities_end_at_rest(tmp_path: Path, suffix: str) -> None:
    policy = load_replay(stored(tmp_path, suffix, action_space="joint_velocity"))
    policy.reset("", 0)
    policy.infer(observation(0))
    np.testing.assert_array_equal(policy.infer(observation(20)), [[0] * 7 + [1]])


def test_what_is_no_recording(tmp_path: Path) -> None:
    def refused(path: Path) -> str:
        with pytest.raises(PolicyError) as raised:
            load_replay(path)
        return str(raised.value)

    assert "No such file" in refused(tmp_path / "none.npy")
    assert "the name of a recording must end with .npy, .npz or .json" in refused(
        stored(tmp_path, ".json").rename(tmp_path / "a.txt")
    )
    assert "but actions have shape (steps, numbers)" in refused(stored(tmp_path, ".npy", ACTIONS[0]))
    assert "but actions have shape (steps, numbers)" in refused(stored(tmp_path, ".json", []))
    assert "not finite" in refused(stored(tmp_path, ".npy", ACTIONS * np.nan))
    assert "unknown action space `torque`" in refused(stored(tmp_path, ".npz", action_space="torque"))
    for content in (b"", b"PK\x03\x04", pickle.dumps([1]), b"\x93NUMPY\x01\x00\xff\xff", b"[", b"{}"):
        for suffix in (".npy", ".npz", ".json"):
            (tmp_path / f"bad{suffix}").write_bytes(content)
            assert "does not contain recorded actions" in refused(tmp_path / f"bad{suffix}"), (content, suffix)
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000, 100000), }\n"
    huge = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64)
    (tmp_path / "huge.npy").write_bytes(huge)
    assert "does not contain recorded actions" in refused(tmp_path / "huge.npy")
    objects = tmp_path / "objects.npy"
    np.save(objects, np.array([{}], dtype=object), allow_pickle=True)
    assert "does not contain recorded actions" in refused(objects)


def test_a_recording_of_another_robot(tmp_path: Path) -> None:
    policy = load_replay(stored(tmp_path, ".npy"))
    policy.reset("", 0)
    with pytest.raises(PolicyError, match="has 8 numbers per action, but the robots need 16"):
        policy.infer(observation(0, robots=2))


def test_words_and_files() -> None:
    assert parse_policy("random") == RandomChoice()
    assert parse_policy("expert") == ExpertChoice()
    assert parse_policy("expert?noise=0.01") == ExpertChoice(0.01)
    assert parse_policy("replay:a/b:c.npz") == ReplayChoice(Path("a/b:c.npz"))


def test_a_server_in_short() -> None:
    spec = parse_policy("openpi:gpu7:9000?action_space=joint_velocity&velocity_unit=3&horizon=10&timeout=2.5&name=pi0")
    assert isinstance(spec, PolicySpec)
    assert (spec.protocol, spec.address, spec.action_space) == ("openpi", "gpu7:9000", "joint_velocity")
    assert (spec.velocity_unit, spec.horizon, spec.timeout, spec.name) == (3, 10, 2.5, "pi0")
    assert spec.cameras["observation/exterior_image_1_left"].camera == "exterior_left"
    assert parse_policy("openpi:wss://policies.example.org/pi0?action_space=joint_position")
    assert isinstance(parse_policy("roboarena:[::1]:5000?action_space=joint_position"), PolicySpec)


@pytest.mark.parametrize("protocol", ["openpi", "roboarena", "groot"])
def test_the_cameras_of_the_short_form_are_those_of_the_droid_cell(protocol: str) -> None:
    choice = parse_policy(f"{protocol}:localhost?action_space=joint_position")
    assert isinstance(choice, PolicySpec)
    policy = open_policy(choice)
    scene = load(REPOSITORY / "specs/scenes/droid.scene.yaml").spec
    assert isinstance(scene, SceneSpec)
    cameras = scene.cameras
    assert set(policy.cameras) <= set(cameras)
    for name, size in policy.cameras.items():  # in the shape of the camera, or the picture would be squeezed
        width, height = cameras[name].size
        assert size.width / size.height == pytest.approx(width / height, rel=1e-3)
    kinds = {"openpi": OpenpiPolicy, "roboarena": RoboarenaPolicy, "groot": GrootPolicy}
    assert type(policy) is kinds[protocol]
    policy.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "openpi:localhost:8000",
            "joint positions or velocities; use `openpi:localhost:8000?action_space=joint_position`",
        ),
        (
            "openpi",
            "joint positions or velocities; use `openpi:localhost?action_space=joint_position`",
        ),
        ("replay:", "`replay` requires a recording"),
        ("pi0:localhost", "`pi0:localhost` is not a valid policy; use `random`"),
        ("", "`` is not a valid policy"),
        ("expert?noise=1", "between 0 and 0.02 rad, not 1"),
        ("expert?noise=nan", "between 0 and 0.02 rad, not nan"),
        ("expert?nois=0.01", "`expert` has no option `nois`; its only option is `noise`"),
        ("expert?noise=0.01&noise=0.01", "specify each argument once, such as `?noise=0.01`"),
        ("openpi:http://a?action_space=joint_position", "start with `ws://` or `wss://`, not `http://`"),
        ("openpi:a b?action_space=joint_position", "`a b` is not a valid address"),
        ("openpi:a:99999?action_space=joint_position", "port 99999 is invalid"),
        ("groot:tcp://a/b?action_space=joint_position", "must not contain a path"),
        ("openpi:a?action_space=torque", "`action_space`: Input should be"),
        ("openpi:a?action_space=joint_position&horizon=0", "`horizon`: Input should be greater"),
        ("openpi:a?action_space=joint_position&horizn=8", "`horizn`: Extra inputs"),
        ("openpi:a?action_space=joint_position&velocity_unit=3", "`velocity_unit` has no effect on joint positions"),
        (
            "openpi:a?action_space=joint_position&api_key=sk-abc123",
            "`api_key`: expected the name of an env",
        ),
    ],
)
def test_a_text_that_means_no_policy(text: str, words: str) -> None:
    with pytest.raises(PolicyError) as raised:
        parse_policy(text)
    assert words in str(raised.value)


DOCUMENT = """\
simfoundry: policy/1
name: pi05
protocol: openpi
address: localhost:8000
action_space: joint_position
horizon: 8
cameras:
  observation/wrist_image_left: {camera: wrist, size: [224, 224], render: [448, 252]}
state: {observation/joint_position: joints}
gripper: {open: 0, closed: 1, threshold: 0.5}
"""


def written(folder: Path, right: str = "", wrong: str = "") -> Path:
    assert right in DOCUMENT
    path = folder / "pi05.policy.yaml"
    path.write_text(DOCUMENT.replace(right, wrong) if right else DOCUMENT)
    return path


def test_a_document(tmp_path: Path) -> None:
    spec = parse_policy(str(written(tmp_path)))
    assert isinstance(spec, PolicySpec) and spec.gripper.threshold == 0.5
    assert open_policy(spec).cameras == {"wrist": ImageSize(448, 252)}


@pytest.mark.parametrize(
    ("right", "wrong", "code", "line", "words"),
    [
        ("protocol: openpi", "protocol: pi0", "SF106", 3, "pi0"),
        ("localhost:8000", "tcp://localhost", "SF104", 4, "start with `ws://` or `wss://`, not `tcp://`"),
        ("action_space: joint_position\n", "", "SF102", 1, "action_space"),
        ("joint_position\nh", "joint_torque\nh", "SF106", 5, "joint_torque"),
        ("joint_position\nh", "joint_position\nvelocity_unit: 3\nh", "SF107", 6, "no effect on joint positions"),
        ("joint_position\nh", "joint_delta\nframe: base\nh", "SF107", 6, "`frame` has no effect on joint deltas"),
        ("joint_position\nh", "hand_pose\nframe: hand\nh", "SF104", 6, "cannot be in the frame of the hand"),
        ("joint_position\nh", "hand_delta\nrotation: euler\nh", "SF106", 6, "euler"),
        ("joint_position\nh", "joint_position\ncontrol_hz: 0\nh", "SF104", 6, "control_hz"),
        ("horizon: 8", "horizon: 0", "SF104", 6, "horizon"),
        ("[448, 252]", "[112, 63]", "SF104", 8, "is rendered smaller than the policy expects"),
        ("camera: wrist, ", "", "SF102", 8, "camera"),
        ("joints}", "arm}", "SF106", 9, "arm"),
        (
            "protocol: openpi\naddress: localhost:8000",
            "protocol: groot\naddress: localhost",
            "SF107",
            9,
            "remove `state`",
        ),
        ("closed: 1, threshold: 0.5", "closed: 0", "SF104", 10, "must differ"),
        ("threshold: 0.5", "threshold: 1", "SF104", 10, "between 0 and 1"),
        ("horizon: 8", "horizon: 8\napi_key: sk-abc", "SF104", 7, "not the key itself"),
        ("observation/wrist_image_left:", "wrist image:", "SF106", 8, "a key that the policy expects"),
    ],
)
def test_slips_in_a_document(tmp_path: Path, right: str, wrong: str, code: str, line: int, words: str) -> None:
    path = written(tmp_path, right, wrong)
    (finding,) = load(path).all_findings()
    assert (finding.code, finding.line) == (code, line), finding
    assert words in finding.message + finding.hint, finding
    with pytest.raises(SpecError):
        parse_policy(str(path))


def test_one_camera_under_two_keys_is_rendered_once_and_large() -> None:
    views = {
        "small": {"camera": "wrist", "size": (32, 24)},
        "large": {"camera": "wrist", "size": (64, 48)},
        "left": {"camera": "left", "size": (8, 8), "render": (16, 9)},
    }
    policy = open_policy(spec_of("openpi", "a", cameras=views))
    assert policy.cameras == {"wrist": ImageSize(64, 48), "left": ImageSize(16, 9)}


def test_the_documents_of_the_manual_are_sound(tmp_path: Path) -> None:
    """Every YAML block of docs/policies.md that is a document."""
    text = (REPOSITORY / "docs/policies.md").read_text()
    blocks = [block.partition("```")[0] for block in text.split("```yaml\n")[1:]]
    documents = [block for block in blocks if "simfoundry: policy/1" in block]
    assert len(documents) >= 5
    for k, block in enumerate(documents):
        path = tmp_path / f"p{k}.policy.yaml"
        path.write_text(block)
        assert [d.message for d in load(path).all_findings()] == []
        choice = parse_policy(str(path))
        assert isinstance(choice, PolicySpec)
        open_policy(choice).close()


def test_a_checkpoint_without_lerobot_is_one_sentence(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    assert lerobot.main(["folder"]) == 2
    assert capsys.readouterr().err == (
        "a LeRobot checkpoint needs the package `torch`; "
        "install it where the checkpoint runs (`pip install 'simfoundry[policies]' lerobot`)\n"
    )


def test_a_feature_of_a_checkpoint() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    out = lerobot.feature({"observation.images.front": picture}, "observation.images.front", [3, 4, 6])
    np.testing.assert_allclose(out, np.moveaxis(picture, -1, 0) / np.float32(255))
    state = lerobot.feature({"observation.state": np.arange(8.0)}, "observation.state", [8])
    assert state.dtype == np.float32
    with pytest.raises(ValueError, match=r"needs `observation.state` of shape \[7\], not \[8\]"):
        lerobot.feature({"observation.state": np.arange(8.0)}, "observation.state", [7])
    with pytest.raises(ValueError, match=r"needs `observation.state`, but the request contains prompt"):
        lerobot.feature({"prompt": "x"}, "observation.state", [7])


@pytest.mark.parametrize("protocol", ["openpi", "groot"])
def test_a_missing_package_is_one_sentence(monkeypatch: pytest.MonkeyPatch, protocol: str) -> None:
    for module in ("websockets.sync.client", "zmq"):
        monkeypatch.setitem(sys.modules, module, None)
    policy = open_policy(spec_of(protocol, "127.0.0.1:1"))
    with pytest.raises(
        PolicyError, match=rf"protocol of {protocol} needs the package `(websockets|zmq)`; install with"
    ):
        policy.reset("", 0)


def test_nothing_of_a_server_is_loaded_before_it_is_asked() -> None:
    code = (
        "import sys; from simfoundry.evaluate.entries import open_policy, parse_policy\n"
        "texts = [f'{n}:a?action_space=joint_position' for n in ('openpi', 'roboarena', 'groot')]\n"
        "policies = [open_policy(parse_policy(text)) for text in texts]\n"
        "print([m for m in ('websockets', 'zmq', 'msgpack', 'PIL', 'torch', 'mujoco') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=REPOSITORY, check=False)
    assert (done.stdout.strip(), done.stderr) == ("[]", "")
