"""Fuse the depth of several posed frames in the view of one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simfoundry.capture.findings import MODEL_FAILED, UNUSED_FRAME, CaptureFinding
from simfoundry.capture.frame import Frame, depth_sigma
from simfoundry.capture.load import load_frame
from simfoundry.capture.sensors import register
from simfoundry.geometry.frames import Array, Pose
from simfoundry.models.setup import ModelSetup
from simfoundry.scene.lower import pose
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.capture import CaptureSpec

# Maximum difference of two readings of one surface, in standard deviations of a reading; noise exceeds it in 0.3 %.
SAME_SURFACE = 3.0

# Minimum share of the pixels that two frames both see at which their depth must agree. Occlusion leaves 93 % in the
# frames of `redkitchen`; a wrong pose leaves hardly any.
AGREEING = 0.5

# Least number of pixels that two frames must share for a judgment about the pose.
SHARED_MIN = 1000

# Least number of frames that must agree on the depth of a pixel at which the view itself has none.
WITNESSES = 2

# Maximum number of frames that are fused: noise falls with the square root, and each takes 0.2 s.
FRAMES_MAX = 16

HINT = "check its `pose`, or remove it if something has moved"


def fused_frames(spec: CaptureSpec, name: str) -> tuple[str, ...]:
    """Return the other frames whose depth is fused with that of the frame ``name``: those that have a pose, too.

    At most :data:`FRAMES_MAX` are used, evenly spread over all of them.
    """
    if spec.frames[name].pose is None:
        return ()
    others = [other for other, shot in spec.frames.items() if other != name and shot.pose is not None]
    step = max(1.0, len(others) / FRAMES_MAX)
    return tuple(others[int(k * step)] for k in range(min(len(others), FRAMES_MAX)))


def load_fused_frame(loaded: Loaded, name: str, setup: ModelSetup | None = None) -> Frame:
    """Load a frame of a capture, and fuse its depth with that of all other frames that have a pose.

    ``setup`` names the models of depth; see :func:`load_frame`.

    Raises:
        SpecError: A frame cannot be used.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    shots = loaded.spec.frames
    frame, own = load_frame(loaded, name, setup), shots[name].pose
    others = fused_frames(loaded.spec, name)
    if own is None or not others:
        return frame
    setup = _answering(setup, frame)
    X_VW = pose(own).inverse()
    views: list[Array] = []
    findings: list[CaptureFinding] = []
    for other in others:
        stated = shots[other].pose
        assert stated is not None
        another = load_frame(loaded, other, setup)
        setup = _answering(setup, another)
        findings += another.findings
        seen = seen_from(another, X_VW @ pose(stated), frame)
        share = agreement_of(frame.depth, seen)
        if share is None:  # it shows something else
            continue
        if share < AGREEING:
            percent = f"{100 * share:.0f} %"
            message = (
                f"the frame `{other}` was not used: its depth agrees with that of `{name}` at {percent} of the pixels"
            )
            findings.append(CaptureFinding(UNUSED_FRAME, message, HINT))
        else:
            views.append(seen)
    return replace(frame, depth=fused_depth(frame.depth, views), findings=(*frame.findings, *findings))


def posed_views(loaded: Loaded, name: str, setup: ModelSetup | None = None) -> tuple[tuple[Frame, Pose], ...]:
    """Return the other frames that have a pose, each with the pose of its camera in that of the frame ``name``.

    Frames of another size, and those whose depth contradicts that of the frame, are left out.

    Raises:
        SpecError: A frame cannot be used.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    shots, found = loaded.spec.frames, []
    own, others = shots[name].pose, fused_frames(loaded.spec, name)
    if own is None or not others:
        return ()
    view = load_frame(loaded, name, setup)
    setup = _answering(setup, view)
    for other in others:
        stated = shots[other].pose
        assert stated is not None
        frame, X_VF = load_frame(loaded, other, setup), pose(own).inverse() @ pose(stated)
        share = agreement_of(view.depth, seen_from(frame, X_VF, view))
        if frame.color.shape == view.color.shape and share is not None and share >= AGREEING:
            found.append((frame, X_VF))
    return tuple(found)


def _answering(setup: ModelSetup | None, frame: Frame) -> ModelSetup | None:
    """Return the models to ask for the next frame, without the one that failed for ``frame``: it may take minutes."""
    has_failed = any(finding.code == MODEL_FAILED for finding in frame.findings)
    return setup.without("stereo") if setup is not None and has_failed else setup


def seen_from(frame: Frame, X_view_camera: Pose, view: Frame) -> Array:
    """Return the depth [m] of ``frame`` as seen by the camera of ``view``, shape (h, w), NaN where it saw nothing.

    ``X_view_camera`` is the pose of the camera of ``frame`` in that of ``view``.
    """
    return register(frame.depth, frame.K, X_view_camera, view.K, (view.depth.shape[0], view.depth.shape[1]))


def agreement_of(depth: Array, other: Array) -> float | None:
    """Return the share of the pixels with depth [m] in both images at which it is the same, or None for few pixels."""
    both = np.isfinite(depth) & np.isfinite(other)
    if both.sum() < SHARED_MIN:
        return None
    return float((np.abs(depth - other)[both] < SAME_SURFACE * depth_sigma(depth[both])).mean())


def fused_depth(depth: Array, views: Sequence[Array]) -> Array:
    """Return the depth of an image, with less noise and fewer holes.

    Args:
        depth: Depth of the image [m], shape (h, w); NaN for holes.
        views: Depth of other frames as seen by the same camera, of the same shape.

    Returns:
        The median of the readings that agree with that of the image. In its holes, the median of the readings of the
        other frames, if enough of them agree with it.
    """
    if not views:
        return depth
    stack = np.stack(views)
    limit = SAME_SURFACE * depth_sigma(depth)
    with np.errstate(invalid="ignore"):
        same = np.where(np.abs(stack - depth) < limit, stack, np.nan)
    measured = _median(np.concatenate([depth[None], same]))
    guess = _median(stack)
    with np.errstate(invalid="ignore"):
        agreeing = np.abs(stack - guess) < SAME_SURFACE * depth_sigma(guess)
    filled = np.where(agreeing.sum(axis=0) >= WITNESSES, guess, np.nan)
    return np.where(np.isfinite(depth), measured, filled)


def _median(stack: Array) -> Array:
    """Return the median over the first axis without NaN, or NaN where there is nothing else."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of pixels that no frame has seen
        return np.asarray(np.nanmedian(stack, axis=0))
