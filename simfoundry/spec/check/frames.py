"""Check the reference frames of a scene, and the poses and places that refer to them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from simfoundry.spec.check.checker import Checker, Path_
from simfoundry.spec.models.reuse import MAX_DEPTH, ReferenceFrame, frame_carrier, frame_chain
from simfoundry.spec.models.scene import SceneSpec

if TYPE_CHECKING:
    from simfoundry.spec.check.names import SceneNames


def check_frames(c: Checker, names: SceneNames, spec: SceneSpec) -> None:
    """Check the named frames, and every reference to a frame."""
    for name, frame in spec.frames.items():
        if name in names.objects:
            message = f"a frame and an object are both called `{name}`, so references to it are ambiguous"
            c.add("SF213", ("frames", name), message, "rename one of them")
        _check_frame(c, names, name, frame, spec)
    for reference, path in _references(spec):
        check_reference(c, names, reference, path)
    for name, robot in spec.robots.items():
        _check_fixed(c, spec, robot.pose.frame, ("robots", name, "pose", "frame"))
    for name, camera in spec.cameras.items():
        if camera.mount is not None and camera.pose.frame is not None:
            message = "the pose of a mounted camera is relative to its mount"
            c.add("SF107", ("cameras", name, "pose", "frame"), message, "remove either `frame` or `mount`")


def check_reference(c: Checker, names: SceneNames, reference: str, path: Path_) -> None:
    """Check the name of a frame: a named frame, an object, or a link."""
    owner = reference.partition(".")[0]
    if reference in names.frames:
        return
    if c.name(owner, [*names.frames, *names.objects], path, "frame or object"):
        names.check_link(c, reference, path)


def _check_frame(c: Checker, names: SceneNames, name: str, frame: ReferenceFrame, spec: SceneSpec) -> None:
    path = ("frames", name)
    if frame.on is not None:
        names.check_link(c, frame.on, (*path, "on"), with_parts=True)
    if frame.frame is None:
        return
    check_reference(c, names, frame.frame, (*path, "frame"))
    chain = frame_chain(spec.frames, name)
    if len(chain) > MAX_DEPTH:
        c.add("SF005", (*path, "frame"), f"the chain of `frame` has more than {MAX_DEPTH} frames")
    elif spec.frames[chain[-1]].frame == name:
        shown = " → ".join(f"`{each}`" for each in (*chain, name))
        c.add("SF208", (*path, "frame"), f"the frame `{name}` depends on itself: {shown}", "remove one `frame`")


def _references(spec: SceneSpec) -> Iterator[tuple[str, Path_]]:
    """Yield each reference to a frame in a pose or light, with its path."""
    for name, item in spec.objects.items():
        if item.pose.frame is not None:
            yield item.pose.frame, ("objects", name, "pose", "frame")
    for section, members in (("robots", spec.robots), ("cameras", spec.cameras)):
        for name, member in members.items():
            if member.pose.frame is not None:
                yield member.pose.frame, (section, name, "pose", "frame")
    for name, light in spec.lights.items():
        if light.frame is not None:
            yield light.frame, ("lights", name, "frame")


def _check_fixed(c: Checker, spec: SceneSpec, reference: str | None, path: Path_) -> None:
    """Check that the frame of a robot's base does not move with an object."""
    carrier = frame_carrier(spec.frames, reference)
    if carrier is not None:
        message = f"the base of a robot is fixed, but this frame moves with `{carrier}`"
        c.add("SF107", path, message, "use a frame that is attached to the world")
