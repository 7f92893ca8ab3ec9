"""The example servers, against packages with the real names and parameters, through the same checks as any answer."""

from __future__ import annotations

import importlib
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scaffold import Model

from simfoundry.models import wire
from simfoundry.models.client import ModelClient
from simfoundry.models.provenance import find_licence, judged
from simfoundry.models.tasks.depth import BundleDepth
from simfoundry.models.tasks.masks import BundleMasks, SegmentationPrompt
from simfoundry.models.tasks.meshes import BundleMeshes
from simfoundry.models.tasks.poses import Z_UP, BundlePoses
from simfoundry.models.transports.process import ProcessTransport
from tests.models import SERVERS, stub_mesh_packages, stub_packages, stub_particulate, truth
from tests.models.test_tasks import CALLS, FACES, FRAMES, QUAD, Direct
from tests.models.truth import MASK, K

pytestmark = pytest.mark.usefixtures("packages")

Z = truth.view()[1]

SCRIPTS = {
    "partfield_inference.py": """
import sys, pathlib, numpy as np
folder = pathlib.Path(sys.argv[sys.argv.index("result_name") + 1])
np.save(folder / "part_feat_mesh_0_batch.npy", np.array([[1.0, 0], [-1, 0], [1, 1], [-2, 1]]))
""",
    "nerfstudio/scripts/train.py": """
import sys, json, pathlib, numpy as np
given = dict(zip(sys.argv[2::2], sys.argv[3::2]))
at = sys.argv.index("nerfstudio-data")
given |= dict(zip(sys.argv[at + 1 :: 2], sys.argv[at + 2 :: 2]))
assert sys.argv[1] == "splatfacto" and given["--pipeline.model.camera-optimizer.mode"] == "SO3xR3"
assert given["--orientation-method"] == given["--center-method"] == "none" and given["--auto-scale-poses"] == "False"
data = pathlib.Path(given["--data"])
scene = json.loads((data / "transforms.json").read_text())
assert all((data / frame["file_path"]).is_file() for frame in scene["frames"])
out = pathlib.Path(given["--output-dir"]) / given["--experiment-name"] / "splatfacto" / given["--timestamp"]
out.mkdir(parents=True)
points = (data / scene["ply_file_path"]).read_text().split("end_header")[1]
(out / "config.yml").write_text(json.dumps({"frames": scene["frames"], "points": points}))
""",
    "nerfstudio/scripts/exporter.py": """
import sys, json, pathlib, numpy as np
assert sys.argv[1] == "gaussian-splat"
given = dict(zip(sys.argv[2::2], sys.argv[3::2]))
trained = json.loads(pathlib.Path(given["--load-config"]).read_text())
points = np.array(trained["points"].split(), float).reshape(-1, 6)[:, :3]
frames = trained["frames"]
# The first Gaussian is at the first camera, and the second one a meter in front of it, along -z as in OpenGL.
pose = np.array(frames[0]["transform_matrix"])
points = np.concatenate([[pose[:3, 3], pose[:3, 3] - pose[:3, 2]], points])
names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
rows = np.zeros((len(points), 14), "<f4")
rows[:, :3], rows[:, 7:10], rows[:, 10] = points, -4, 1
rows[0, 3:6] = [frames[0][key] for key in ("fl_x", "cx", "h")]
head = "ply\\nformat binary_little_endian 1.0\\nelement vertex %d\\n" % len(rows)
head += "".join("property float %s\\n" % name for name in names) + "end_header\\n"
(pathlib.Path(given["--output-dir"]) / "splat.ply").write_bytes(head.encode() + rows.tobytes())
""",
    "inference/cogvideox_fun/predict_v2v.py": """
import sys, pathlib, shutil
given = dict(a.removeprefix("--config.").split("=", 1) for a in sys.argv if "=" in a)
out = pathlib.Path(given["experiment.save_path"]); out.mkdir()
scene = pathlib.Path(given["data.data_rootdir"]) / given["experiment.run_seqs"]
assert (scene / "prompt.json").read_text() and given["data.sample_size"] == "384x672"
for name in ("scene-fg=-1.mp4", "scene-fg=-1_tuple.mp4"):
    shutil.copy(scene / "input_video.mp4", out / name)
""",
}


@pytest.fixture
def packages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Put the packages where servers look for them, and return the working folder."""
    groups = (stub_packages.torch, stub_packages.transformers, stub_packages.depths, stub_mesh_packages.meshes)
    for group in groups:
        for name, module in group():
            monkeypatch.setitem(sys.modules, name, module)
    for path, text in SCRIPTS.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def server(name: str, monkeypatch: pytest.MonkeyPatch, which: str = "") -> ModelClient:
    """Return a client of a freshly imported server."""
    for one in ("foundation_stereo", name):
        monkeypatch.delitem(sys.modules, f"serve_{one}", raising=False)
    monkeypatch.setattr(sys, "path", list(sys.path))
    module: Any = importlib.import_module(f"serve_{name}")
    return ModelClient(Direct(module.MODELS[which] if which else module.MODEL))


def _more(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, module in stub_mesh_packages.others():
        monkeypatch.setitem(sys.modules, name, module)


def test_sam3_and_sam2(monkeypatch: pytest.MonkeyPatch) -> None:
    model = BundleMasks(server("sam3", monkeypatch))
    found = model.segment(FRAMES[0], SegmentationPrompt(phrases=("box", "unicorn")))
    assert (found.masks[0] == MASK).all() and found.prompts.tolist() == [0] and found.scores[0] == pytest.approx(0.9)
    boxed = model.segment(FRAMES[0], SegmentationPrompt(boxes=(truth.BOX, truth.BOX)))
    assert boxed.prompts.tolist() == [0, 1] and boxed.made_by.name == "sam3"
    with pytest.raises(Exception, match="takes phrases and boxes"):
        model.segment(FRAMES[0], SegmentationPrompt(points=((1, 1, 1),)))
    tracked = BundleMasks(server("sam2", monkeypatch)).track(FRAMES, MASK[None], keyframe=1).masks
    assert all((tracked[t, 0] == np.roll(MASK, abs(t - 1), axis=1)).all() for t in range(3))


def test_models_of_depth_in_meters_at_the_size_of_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    metric = CALLS["depth"](server("da3", monkeypatch, "depth"))
    np.testing.assert_allclose(metric.depth, Z, rtol=1e-5)
    views = CALLS["multiview"](server("da3", monkeypatch, "multiview"))
    np.testing.assert_allclose(views.depth[1], truth.view(truth.POSES[1])[1], rtol=1e-5)
    np.testing.assert_allclose(views.K, [K] * 3)
    np.testing.assert_allclose(views.world_to_camera, truth.POSES)
    assert views.confidence.max() == 1 and judged(views.made_by)[0] == "forbidden"
    moge = server("moge2", monkeypatch)
    for known in (K, None):
        found = BundleDepth(moge).estimate_depth(FRAMES[0], known)
        np.testing.assert_allclose(found.depth[3:], Z[3:], rtol=1e-5)
        assert (found.depth[:3] == 0).all() and pytest.approx(K) == found.K
    completed = CALLS["complete_depth"](server("prior_depth_anything", monkeypatch))
    np.testing.assert_allclose(completed.depth, Z)


def test_stereo_of_research_and_for_commercial_use(monkeypatch: pytest.MonkeyPatch) -> None:
    research = CALLS["stereo"](server("foundation_stereo", monkeypatch))
    np.testing.assert_allclose(research.depth[research.valid], Z[research.valid], rtol=1e-5)
    assert not research.valid[:, 0].any(), "the right camera does not see the left edge"
    monkeypatch.setenv("SIMFOUNDRY_STEREO_ONNX", "c.onnx")
    commercial = CALLS["stereo"](server("c_foundation_stereo", monkeypatch))
    inside = commercial.valid & MASK
    assert np.median(commercial.depth[inside] / Z[inside]) == pytest.approx(1, rel=0.01)
    assert [judged(one.made_by)[0] for one in (research, commercial)] == ["forbidden", "allowed"]


@pytest.mark.parametrize("name", ["hunyuan3d_2_1", "trellis2", "sam3d_objects"])
def test_models_of_meshes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = CALLS["mesh"](server(name, monkeypatch))
    assert np.ptp(made.parts[0].vertices, axis=0) == pytest.approx((0.2, 0.3, 0.1))
    entry = find_licence(made.made_by.name)
    assert entry is not None and "mesh" in entry.task


def test_foundation_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    client = server("foundation_pose", monkeypatch)
    found = CALLS["pose"](client)
    np.testing.assert_allclose(found.object_to_camera[0] @ Z_UP, truth.OBJECT_TO_CAMERA)
    assert found.scores.tolist() == [3.5] and judged(found.made_by)[0] == "forbidden"
    with pytest.raises(Exception, match="fewer than 4 pixels of the mask"):
        BundlePoses(client).estimate_pose(FRAMES[0], np.full(Z.shape, 0.05, np.float32), K, MASK, truth.box_glb())


@pytest.mark.parametrize(
    ("which", "labels"), [("p3sam", [0, -1, 1, 1]), ("samesh", [0, 1, 0, 1]), ("partfield", [1, 0, 1, 0])]
)
def test_models_of_parts(which: str, labels: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    _more(monkeypatch)
    assert CALLS["parts"](server("mesh_parts", monkeypatch, which)).labels.tolist() == labels


def test_particulate_finds_joints_of_the_parts_of_the_request(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, module in stub_particulate.particulate():
        monkeypatch.setitem(sys.modules, name, module)
    model = BundleMeshes(server("particulate", monkeypatch))
    vertices = np.concatenate([QUAD + [0, 0, 0.3 * k] for k in (0, 1)])
    faces = np.concatenate([FACES, FACES[:1] + 4])
    labels = np.array([2, 4, 1, 3, 0], np.int32)  # body, door, its handle, a drawer, and a part that does not move
    slide, turn = model.estimate_joints(vertices, faces, labels).joints
    assert (turn.part, turn.others, turn.parent, turn.type) == (4, (1,), -1, "revolute")
    assert (turn.lower, turn.upper) == (0.0, 1.5)
    off = np.cross(np.subtract(turn.origin, [0.1, 0, 0]), turn.axis)
    np.testing.assert_allclose([*off, *turn.axis], [0, 0, 0, 0, 0, 1], atol=1e-9)
    size = float(np.ptp(vertices, axis=0).max())
    assert (slide.part, slide.others, slide.type) == (3, (), "prismatic")
    assert slide.upper == pytest.approx(0.2 * size) and slide.axis == (1, 0, 0)
    found = model.estimate_joints(vertices, faces, labels)
    assert judged(found.made_by)[0] == "forbidden", "PartField is for research only"


def test_void_and_an_image_editor(monkeypatch: pytest.MonkeyPatch) -> None:
    _more(monkeypatch)
    cleaned = CALLS["inpaint_video"](server("void", monkeypatch))
    assert len(cleaned.frames) == 3 and (cleaned.frames[2][~MASK] == FRAMES[2][~MASK]).all()
    editor = server("image_edit", monkeypatch)
    edited = CALLS["edit"](editor)
    assert edited.image.shape == (80, 96, 4)
    filled = CALLS["inpaint"](editor).image
    assert (filled[~MASK] == FRAMES[0][~MASK]).all() and filled[MASK].mean() == pytest.approx(128, abs=12)


def test_splatfacto_trains_in_the_frame_of_the_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    found = CALLS["splat"](server("splatfacto", monkeypatch)).gaussians
    camera_to_world = np.linalg.inv(truth.POSES[0])
    np.testing.assert_allclose(found.positions[0], camera_to_world[:3, 3], atol=1e-5)
    np.testing.assert_allclose(found.positions[1], camera_to_world[:3, 3] + camera_to_world[:3, 2], atol=1e-5)
    height = FRAMES[0].shape[0]
    np.testing.assert_allclose(found.harmonics[0, 0], [K[0, 0], K[0, 2] + 0.5, height], rtol=1e-6)


def test_every_server_names_a_model_of_the_table() -> None:
    files = {path.stem for path in SERVERS.glob("*.py")} - {"scaffold"}
    assert all(name.startswith("serve_") for name in files), "other names would hide the packages that servers import"
    for name in sorted(files):
        module: Any = importlib.import_module(name)
        models: list[Model] = list(module.MODELS.values()) if hasattr(module, "MODELS") else [module.MODEL]
        for model in models:
            entry = find_licence(str(model.identity["name"]))
            assert entry is not None and set(model.tasks) <= set(entry.task), name
            said = model.identity["commercial"]
            assert (entry.commercial == "allowed") == (said is True) and (entry.commercial == "forbidden") == (
                said is False
            )


def test_a_server_runs_where_simfoundry_is_not_installed(tmp_path: Path) -> None:
    for file in (SERVERS / "scaffold.py", Path(wire.__file__)):
        shutil.copy(file, tmp_path)
    (tmp_path / "serve_toy.py").write_text(
        "import sys\nsys.modules['simfoundry'] = None\nimport numpy as np\nfrom scaffold import Model, Result, run\n"
        "def depth(request):\n"
        "    print('a library prints')\n"
        "    shape = request.members['image'].pixels.shape[:2]\n"
        "    return Result({'depth': np.full(shape, 2.0, np.float32)}, {'depth': {'unit': 'm'}})\n"
        "identity = {'name': 'toy', 'version': '1', 'licence': 'MIT', 'commercial': True}\n"
        "sys.exit(run(Model(identity, {'depth': depth})))\n"
    )
    process = ProcessTransport((sys.executable, str(tmp_path / "serve_toy.py")))
    found = BundleDepth(ModelClient(process)).estimate_depth(FRAMES[0])
    assert (found.depth == 2).all() and found.made_by.name == "toy"
