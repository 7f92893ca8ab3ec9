"""``simfoundry articulate``: an asset with a joint from two captures of an object, shut and open."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.capture.articulation.asset import ArticulatedParts, articulated_parts
from simfoundry.capture.articulation.estimate import WHOLE, JointEstimate, StatedPart, amount_about, estimate_joint
from simfoundry.capture.articulation.evidence import FEWEST
from simfoundry.capture.articulation.ground import find_ground
from simfoundry.capture.articulation.views import PosedView, Sight
from simfoundry.capture.frame import CaptureError, Frame
from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.errors import SimfoundryError
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Pose
from simfoundry.models.setup import ModelSetup
from simfoundry.runtime.files import MARK, write_atomically
from simfoundry.scene.lower import pose
from simfoundry.scene.model import JointType
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.capture import CaptureSpec, Shot
from simfoundry.spec.yaml.write import to_yaml

# Lowest height of an object's points above its support [m]: three standard deviations of depth at 1 m.
ABOVE = 0.01

# Distance from what changed within which points belong to the object [m].
AROUND = 0.35

# Smallest share of the support that both views must see at the same place, so that the camera can have stayed.
STAYED = 0.5

# One in so many points of the support is checked, which is enough to estimate a share.
STRIDE = 7

# A stated pixel stands for those within this distance [px], because depth is missing or wrong at edges. Two pixels of a
# hinge must be at least so far apart [m] that noise does not turn the axis between them.
NEARBY, SHORTEST = 3, 0.03

# A pixel: column and row.
Pixel = tuple[int, int]

# Color of the part in the picture, which is rare on tables.
TINT = np.array([255.0, 40.0, 200.0])

# The `note` of an asset.
ASSUMED = "assumed: wood, walls, panels and the inside; the range is what was seen, from shut to open"

# A joint that explains less than this share of new surface is an accident.
LEAST = 0.05

# Confidence is doubtful below this share of explained surface, or if another type of joint explains nearly as much.
DOUBTFUL, CLOSE = 0.25, 0.8

# Largest share of the changed surface that may have another cause than the part. Single parts left at most 0.22 (the
# drawer of a real cabinet; 0.16 among 20 random pieces of furniture); a second part, or a cabinet that moved, leaves
# more.
UNCLAIMED = 0.3


@dataclass(frozen=True, eq=False)
class Articulated:
    """The result of two captures.

    Attributes:
        path: The asset document.
        estimate: The joint.
        parts: The asset and its pose in the first capture.
        X_WC: The pose of the first camera in a world frame on the support.
        doubt: The reason to look at the picture before trusting the joint, or an empty string.
    """

    path: Path
    estimate: JointEstimate
    parts: ArticulatedParts
    X_WC: Pose
    doubt: str

    def to_json(self) -> dict[str, Any]:
        """Return the result as data for JSON."""
        joint = next(iter(self.parts.data["joints"].values()))
        return {
            "asset": str(self.path),
            "picture": str(picture_of(self.path)),
            "type": joint["type"],
            "axis": joint["axis"],
            "pivot": joint["pose"]["xyz"],
            "range": joint.get("limits") or joint["limits_deg"],
            "explained": self.estimate.explained,
            "snapped": self.estimate.is_snapped,
            "runner_up": self.estimate.runner_up,
            "X_WA": {"xyz": self.parts.X_WA.p.tolist(), "quat": self.parts.X_WA.q.tolist()},
            "doubt": self.doubt,
        }

    def summary(self) -> str:
        """Return the result in a few lines."""
        data = self.to_json()
        unit = "deg" if data["type"] == "revolute" else "m"
        axis = ", ".join(f"{value:.3f}" for value in data["axis"])
        kind = f"{data['type']} joint, {data['range'][1]:.3g} {unit}, axis [{axis}]"
        snap = " (an axis of its box)" if data["snapped"] else ""
        lines = [
            f"{self.path}  {kind}{snap}",
            f"explains {data['explained']:.0%} of what is new; see {data['picture']}",
        ]
        return "\n".join([*lines, *([f"doubtful: {self.doubt}"] if self.doubt else [])])


def articulate(
    shut: Path,
    opened: Sequence[Path],
    out: Path,
    frame: str | None = None,
    progress: Callable[[str, float], None] | None = None,
    hinge: tuple[Pixel, Pixel] | None = None,
    box: tuple[int, int, int, int] | None = None,
    setup: ModelSetup | None = None,
) -> Articulated:
    """Estimate the joint of an object from captures of it, and write it as an asset, with a picture beside it.

    Args:
        shut: The capture in which the joint is at its zero position.
        opened: The captures in which the part has moved. The one that shows the motion best decides on the joint, and
            the range reaches to the farthest.
        out: The asset document to write.
        frame: The name of the frame in both captures; by default, the first.
        progress: A callback that receives a description and the fraction that is done.
        hinge: Two pixels [column, row] on the hinge in the first capture, if it is known; it always wins.
        box: The rectangle [left, top, right, bottom] around the part in the first capture [px], if it is known.
        setup: The models for captures without depth; by default, those that are configured for each capture.

    Raises:
        SpecError: If a capture has errors.
        SimfoundryError: If the views do not belong together, or nothing moved.
    """
    show = progress or (lambda text, share: None)
    show("reading the captures", 0.0)
    loaded = [open_capture(path) for path in (shut, *opened)]
    frames = [load_frame(each, frame, setup) for each in loaded]
    try:
        X_WC = find_ground(frames[0]).X_WC
    except CaptureError as error:
        raise SpecError([loaded[0].finding(error.code, ("frames",), error.message, error.hint)]) from None
    poses = (X_WC, *(X_WC @ _between(loaded[0], other, frame) for other in loaded[1:]))
    views = [_above_support(PosedView.of(each, X)) for each, X in zip(frames, poses, strict=True)]
    stated = _stated(views[0], hinge, box)
    found = []
    for k, view in enumerate(views[1:]):
        show("finding the joint", 0.2 + 0.7 * k / len(opened))
        _check_place(views[0], view)
        first, second = _near_the_change(views[0], view)
        found.append((estimate_joint(first, second, stated), first, second, frames[k + 1]))
    estimate, first, second, best_frame = max(found, key=lambda each: each[0].explained)
    amounts = [amount_about(estimate.motion, *each[1:3]) for each in found if each[0] is not estimate]
    farthest = replace(estimate, motion=replace(estimate.motion, q=max([estimate.motion.q, *amounts])))
    if hinge is None and estimate.explained < LEAST:
        raise SimfoundryError(
            f"no joint explains what changed between the captures (the best one explains {estimate.explained:.0%}): "
            "open one part of the object, and leave everything else where it is; if you did, state its hinge"
        )
    if not estimate.part.any():
        raise SimfoundryError(
            "the part that moved cannot be told from the rest of the object; capture it from where its front is visible"
        )
    show("writing the asset", 0.9)
    name = plain_name(out.name.split(".")[0])
    origin = {
        "capture": ", ".join(path.resolve().name for path in (shut, *opened)),
        "confidence": estimate.explained,
        "note": ASSUMED,
    }
    parts = articulated_parts(farthest, first.points[first.mask], first.points[estimate.part], name, origin)
    text = to_yaml(AssetSpec.model_validate(parts.data), comment=MARK)
    write_atomically(out, text.encode())
    write_atomically(picture_of(out), _picture([frames[0], best_frame], estimate, (first, second)))
    about_depth = [finding.message for each in frames for finding in each.findings]
    doubt = _doubt(estimate, hinge is not None, box is not None) or next(iter(about_depth), "")
    return Articulated(out, estimate, parts, X_WC, doubt)


def _stated(
    view: PosedView, hinge: tuple[Pixel, Pixel] | None, box: tuple[int, int, int, int] | None
) -> StatedPart | None:
    """Return what a person states, in the world.

    Raises:
        SimfoundryError: If the pixels are outside of the image, or there is no depth at them.
    """
    if hinge is None and box is None:
        return None
    h, w = view.depth.shape
    ends = []
    outside = [f"{u},{v}" for u, v in hinge or () if not (0 <= u < w and 0 <= v < h)]
    if outside:
        raise SimfoundryError(f"the pixel {outside[0]} of the hinge is not in the image, which has {w} x {h} pixels")
    for u, v in hinge or ():
        around = view.points[max(0, v - NEARBY) : v + NEARBY + 1, max(0, u - NEARBY) : u + NEARBY + 1].reshape(-1, 3)
        around = around[np.isfinite(around).all(axis=1)]
        if not len(around):
            raise SimfoundryError(f"there is no depth at the pixel {u},{v} of the hinge; name another one on the edge")
        ends.append(np.median(around, axis=0))
    if ends and np.linalg.norm(ends[1] - ends[0]) < SHORTEST:
        raise SimfoundryError("the two pixels of the hinge are at the same place; name the two ends of the edge")
    mask = None
    if box is not None:
        left, top, right, bottom = box
        if not (0 <= left < right <= w and 0 <= top < bottom <= h):
            raise SimfoundryError(f"the box must be left,top,right,bottom in an image of {w} x {h} pixels")
        mask = np.zeros((h, w), np.bool_)
        mask[top:bottom, left:right] = True
    return StatedPart(np.array(ends) if ends else None, mask)


def picture_of(asset: Path) -> Path:
    """Return the path of the picture beside an asset."""
    return asset.with_name(f"{asset.name.removesuffix('.yaml').removesuffix('.asset')}.png")


def _between(loaded: Loaded, other: Loaded, frame: str | None) -> Pose:
    """Return the pose of the second camera in the frame of the first. Without poses, the camera stayed where it was."""
    shots = [_shot(each, frame) for each in (loaded, other)]
    poses = [None if shot.pose is None else pose(shot.pose) for shot in shots]
    if poses[0] is None or poses[1] is None:
        if poses[0] is not poses[1]:
            raise SimfoundryError(
                "one capture states the `pose` of its camera and the other does not; state both or none"
            )
        return Pose.of()
    return poses[0].inverse() @ poses[1]


def _shot(loaded: Loaded, frame: str | None) -> Shot:
    assert isinstance(loaded.spec, CaptureSpec)
    return loaded.spec.frames[frame or next(iter(loaded.spec.frames))]


def _above_support(view: PosedView) -> PosedView:
    """Return a view in which only what stands on the support, the plane z = 0, may belong to the object."""
    with np.errstate(invalid="ignore"):
        return replace(view, mask=view.mask & (view.points[:, :, 2] > ABOVE))


def _check_place(first: PosedView, second: PosedView) -> None:
    """Check that the support is at the same place in both views."""
    flat = np.isfinite(first.depth) & (np.abs(first.points[:, :, 2]) < ABOVE)
    sight = second.sight(first.points[flat][::STRIDE])
    known = sight[sight != Sight.HIDDEN]
    if len(known) < FEWEST or (known == Sight.SEEN).mean() < STAYED:
        raise SimfoundryError(
            "the second capture does not show the support where the first one shows it: leave the camera where it is "
            "between the captures, or state its `pose` in both, in a frame that does not move"
        )


def _near_the_change(first: PosedView, second: PosedView) -> tuple[PosedView, PosedView]:
    """Return views in which only what is around the change may belong to the object."""
    changed = [
        one.points[one.mask][other.sight(one.points[one.mask]) == Sight.FREE]
        for one, other in ((first, second), (second, first))
    ]
    points = np.concatenate(changed)
    if len(points) < FEWEST:
        return first, second  # the estimate says that nothing moved
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    found = []
    for view in (first, second):
        with np.errstate(invalid="ignore"):
            near = ((view.points > low - AROUND) & (view.points < high + AROUND)).all(axis=2)
        found.append(replace(view, mask=view.mask & near))
    return found[0], found[1]


def _doubt(estimate: JointEstimate, is_stated: bool, is_boxed: bool) -> str:
    """Return the reason for a person to look at the result, or an empty string.

    A hinge that a person states, ``is_stated``, may have any direction. Outside of a part that a person has boxed,
    ``is_boxed``, anything may have changed.
    """
    is_turn = estimate.motion.kind is JointType.REVOLUTE
    if estimate.is_reversed:
        return "the part stands out most in the first capture, which must show it shut; are the captures in this order?"
    if estimate.is_out_of_sight:
        return "the part reaches the border of the second image, so that it may have moved farther"
    if is_turn and estimate.is_cut and estimate.reached < WHOLE:
        return "the part reaches the border of the second image, so that its front may be out of sight"
    if estimate.explained < DOUBTFUL:
        return f"the joint explains only {estimate.explained:.0%} of the surface that is new in the second capture"
    if not is_boxed and estimate.unclaimed > UNCLAIMED:
        return (
            f"{estimate.unclaimed:.0%} of what changed is not due to this part: open one part of the object, and leave "
            "everything else where it is"
        )
    if not is_stated and not estimate.is_snapped:
        return "the axis is along none of the object's box, which is rare for furniture"
    if estimate.runner_up > CLOSE:
        return "a joint of another type, or another hinge, explains the captures nearly as well"
    return ""


def _picture(frames: list[Frame], estimate: JointEstimate, views: tuple[PosedView, PosedView]) -> bytes:
    """Return a PNG of both color images with the part in them, where it was and where the joint brings it."""
    from PIL import Image

    first, second = views
    usable = estimate.part & np.isfinite(first.normals).all(axis=2)
    start = first.points[usable] - estimate.motion.back * first.normals[usable]
    shown = []
    for frame, view, points in (
        (frames[0], first, first.points[estimate.part]),
        (frames[1], second, estimate.motion.moved(start)),
    ):
        image = frame.color.astype(np.float64)
        u, v = view.pixels(points)
        inside = (u >= 0) & (v >= 0) & (u < image.shape[1]) & (v < image.shape[0])
        mask = np.zeros(image.shape[:2], np.bool_)
        mask[v[inside], u[inside]] = True
        image[mask] = 0.4 * image[mask] + 0.6 * TINT
        shown.append(image)
    height = max(image.shape[0] for image in shown)
    padded = [np.pad(image, ((0, height - image.shape[0]), (0, 0), (0, 0))) for image in shown]
    stream = io.BytesIO()
    Image.fromarray(np.hstack(padded).round().astype(np.uint8)).save(stream, "PNG")
    return stream.getvalue()
