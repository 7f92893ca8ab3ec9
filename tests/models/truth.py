"""A model that knows the truth of one synthetic scene, and answers every task with it; and ways to answer wrongly.

The scene is a tilted, textured plane with a box before it, seen by cameras with known poses. The module is also a
server of its own: ``python -m tests.models.truth`` answers one request on its standard input.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from scaffold import Model, Result, run

from simfoundry.models.contract import CAMERA, MESH
from simfoundry.models.wire import Bundle, BundleFile, BundleImage

WIDTH, HEIGHT = 64, 48
K = np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]])
BASELINE = 0.06
BOX = (24, 16, 40, 32)  # [column, row, column, row] of the box in the first image
IDENTITY = {"name": "truth", "version": "1.0", "licence": "Apache-2.0", "commercial": True}


def _hash(x: Any, y: Any) -> Any:
    """Return a texture that differs from place to place, in 0 to 1."""
    return 0.5 + 0.25 * np.sin(37 * x + 3 * y) + 0.25 * np.sin(29 * y - 5 * x)


def view(X_world_to_camera: Any = None) -> tuple[Any, Any]:
    """Return the image and the depth of the scene, seen by a camera."""
    X = np.linalg.inv(np.eye(4) if X_world_to_camera is None else X_world_to_camera)
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1) @ X[:3, :3].T
    eye = X[:3, 3]
    depth, shade = np.full(u.shape, np.inf), np.zeros(u.shape)
    for normal, offset, bounds in (((0.1, -0.3, 1.0), 1.2, None), ((0.0, 0.0, 1.0), 0.8, 0.12)):
        t = (offset - eye @ np.array(normal)) / (rays @ np.array(normal))
        hit = eye + t[..., None] * rays
        inside = np.ones(u.shape, bool) if bounds is None else (np.abs(hit[..., :2]) < bounds).all(axis=-1)
        nearer = inside & (t > 0) & (t < depth)
        depth[nearer], shade[nearer] = t[nearer], _hash(hit[..., 0], hit[..., 1] + offset)[nearer]
    gray = (40 + 180 * shade).astype(np.uint8)
    return np.dstack([gray, (gray * 0.7).astype(np.uint8), 255 - gray]), depth.astype(np.float32)


def moved(dx: float, degrees: float) -> Any:
    """Return the world-to-camera transform of a camera to the right that is turned toward the scene."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    X = np.array([[c, 0, s, dx], [0, 1, 0, 0.02], [-s, 0, c, 0.03], [0, 0, 0, 1]])
    return np.linalg.inv(X)


FRAME = BundleImage(view()[0])
POSES = np.stack([np.eye(4), moved(0.25, -14.0), moved(0.45, -26.0)])
MASK = np.zeros((HEIGHT, WIDTH), bool)
MASK[BOX[1] : BOX[3], BOX[0] : BOX[2]] = True


def box_glb(size: tuple[float, float, float] = (0.2, 0.1, 0.3)) -> bytes:
    """Return a box as GLB [m], off the center of its frame."""
    import trimesh

    mesh = trimesh.creation.box(size)
    mesh.apply_translation((0.02, 0.05, 0.01))
    return bytes(mesh.export(file_type="glb"))


# The pose of the box in the camera: turned about two axes, in the middle of MASK.
OBJECT_TO_CAMERA = np.array([
    [0.8660254, 0.0, 0.5, -0.02], [0.3535534, -0.7071068, -0.6123724, 0.0], [0.3535534, 0.7071068, -0.6123724, 0.8],
    [0, 0, 0, 1],
])  # fmt: skip


def splat_ply(positions: Any, colors: Any = 0.5) -> bytes:
    """Return a splat with Gaussians at the given positions, with colors in [0, 1], as PLY."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", *(f"scale_{k}" for k in range(3))]
    names += [f"rot_{k}" for k in range(4)]
    head = "".join(f"property float {name}\n" for name in names)
    rows = np.zeros((len(positions), len(names)), np.float32)
    rows[:, :3], rows[:, 7:10], rows[:, 10] = positions, -4, 1
    rows[:, 3:6] = (np.asarray(colors) - 0.5) / 0.28209479
    text = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{head}end_header\n"
    return text.encode() + rows.tobytes()


def _noted(unit: str, frame: str = CAMERA) -> dict[str, str]:
    return {"unit": unit, "frame": frame}


def depth(request: Bundle) -> Result:
    return Result({"depth": view()[1], "K": K}, {"depth": _noted("m")}, confidence=0.9, warnings=("a remark",))


def multiview(request: Bundle) -> Result:
    images = request.members["images"]
    assert isinstance(images, tuple)
    depths = np.stack([view(X)[1] for X in POSES[: len(images)]])
    return Result({"depth": depths, "K": np.stack([K] * len(images)), "world_to_camera": POSES[: len(images)]})


def stereo(request: Bundle) -> Result:
    z = view()[1]
    return Result({"disparity": (K[0, 0] * BASELINE / z).astype(np.float32), "depth": z, "valid": z > 0})


def complete_depth(request: Bundle) -> Result:
    return Result({"depth": view()[1]})


def segment(request: Bundle) -> Result:
    phrases = request.head["parameters"].get("phrases", [])
    if phrases and phrases[0] == "unicorn":
        none = np.zeros((0, HEIGHT, WIDTH), bool), np.zeros((0, 4), np.float32), np.zeros(0, np.float32)
        return Result(dict(zip(("masks", "boxes", "scores", "prompts"), (*none, np.zeros(0, np.int32)), strict=True)))
    boxes = np.array([BOX], np.float32)
    one = np.array([0.9], np.float32)
    return Result({"masks": MASK[None], "boxes": boxes, "scores": one, "prompts": np.zeros(1, np.int32)})


def track(request: Bundle) -> Result:
    frames, masks = request.members["frames"], request.members["masks"]
    assert isinstance(frames, tuple) and isinstance(masks, np.ndarray)
    shifted = np.stack([np.roll(masks, t, axis=2) for t in range(len(frames))])
    return Result({"masks": np.packbits(shifted, axis=-1)})


def _filled(picture: Any, mask: Any) -> BundleImage:
    pixels = picture.pixels.copy()
    pixels[mask] = 128
    return BundleImage(pixels)


def inpaint(request: Bundle) -> Result:
    return Result({"image": _filled(request.members["image"], request.members["mask"])})


def inpaint_video(request: Bundle) -> Result:
    frames: Any = request.members["frames"]
    masks: Any = request.members["masks"]
    return Result({"frames": tuple(_filled(frame, mask) for frame, mask in zip(frames, masks, strict=True))})


def edit(request: Bundle) -> Result:
    image: Any = request.members["image"]
    return Result({"image": BundleImage(np.ascontiguousarray(image.pixels[::-1]))})


def mesh(request: Bundle) -> Result:
    return Result({"mesh": BundleFile("glb", box_glb())}, {"mesh": {"frame": MESH}})


def parts(request: Bundle) -> Result:
    faces: Any = request.members["faces"]
    return Result({"labels": (np.arange(len(faces)) % 2).astype(np.int32)})


def articulate(request: Bundle) -> Result:
    joint = {"part": 1, "type": "revolute", "axis": [0, 0, 1], "origin": [0.1, 0, 0], "lower": 0, "upper": 1.5}
    return Result(values={"joints": [joint]})


def pose(request: Bundle) -> Result:
    return Result({"object_to_camera": OBJECT_TO_CAMERA[None], "scores": np.array([1.0])})


def read_scene(request: Bundle) -> Result:
    seen = {"phrase": "gray box", "category": "box", "box": list(BOX), "mass": 0.3}
    return Result(values={"objects": [seen], "support": "table"})


def splat(request: Bundle) -> Result:
    return Result({"splat": BundleFile("ply", splat_ply(request.members["points"]))})


def splat_image(request: Bundle) -> Result:
    image, z = view()
    return Result({"image": BundleImage(image), "depth": z, "alpha": np.ones(z.shape, np.float32)})


SOLVERS: dict[str, Callable[[Bundle], Result]] = {f.__name__: f for f in (
    depth, multiview, stereo, complete_depth, segment, track, inpaint, inpaint_video, edit, mesh, parts, articulate,
    pose, read_scene, splat, splat_image,
)}  # fmt: skip

TRUTH = Model(IDENTITY, SOLVERS)


def broken(task: str, change: Callable[[Result], object]) -> Model:
    """Return a model that spoils its answers for a task."""

    def solve(request: Bundle) -> Result:
        result = SOLVERS[task](request)
        change(result)
        return result

    return Model(IDENTITY, {task: solve})


def png(pixels: Any) -> bytes:
    """Return an image as PNG."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG")
    return stream.getvalue()


if __name__ == "__main__":
    sys.exit(run(TRUTH))
