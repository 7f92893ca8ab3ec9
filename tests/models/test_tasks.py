"""Every task over HTTP, over a process and from recorded answers, and answers that follow another convention."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scaffold import Model, Result

from simfoundry.models.client import ModelClient
from simfoundry.models.contract import ModelError
from simfoundry.models.tasks.depth import BundleDepth
from simfoundry.models.tasks.images import BundleImages
from simfoundry.models.tasks.masks import BundleMasks, SegmentationPrompt
from simfoundry.models.tasks.meshes import BundleMeshes
from simfoundry.models.tasks.poses import Z_UP, BundlePoses
from simfoundry.models.tasks.registry import TASKS
from simfoundry.models.tasks.scenes import BundleScenes
from simfoundry.models.tasks.splats import BundleSplats
from simfoundry.models.transports.http import HttpTransport
from simfoundry.models.transports.process import ProcessTransport
from simfoundry.models.transports.recorded import RecordedTransport
from simfoundry.models.wire import BundleFile, BundleImage
from tests.conftest import REPOSITORY
from tests.models import SERVERS, truth
from tests.models.truth import HEIGHT, MASK, WIDTH, K

Call = Callable[[ModelClient], Any]
FRAMES = [truth.view()[0]] * 3
QUAD = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.2, 0], [0, 0.2, 0.3]], dtype=np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]], np.int32)
HOLED = np.where(MASK, 0, truth.view()[1])
RGBA = np.dstack([truth.view()[0], np.full((HEIGHT, WIDTH), 255, np.uint8)])


def _stereo(client: ModelClient) -> Any:
    right = truth.view(np.array([[1, 0, 0, -truth.BASELINE], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]))[0]
    return BundleDepth(client).match_stereo(FRAMES[0], right, K, truth.BASELINE)


def _splat(client: ModelClient) -> Any:
    points = np.array([[0.1, 0.2, 1.0], [0.0, -0.1, 0.9]])
    return BundleSplats(client).train_splat(FRAMES, np.stack([K] * 3), truth.POSES, points)


CALLS: dict[str, Call] = {
    "depth": lambda c: BundleDepth(c).estimate_depth(FRAMES[0], K),
    "multiview": lambda c: BundleDepth(c).estimate_views([truth.view(X)[0] for X in truth.POSES]),
    "stereo": _stereo,
    "complete_depth": lambda c: BundleDepth(c).complete_depth(FRAMES[0], HOLED, MASK),
    "segment": lambda c: BundleMasks(c).segment(FRAMES[0], SegmentationPrompt(phrases=("box",))),
    "track": lambda c: BundleMasks(c).track(FRAMES, MASK[None]),
    "inpaint": lambda c: BundleImages(c).inpaint(FRAMES[0], MASK, "an empty table"),
    "inpaint_video": lambda c: BundleImages(c).inpaint_video(FRAMES, np.stack([MASK] * 3)),
    "edit": lambda c: BundleImages(c).edit_image("a green mug", [RGBA, FRAMES[0]]),
    "mesh": lambda c: BundleMeshes(c).make_mesh(RGBA),
    "parts": lambda c: BundleMeshes(c).segment_mesh(QUAD, FACES),
    "articulate": lambda c: BundleMeshes(c).estimate_joints(QUAD, FACES, np.array([0, 0, 1, 1], np.int32)),
    "pose": lambda c: BundlePoses(c).estimate_pose(FRAMES[0], truth.view()[1], K, MASK, truth.box_glb()),
    "read_scene": lambda c: BundleScenes(c).read_scene(FRAMES[0]),
    "splat": _splat,
    "splat_image": lambda c: BundleSplats(c).render_splat(
        truth.splat_ply(np.zeros((1, 3))), K, np.eye(4), (WIDTH, HEIGHT)
    ),
}  # fmt: skip


@contextmanager
def serving(model: Model, token: str = "") -> Iterator[str]:
    """Serve a model on this machine, and yield its URL."""
    from scaffold import serve

    with serve(model, "127.0.0.1", 0, token) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


class Direct:
    """A way to a model in this process, which tests of contracts use because it takes no time."""

    place = "the model"

    def __init__(self, model: Model) -> None:
        self.model = model

    def exchange(self, task: str, digest: str, data: bytes) -> bytes:
        return self.model.answer(data, task)

    def describe(self) -> dict[str, Any]:
        return self.model.describe()


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with serving(truth.TRUTH) as address:
        yield address


def _equal(a: Any, b: Any) -> bool:
    if hasattr(a, "__dataclass_fields__"):
        return all(_equal(getattr(a, name), getattr(b, name)) for name in a.__dataclass_fields__)
    if isinstance(a, tuple) and not isinstance(a, str):
        return len(a) == len(b) and all(map(_equal, a, b))
    return bool(np.array_equal(a, b)) if isinstance(a, np.ndarray) else bool(a == b)


def test_every_task_has_a_call() -> None:
    assert set(CALLS) == set(TASKS) == set(truth.SOLVERS)


@pytest.mark.parametrize("task", TASKS)
def test_answers_over_http_and_a_process_and_from_records_are_equal(task: str, url: str, tmp_path: Path) -> None:
    over_http = CALLS[task](ModelClient(HttpTransport(url), record=tmp_path))
    (kept,) = tmp_path.glob("*.zip")
    assert _equal(over_http, CALLS[task](ModelClient(RecordedTransport(tmp_path))))
    assert _equal(over_http, CALLS[task](ModelClient(ProcessTransport(("cat", str(kept))))))
    assert over_http.made_by.name == "truth" and over_http.made_by.commercial is True


def test_a_server_answers_on_its_standard_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(REPOSITORY), str(SERVERS)]))
    process = ProcessTransport((sys.executable, "-m", "tests.models.truth"))
    found = CALLS["depth"](ModelClient(process))
    assert _equal(found, CALLS["depth"](ModelClient(Direct(truth.TRUTH))))
    assert set(process.describe()["tasks"]) == set(TASKS)


def test_values_arrive_as_they_were_sent() -> None:
    client = ModelClient(Direct(truth.TRUTH))
    posed = CALLS["pose"](client)
    np.testing.assert_allclose(posed.object_to_camera[0] @ Z_UP, truth.OBJECT_TO_CAMERA, atol=1e-12)
    np.testing.assert_allclose(posed.scale, [1.0])
    made = CALLS["mesh"](client)
    np.testing.assert_allclose(np.ptp(made.parts[0].vertices, axis=0), (0.2, 0.3, 0.1), atol=1e-6)  # z is up
    tracked = CALLS["track"](client).masks
    assert tracked.shape == (3, 1, HEIGHT, WIDTH) and (tracked[2, 0] == np.roll(MASK, 2, axis=1)).all()
    filled = CALLS["inpaint"](client).image
    assert (filled[~MASK] == FRAMES[0][~MASK]).all() and (filled[MASK] == 128).all()
    none = BundleMasks(client).segment(FRAMES[0], SegmentationPrompt(phrases=("unicorn",)))
    assert none.masks.shape == (0, HEIGHT, WIDTH)


def _set(name: str, change: Callable[[Any], Any]) -> Callable[[Result], None]:
    def spoil(result: Result) -> None:
        result.members[name] = change(result.members[name])

    return spoil


def _joint(**changes: Any) -> Callable[[Result], None]:
    def spoil(result: Result) -> None:
        assert result.values is not None
        result.values["joints"][0].update(changes)

    return spoil


def _seen(**changes: Any) -> Callable[[Result], None]:
    def spoil(result: Result) -> None:
        assert result.values is not None
        result.values["objects"][0].update(changes)

    return spoil


GL = np.diag([1.0, -1, -1, 1])

# Answers that follow another convention, and what the client says about each.
WRONG: list[tuple[str, Callable[[Result], object], str]] = [
    ("depth", _set("depth", lambda d: d * 1000), "is it in millimeters"),
    ("depth", _set("depth", lambda d: -d), "OpenGL camera looks along -z"),
    ("depth", _set("depth", lambda d: d / 1000), "relative or inverse"),
    ("depth", _set("depth", lambda d: d[::2, ::2].copy()), r"shape \(24, 32\); it must be \(H, W\), H = 48, W = 64"),
    ("depth", _set("depth", lambda d: d.T.copy()), r"shape \(64, 48\)"),
    ("depth", _set("depth", lambda d: d.astype(np.float64)), "float64; it must be float32"),
    ("depth", _set("depth", lambda d: d[None]), r"shape \(1, 48, 64\)"),
    ("depth", _set("depth", lambda d: 0 * d), "no pixel with a known"),
    ("depth", _set("K", lambda m: m / [[WIDTH] * 3, [HEIGHT] * 3, [1, 1, 1]]), "normalized by the image size"),
    ("depth", _set("K", lambda m: np.diag([3.0, 3, 1]) @ m), "image of another size"),
    ("depth", _set("K", lambda m: np.diag([1.2, 1.2, 1]) @ m), "differs from the one in the request"),
    ("depth", _set("K", lambda m: m.T.copy()), "transposed"),
    ("depth", lambda r: r.notes.update(depth={"unit": "mm"}), r"states `depth` in 'mm' \(unit\); it must be 'm'"),
    ("depth", lambda r: r.notes.update(depth={"frame": "opengl"}), "states `depth` in 'opengl'"),
    ("depth", lambda r: r.members.pop("depth"), "contains no `depth`"),
    ("depth", lambda r: r.members.update(extra=np.zeros(3)), "contains `extra`; known members"),
    ("depth", lambda r: setattr(r, "confidence", 90.0), "must be between 0 and 1"),
    ("depth", lambda r: setattr(r, "values", {"x": 1}), "has `values`, but this task has none"),
    ("multiview", _set("world_to_camera", np.linalg.inv), "read as camera_to_world instead of world_to_camera"),
    ("multiview", _set("world_to_camera", lambda x: GL @ x @ GL), "axes of OpenGL"),
    ("multiview", _set("world_to_camera", lambda x: x[:, :3].copy()), r"shape \(3, 3, 4\)"),
    ("multiview", _set("world_to_camera", lambda x: x.transpose(0, 2, 1).copy()), "transposed"),
    ("multiview", _set("world_to_camera", lambda x: x @ np.diag([-1.0, 1, 1, 1])), "mirrors"),
    ("multiview", _set("world_to_camera", lambda x: x @ np.diag([2.0, 2, 2, 1])), "scaled by 2"),
    ("stereo", _set("depth", lambda d: d * 1000), "depth in millimeters"),
    ("stereo", _set("disparity", lambda d: -d), "left and right swapped"),
    ("stereo", _set("disparity", lambda d: d / 2), "2 times fx|0.5 times fx"),
    ("stereo", _set("valid", lambda v: v.astype(np.uint8)), "uint8; it must be bool"),
    ("complete_depth", _set("depth", lambda d: d * 1.3), "1.3 times the measured depth"),
    ("complete_depth", _set("depth", lambda d: np.where(MASK, 0, d)), "only 0% of the hole"),
    ("segment", _set("masks", lambda m: m.astype(np.float32)), "float32; it must be bool"),
    ("segment", _set("masks", lambda m: m[:, None]), r"shape \(1, 1, 48, 64\)"),
    ("segment", _set("masks", lambda m: m & False), "an empty mask, number 0"),
    ("segment", _set("boxes", lambda b: b / [WIDTH, HEIGHT, WIDTH, HEIGHT]), "must be float32"),
    ("segment", _set("boxes", lambda b: (b / [64, 48, 64, 48]).astype(np.float32)), "fractions of the image"),
    ("segment", _set("boxes", lambda b: np.array([[24, 16, 16, 16]], np.float32)), "x, y, width, height"),
    ("segment", _set("boxes", lambda b: np.array([[32, 24, 16, 16]], np.float32)), "centers and sizes"),
    ("segment", _set("boxes", lambda b: b[:, [1, 0, 3, 2]]), "rows before columns"),
    ("segment", _set("scores", lambda s: s * 100), "up to 90; the maximum is 1"),
    ("segment", _set("scores", lambda s: np.zeros(2, np.float32)), r"shape \(2,\); it must be \(N\), N = 1"),
    ("segment", _set("prompts", lambda p: p + 1), "they count 1 from 0"),
    ("track", _set("masks", lambda m: np.roll(m, 3, axis=-1)), "not the given mask"),
    ("track", _set("masks", lambda m: np.unpackbits(m, axis=-1)), r"shape \(3, 1, 48, 64\)"),
    ("track", _set("masks", lambda m: m[:2]), r"must be \(T, N, H, W/8\), T = 3"),
    ("inpaint", _set("image", lambda p: BundleImage(p.pixels[..., ::-1])), "as BGR"),
    ("inpaint", _set("image", lambda p: BundleImage(255 - p.pixels)), "outside of the mask"),
    ("inpaint", _set("image", lambda p: BundleImage(p.pixels[:40])), r"shape \(40, 64\)"),
    ("inpaint_video", _set("frames", lambda f: f[:2]), "T = 3"),
    ("edit", _set("image", lambda p: BundleImage(p.pixels[..., :3])), "not an RGBA image"),
    ("mesh", _set("mesh", lambda m: BundleFile("glb", m.data[:200])), "unusable mesh"),
    ("mesh", _set("mesh", lambda m: BundleFile("glb", truth.box_glb((0.2, 0.1, 1e-6)))), "without an extent"),
    ("mesh", lambda r: r.notes.update(mesh={"frame": "z_up"}), "it must be 'gltf_y_up'"),
    ("parts", _set("labels", lambda n: n[:3]), r"shape \(3,\); it must be \(F\), F = 4"),
    ("parts", _set("labels", lambda n: n * 0 - 1), "no labeled triangle"),
    ("parts", _set("labels", lambda n: n.astype(np.int64)), "must be int32"),
    ("articulate", _joint(axis=[0, 0, 2]), "must be a unit vector"),
    ("articulate", _joint(upper=90.0), "limits in degrees"),
    ("articulate", _joint(type="prismatic", upper=150.0), "is it in meters"),
    ("articulate", _joint(origin=[100, 0, 0]), "away from the object"),
    ("articulate", _joint(part=7), r"the parts are \[0, 1\]"),
    ("articulate", _joint(parent=1), "form a loop"),
    ("articulate", _joint(upper=-1.0), "leave no motion"),
    ("articulate", _joint(type="hinge"), "joints.0.type"),
    ("articulate", _joint(others=[1]), "several joints of part 1"),
    ("articulate", _joint(others=[9]), r"moves with \[9\]; the parts are \[0, 1\]"),
    ("articulate", _joint(code="import os"), "joints.0.code"),
    ("pose", _set("object_to_camera", np.linalg.inv), "it fits as camera_to_object"),
    ("pose", _set("object_to_camera", lambda x: GL @ x), "behind the camera; it fits as the axes of an OpenGL"),
    ("pose", _set("object_to_camera", lambda x: x[0]), r"shape \(4, 4\)"),
    ("pose", lambda r: r.members.update(
        object_to_camera=np.repeat(truth.OBJECT_TO_CAMERA[None], 2, 0), scores=np.array([0.1, 0.9])), "not sorted"),
    ("read_scene", _seen(box=[167, 200, 333, 600]), "thousandths of the image"),
    ("read_scene", _seen(box=[0.1, 0.1, 0.5, 0.5]), "fractions of the image"),
    ("read_scene", _seen(mass=-1), "objects.0.mass"),
    ("splat", _set("splat", lambda b: BundleFile("ply", truth.splat_ply(np.full((5, 3), 4000.0)))), "100% lies far"),
    ("splat", _set("splat", lambda b: BundleFile("ply", b.data[:-9])), "unusable splat"),
    ("splat_image", _set("depth", lambda d: d * 0), "opaque pixels without depth"),
]  # fmt: skip


@pytest.mark.parametrize(("task", "change", "said"), WRONG, ids=[f"{t}-{s[:24]}" for t, _, s in WRONG])
def test_a_broken_convention_is_found(task: str, change: Callable[[Result], object], said: str) -> None:
    with pytest.raises(ModelError, match=said) as error:
        CALLS[task](ModelClient(Direct(truth.broken(task, change))))
    text = str(error.value)
    assert text.startswith(f"the answer for `{task}` from the model ") and "\n" not in text


def test_a_pose_in_millimeters_is_found() -> None:
    X = truth.OBJECT_TO_CAMERA.copy()
    X[:3, 3] *= 1000
    model = truth.broken("pose", lambda r: r.members.update(object_to_camera=X[None]))
    with pytest.raises(ModelError, match="it fits as millimeters"):
        CALLS["pose"](ModelClient(Direct(model)))
