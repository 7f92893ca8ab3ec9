"""Read folders of other data sets as captures: BOP scenes, ScanNet-like folders, and frames of 7-Scenes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.lower import pose
from simfoundry.scene.state import pose_spec
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.models.capture import CaptureSpec, DepthImage, Intrinsics, Shot

PICTURES = (".bmp", ".exr", ".heic", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
VIDEOS = (".avi", ".m4v", ".mov", ".mp4", ".webm")
RECORDINGS = (".bag", ".db3", ".mcap", ".r3d")
OTHER_RECORDINGS = (".klg", ".mkv", ".oni", ".svo", ".svo2")  # of vendors, which only their own software reads

# Maximum number of frames that are read, evenly spread over a sequence: fusion uses 16, and one is reconstructed.
FRAMES_MAX = 64

# Maximum size of a text file with cameras [bytes]: 100,000 frames of BOP take 30 MB.
TEXT_MAX = 50_000_000

# Cameras of the first Kinect as 7-Scenes uses them, whose images are not registered. Its authors state the intrinsics
# of the depth camera; those of the color camera and the offset between both [m] are the defaults of OpenNI. With them,
# the mugs of its red kitchen are where the color image shows them.
KINECT_DEPTH = Intrinsics(fx=585, fy=585, cx=320, cy=240)
KINECT_COLOR = Intrinsics(fx=525, fy=525, cx=320, cy=240)
KINECT_OFFSET = (-0.025, 0.0, 0.0)

NEEDED = "a capture needs, besides a color image, its depth and the intrinsics of the camera, stated in a capture.yaml"


def media_error(path: Path) -> SpecError | None:
    """Return an error that says what a picture, video or recording lacks to be a capture, or None for other files."""
    suffix = path.suffix.lower()
    if suffix in PICTURES:
        what = "is a picture"
        hint = (
            "put it into a folder with a capture.yaml and its depth: depth image, right image of a stereo pair, or "
            "a model of the task `depth`"
        )
    elif suffix in VIDEOS:
        what = "is a video"
        hint = (
            f"extract a frame that shows all objects, such as with `ffmpeg -i {path.name} -frames:v 1 color.png`, and "
            "put it into a folder with its depth and a capture.yaml"
        )
    elif suffix in RECORDINGS:
        what = "is a recording"
        hint = f"`simfoundry capture {path.name}` unpacks it into a folder with a capture.yaml"
    elif suffix in OTHER_RECORDINGS:
        what = "is a recording in a vendor's format"
        hint = (
            "export color and depth images and the intrinsics with the vendor's software, and describe them there; "
            f"recordings that can be read are {', '.join(RECORDINGS)}"
        )
    else:
        return None
    more = "; `simfoundry schema capture` prints all keys"
    return SpecError([Diagnostic("SF001", Severity.ERROR, f"{what}, but {NEEDED}", str(path), hint=hint + more)])


def foreign_capture(folder: Path) -> CaptureSpec | None:
    """Return the capture that a folder of another data set contains, or None if its layout is unknown.

    Raises:
        SimfoundryError: The layout is known, but a file in it cannot be read.
    """
    for is_layout, frames in _LAYOUTS:
        if is_layout(folder):
            shots = frames(folder)
            if not shots:
                raise SimfoundryError(f"{folder} contains no frame with both a color and a depth image")
            description = f"{len(shots)} frames, read from the files of another data set."
            name = plain_name(folder.resolve().name) or "capture"
            return CaptureSpec(simfoundry="capture/1", name=name, description=description, frames=shots)
    return None


def scene_folder(folder: Path) -> Path | None:
    """Return a folder in ``folder`` that is a capture or has the layout of another data set, or None."""
    try:
        inner = sorted(path for path in folder.iterdir() if path.is_dir())[:FRAMES_MAX]
    except OSError:
        return None
    is_scene = (
        any(is_layout(path) for is_layout, _ in _LAYOUTS) or (path / "capture.yaml").is_file() for path in inner
    )
    return next((path for path, found in zip(inner, is_scene, strict=True) if found), None)


def _bop(folder: Path) -> dict[str, Shot]:
    """Return the frames of a scene in the BOP format, with lengths in millimeters."""
    file = folder / "scene_camera.json"
    cameras = _parsed(file, json.loads)
    if not isinstance(cameras, dict):
        raise SimfoundryError(f"{file} does not contain cameras by image")
    shots = {}
    for key in _spread(sorted(cameras, key=lambda k: (len(k), k))):
        stem = f"{int(key):06d}" if key.isdigit() else key
        color, depth = (_image(folder, part, stem) for part in ("rgb", "depth"))
        if color is None or depth is None:
            continue
        camera = cameras[key]
        try:
            K = np.array(camera["cam_K"], dtype=float).reshape(3, 3)
            scale = float(camera.get("depth_scale", 1.0))
            X_CW = np.eye(4)
            known = "cam_R_w2c" in camera and "cam_t_w2c" in camera
            if known:
                X_CW[:3, :3] = np.array(camera["cam_R_w2c"], dtype=float).reshape(3, 3)
                X_CW[:3, 3] = np.array(camera["cam_t_w2c"], dtype=float) / 1000
            X_WC = _pose(np.asarray(np.linalg.inv(X_CW), dtype=np.float64)) if known else None
            image = DepthImage(image=depth, scale=0.001 * scale)
        except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
            reason = " ".join(str(error).split("\n")[0].split())
            raise SimfoundryError(f"{file} has no valid camera for the image {key}: {reason}") from None
        shots[f"f{stem}"] = Shot(color=color, depth=image, camera=_intrinsics(K, file), pose=X_WC)
    return shots


def _scannet(folder: Path) -> dict[str, Shot]:
    """Return the frames of a folder with `color`, `depth`, `pose` and `intrinsic`, as ScanNet's exporter writes it."""
    color_file, depth_file = (folder / "intrinsic" / f"intrinsic_{kind}.txt" for kind in ("color", "depth"))
    K, K_depth = (_intrinsics(_matrix(file), file) for file in (color_file, depth_file))
    stems = sorted((p.stem for p in (folder / "depth").iterdir() if p.is_file()), key=lambda s: (len(s), s))
    shots = {}
    for stem in _spread(stems):
        color, depth = (_image(folder, part, stem) for part in ("color", "depth"))
        if color is None or depth is None:
            continue
        own = None if K_depth == K else K_depth
        image = DepthImage(image=depth, camera=own, pose=None if own is None else PoseSpec())
        shots[f"f{stem}"] = Shot(color=color, depth=image, camera=K, pose=_stated_pose(folder / "pose" / f"{stem}.txt"))
    return shots


def _seven_scenes(folder: Path) -> dict[str, Shot]:
    """Return the frames `frame-N.color`, `.depth` and `.pose` of one folder, as 7-Scenes has them.

    The data set states one camera for all folders; a file in the folder is used instead.
    """
    file = folder / "camera-intrinsics.txt"
    K = _intrinsics(_matrix(file), file) if file.exists() else KINECT_DEPTH
    own = K if K == KINECT_DEPTH else None
    color_camera = K if own is None else KINECT_COLOR
    stems = sorted(p.name.removesuffix(".depth.png") for p in folder.glob("frame-*.depth.png"))
    shots = {}
    for stem in _spread(stems):
        color = next((f"{stem}.color{s}" for s in (".png", ".jpg") if (folder / f"{stem}.color{s}").is_file()), None)
        if color is None:
            continue
        offset = None if own is None else PoseSpec(xyz=KINECT_OFFSET)
        image = DepthImage(image=f"{stem}.depth.png", invalid=(0, 65535), camera=own, pose=offset)
        X_WC = _stated_pose(folder / f"{stem}.pose.txt")
        if X_WC is not None and offset is not None:  # it is that of the depth camera, which was tracked
            X_WC = pose_spec(pose(X_WC) @ pose(offset).inverse())
        name = re.sub(r"\W", "_", stem)
        shots[name] = Shot(color=color, depth=image, camera=color_camera, pose=X_WC)
    return shots


_Layout = tuple[Callable[[Path], bool], Callable[[Path], dict[str, Shot]]]

_LAYOUTS: tuple[_Layout, ...] = (
    (lambda folder: (folder / "scene_camera.json").is_file(), _bop),
    (lambda folder: (folder / "intrinsic" / "intrinsic_depth.txt").is_file() and (folder / "depth").is_dir(), _scannet),
    (lambda folder: next(folder.glob("frame-*.depth.png"), None) is not None, _seven_scenes),
)


def _spread(names: Iterable[str]) -> list[str]:
    """Return at most :data:`FRAMES_MAX` names, evenly spread."""
    every = list(names)
    step = max(1.0, len(every) / FRAMES_MAX)
    return [every[int(k * step)] for k in range(min(len(every), FRAMES_MAX))]


def _image(folder: Path, part: str, stem: str) -> str | None:
    """Return the path of an image relative to the folder, or None if there is none."""
    return next((f"{part}/{stem}{s}" for s in PICTURES if (folder / part / f"{stem}{s}").is_file()), None)


def _parsed(file: Path, parse: Callable[[str], Any]) -> Any:
    try:
        if file.stat().st_size > TEXT_MAX:
            raise SimfoundryError(f"{file} is larger than {TEXT_MAX // 1_000_000} MB, which no list of cameras is")
        return parse(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise SimfoundryError(f"{file} could not be read: {error}") from None


def _matrix(file: Path) -> Array:
    """Return a matrix of shape (3, 3) or (4, 4) from a text file."""

    def parse(text: str) -> Array:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
        side = {9: 3, 16: 4}.get(len(values))
        if side is None:
            raise ValueError(f"it has {len(values)} numbers, and a matrix has 9 or 16")
        return values.reshape(side, side)

    matrix: Array = _parsed(file, parse)
    return matrix


def _intrinsics(K: Array, file: Path) -> Intrinsics:
    try:
        fx, fy, cx, cy = (float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy)
    except ValueError:
        raise SimfoundryError(f"{file} does not contain the intrinsics of a camera: {K.tolist()}") from None


def _stated_pose(file: Path) -> PoseSpec | None:
    """Return the camera pose in a text file, or None if there is no such file."""
    return _pose(_matrix(file)) if file.exists() else None


def _pose(X_WC: Array) -> PoseSpec | None:
    """Return a camera pose, or None where tracking was lost, which data sets mark by infinite or zero matrices."""
    if X_WC.shape != (4, 4) or not np.isfinite(X_WC).all():
        return None
    turn = X_WC[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 0.01 or np.linalg.det(turn) < 0:
        return None
    return pose_spec(Pose.from_matrix(X_WC))
