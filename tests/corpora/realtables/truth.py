"""What is known for certain about some of the captures, and how far a reconstruction is from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frames.load import load_frame
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import tessellate
from simfoundry.render.raycast import raycast
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.spec.load import load_capture
from tests.corpora.realtables.documents import RealCapture
from tests.corpora.segmentation import matched_iou

CRACKER_BOX_HEIGHT = {"posecnn_demo_000001": 0.164, "posecnn_demo_000005": 0.213}
"""Height of the cracker box of the YCB objects [m], 0.072 x 0.164 x 0.213: in the first picture it lies on its side."""

STANDING = frozenset({"posecnn_demo_000005"})
"""Where it stands, and its height is promised. Where it lies its height is a figure without a bar: the depth of that
picture reads about 4% short everywhere (mustard bottle, soup can and box alike), and the fit follows the depth."""

RED_SHARE = 0.4
"""An object is red if this share of what the photograph shows in its place is."""

Labels = NDArray[np.int32]


def true_labels(capture: RealCapture) -> Labels | None:
    """Instance numbers that people drew, 0 where there is no object, shape (h, w); None where nobody did."""
    import cv2

    if "label_image" not in capture.entry:
        return None
    raw = np.asarray(cv2.imread(str(capture.folder / capture.entry["label_image"]), cv2.IMREAD_UNCHANGED), np.int32)
    return np.where(raw >= 20, raw // 10 - 1, 0).astype(np.int32)


def found_labels(document: Path) -> Labels:
    """What the stages of the command find in a capture folder; the command keeps no labels itself."""
    frame = load_frame(load_capture(document / "capture.yaml"))
    labels: Labels = decompose(frame, find_support(frame)).labels
    return labels


def overlaps(truth: Labels, found: Labels) -> list[float]:
    """IoU of each matched pair of objects."""
    return [float(v) for v in matched_iou(truth, found)] if found.any() else []


def count(labels: Labels) -> int:
    """How many objects there are."""
    return len(np.unique(labels[labels > 0]))


def cracker_box(scene: Scene, photograph: NDArray[np.uint8]) -> tuple[str, float] | None:
    """Name and height [m] of the cracker box: the tallest recovered object that the photograph shows red.

    The place of an object in the photograph is where the scene's own camera sees it, so neither its name nor its size
    has a say, but an object that stands in the wrong place is not found.
    """
    seen = raycast(scene, scene.cameras[0]).objects
    r, g, b = np.moveaxis(photograph.astype(np.int32), -1, 0)
    red = (r > 60) & (r > 2 * g) & (r > 2 * b)
    candidates = []
    for k, item in enumerate(scene.objects):
        place = seen == k + 1
        if not item.fixed and place.any() and red[place].mean() >= RED_SHARE:
            candidates.append((item.name, float(np.ptp(_points(item, item.X_WO)[:, 2]))))
    return max(candidates, key=lambda pair: pair[1], default=None)


def photograph(capture: RealCapture) -> NDArray[np.uint8]:
    """The color picture, uint8 RGB, shape (h, w, 3)."""
    import cv2

    picture = np.asarray(cv2.imread(str(capture.folder / capture.entry["rgb"])), np.uint8)
    return np.ascontiguousarray(picture[..., ::-1])


def bottle(capture: RealCapture, scene: Scene) -> tuple[str, float]:
    """The recovered object nearest to the bottle whose pose is known, and how far apart their centers are [m].

    A center is that of the bounding box in the object's own axes.
    """
    import trimesh

    known = capture.entry["objects"][0]
    mesh = trimesh.load(capture.folder / known["mesh"], force="mesh", process=False)
    X_WM = scene.cameras[0].X_WC @ Pose.from_matrix(np.array(known["T_cam_obj"], dtype=np.float64))
    p_true = X_WM.apply(np.asarray(mesh.bounds, dtype=np.float64).mean(axis=0))
    distances = {item.name: float(np.linalg.norm(_center(item) - p_true)) for item in scene.objects if not item.fixed}
    name = min(distances, key=lambda n: distances[n])
    return name, distances[name]


def _points(item: SceneObject, X_AO: Pose) -> Array:
    """Vertices of what an object of one link looks like [m], in the frame A, shape (n, 3)."""
    shown = [(X_AO @ v.X_LG).apply(tessellate(v.geometry).vertices) for v in item.root.visuals]
    return np.concatenate(shown)


def _center(item: SceneObject) -> Array:
    points = _points(item, Pose.of())
    return item.X_WO.apply((points.min(axis=0) + points.max(axis=0)) / 2)
