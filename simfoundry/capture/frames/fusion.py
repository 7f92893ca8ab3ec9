"""Fuse the depth of several posed frames in the view of one of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simfoundry.capture.findings import MODEL_FAILED, UNUSED_FRAME, CaptureFinding
from simfoundry.capture.frame import Frame
from simfoundry.capture.frames.fused_depth import DepthView, fused_depth, same_surface, without_edges
from simfoundry.capture.frames.load import load_frame
from simfoundry.capture.frames.sensors import register
from simfoundry.capture.recordings.odometry import depth_surface, refined_pose
from simfoundry.geometry.frames import Array, Pose
from simfoundry.models.setup import ModelSetup
from simfoundry.scene.lower import pose
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.capture import CaptureSpec

# Minimum share of the pixels that two frames both see at which their depth must agree. Occlusion leaves 93 % in the
# frames of `redkitchen`; a wrong pose leaves hardly any.
AGREEING = 0.5

# Least number of pixels that two frames must share for a judgment about the pose.
SHARED_MIN = 1000

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
    frame = load_frame(loaded, name, setup)
    views: list[DepthView] = []
    findings = [*frame.findings]
    for other, shown, X_CV, share in _other_frames(loaded, name, frame, setup):
        findings += shown.findings
        if share >= AGREEING:
            views.append(DepthView(without_edges(shown.depth).astype(np.float32), shown.K, X_CV))
            continue
        percent = f"{100 * share:.0f} %"
        message = f"the frame `{other}` was not used: its depth agrees with that of `{name}` at {percent} of the pixels"
        findings.append(CaptureFinding(UNUSED_FRAME, message, HINT))
    return replace(frame, depth=fused_depth(frame, views), findings=tuple(findings))


def posed_views(loaded: Loaded, name: str, setup: ModelSetup | None = None) -> tuple[tuple[Frame, Pose], ...]:
    """Return the other frames that have a pose, each with the pose of its camera in that of the frame ``name``.

    Frames of another size, and those whose depth contradicts that of the frame, are left out.

    Raises:
        SpecError: A frame cannot be used.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    if not fused_frames(loaded.spec, name):
        return ()
    view = load_frame(loaded, name, setup)
    return tuple(
        (frame, X_VF)
        for _, frame, X_VF, share in _other_frames(loaded, name, view, setup)
        if share >= AGREEING and frame.color.shape == view.color.shape
    )


def _other_frames(
    loaded: Loaded, name: str, view: Frame, setup: ModelSetup | None
) -> Iterator[tuple[str, Frame, Pose, float]]:
    """Yield the other posed frames that show what the frame ``name``, loaded as ``view``, shows.

    Each comes with its name, the pose of its camera in that of the view, refined by the depth, and the share of common
    pixels at which the depth agrees.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    shots = loaded.spec.frames
    own, others = shots[name].pose, fused_frames(loaded.spec, name)
    if own is None or not others:
        return
    setup = _answering(setup, view)
    reference = depth_surface(view.depth, view.K)
    for other in others:
        stated = shots[other].pose
        assert stated is not None
        frame = load_frame(loaded, other, setup)
        setup = _answering(setup, frame)
        X_VF = refined_pose(reference, depth_surface(frame.depth, frame.K), pose(own).inverse() @ pose(stated))
        share = agreement_of(view.depth, seen_from(frame, X_VF, view))
        if share is not None:  # otherwise, it shows something else
            yield other, frame, X_VF, share


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
    return float(same_surface(depth, other)[both].mean())
