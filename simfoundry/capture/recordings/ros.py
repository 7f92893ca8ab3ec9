"""Color and depth images in ROS bags, with the cameras, their offset and their poses."""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.capture.recordings.recording import RecordedFrame, RecordingError
from simfoundry.capture.recordings.ros_files import RosBag, open_bag
from simfoundry.capture.recordings.ros_images import camera_of, color_of, depth_of, is_color, is_depth, transform_of
from simfoundry.geometry.frames import Pose

IMAGE, COMPRESSED, CAMERA = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
TRANSFORMS, TRANSFORM, NUMBER = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/Transform", "std_msgs/msg/Float32"

# Words in topics of depth that is registered to the color image.
REGISTERED = ("aligned", "registered")

# Maximum time between the color and the depth image of a frame, and between a frame and its pose [ns]: one period of a
# camera at 20 frames per second.
SAME_TIME_NS = 50_000_000

# Words in topics of images that are neither color nor depth for a person, but may have such an encoding.
OTHER_IMAGES = ("infra", "confidence", "mask", "label", "theora", "thermal")

# Maximum number of frames between a camera and the root of the tree of transforms; trees of robots have some 20.
CHAIN_MAX = 100


@dataclass(eq=False)
class _Transforms:
    """Transforms between frames: for each child its parent, and its poses by time [ns]."""

    parents: dict[str, str] = field(default_factory=dict)
    poses: dict[str, list[tuple[int, Pose]]] = field(default_factory=lambda: defaultdict(list))
    moving: set[str] = field(default_factory=set)

    def add(self, message: Any, is_static: bool) -> None:
        for each in message.transforms:
            child = each.child_frame_id.lstrip("/")
            stamp = each.header.stamp
            seconds = getattr(stamp, "sec", getattr(stamp, "secs", 0))
            nanoseconds = getattr(stamp, "nanosec", getattr(stamp, "nsecs", 0))
            self.parents[child] = each.header.frame_id.lstrip("/")
            self.poses[child].append((seconds * 1_000_000_000 + nanoseconds, transform_of(each.transform)))
            if not is_static:
                self.moving.add(child)

    def to_root(self, frame: str, time_ns: int) -> tuple[str, Pose, bool] | None:
        """Return the root above a frame, the frame's pose in it, and whether it moves; None if a pose is missing."""
        X_above, moves = Pose.of(), False
        for _ in range(CHAIN_MAX):
            if frame not in self.parents:
                return frame, X_above, moves
            known = self.poses[frame]
            at = bisect_left(known, time_ns, key=lambda entry: entry[0])
            nearest = min(known[max(0, at - 1) : at + 1], key=lambda entry: abs(entry[0] - time_ns))
            if frame in self.moving and abs(nearest[0] - time_ns) > SAME_TIME_NS:
                return None
            X_above = nearest[1] @ X_above
            moves, frame = moves or frame in self.moving, self.parents[frame]
        return None

    def between(self, target: str, source: str, time_ns: int) -> Pose | None:
        """Return the pose of the frame ``source`` in the frame ``target``, or None if it is unknown."""
        if target == source:
            return Pose.of()
        a, b = self.to_root(target, time_ns), self.to_root(source, time_ns)
        return None if a is None or b is None or a[0] != b[0] else a[1].inverse() @ b[1]


class RosRecording:
    """A ROS bag with color and depth images."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with open_bag(path) as bag:
            self._depth, self._color = self._topics(bag)
            self._read(bag)
        self._pairs = _pairs(self._stamps[self._depth], self._stamps[self._color])
        if not self._pairs:
            raise RecordingError(f"the depth images in {path} and its color images were not taken at the same times")
        start = self._pairs[0][0]
        self.times_s: Sequence[float] = [(depth - start) / 1e9 for depth, _ in self._pairs]

    def _topics(self, bag: RosBag) -> tuple[str, str]:
        """Return the topics of depth and of color, by their names and first messages."""
        topics = [t for t, kind in bag.types.items() if kind in (IMAGE, COMPRESSED)]
        topics = [t for t in topics if not any(word in t.lower() for word in OTHER_IMAGES)]
        first: dict[str, Any] = {}
        for message in bag.messages(topics):
            if message.topic not in first:
                first[message.topic] = message.decode()
                if len(first) == len(topics):
                    break
        depths = [t for t, message in first.items() if is_depth(message)]
        colors = [t for t, message in first.items() if is_color(message) and "depth" not in t.lower()]
        if not depths or not colors:
            found = ", ".join(f"{t} ({bag.types[t]})" for t in sorted(bag.types)[:12]) or "none"
            lacks = "depth images (16UC1, mono16 or 32FC1)" if not depths else "color images"
            raise RecordingError(f"{self.path} contains no {lacks}; its topics are {found}")
        depth = min(depths, key=lambda t: (not any(word in t.lower() for word in REGISTERED), t))
        color = min(colors, key=lambda t: (-_common(t, depth), t))
        return depth, color

    def _read(self, bag: RosBag) -> None:
        """Read everything but the images themselves."""
        wanted = {CAMERA, TRANSFORMS, TRANSFORM, NUMBER}
        others = [t for t, kind in bag.types.items() if kind in wanted]
        self._stamps: dict[str, list[int]] = {self._depth: [], self._color: []}
        self._transforms, self._unit = _Transforms(), 0.001
        cameras: dict[str, Any] = {}
        offsets: dict[str, Pose] = {}
        frames: dict[str, str] = {}
        for message in bag.messages([self._depth, self._color, *others]):
            topic, kind = message.topic, bag.types[message.topic]
            if topic in self._stamps:
                self._stamps[topic].append(message.stamp_ns or message.time_ns)
                if topic not in frames:
                    frames[topic] = message.decode().header.frame_id.lstrip("/")
            elif kind == CAMERA:
                cameras.setdefault(topic, None)
                if cameras[topic] is None:
                    cameras[topic] = message.decode()
            elif kind == TRANSFORMS:
                self._transforms.add(message.decode(), "static" in topic)
            elif kind == TRANSFORM and "/tf/" in topic:
                offsets.setdefault(topic, transform_of(message.decode()))
            elif kind == NUMBER and topic.lower().endswith("depth_units/value") and _common(topic, self._depth):
                self._unit = float(message.decode().data)
        for known in self._transforms.poses.values():
            known.sort(key=lambda entry: entry[0])
        self._frames = frames
        self.K, self.distortion = camera_of(_camera(cameras, self._color, self.path), self.path)
        self.K_depth, _ = camera_of(_camera(cameras, self._depth, self.path), self.path)
        self.X_color_depth = self._offset(offsets)

    def _offset(self, offsets: Mapping[str, Pose]) -> Pose:
        """Return the pose of the depth camera in the frame of the color camera.

        RealSense's own recordings contain, for each stream, the transform from a reference stream to it.
        """
        if any(word in self._depth.lower() for word in REGISTERED):
            return Pose.of()
        if offsets:
            color, depth = (max(offsets, key=lambda t: _common(t, topic)) for topic in (self._color, self._depth))
            if color.rsplit("/", 1)[-1] == depth.rsplit("/", 1)[-1] and color != depth:
                return offsets[color] @ offsets[depth].inverse()
        color, depth = self._frames[self._color], self._frames[self._depth]
        is_named = color != depth or not color.isdigit()  # RealSense's own recordings call all frames 0
        known = self._transforms.between(color, depth, self._stamps[self._depth][0]) if is_named else None
        if known is not None:
            return known
        if np.allclose(self.K, self.K_depth, rtol=1e-3):  # registered, by a driver that keeps the depth camera's frame
            return Pose.of()
        raise RecordingError(
            f"{self.path} does not state where its depth camera (`{depth}`) is in the frame of its color camera "
            f"(`{color}`); record /tf_static, or depth that is aligned to color"
        )

    def frames(self, chosen: Sequence[int]) -> Iterator[RecordedFrame]:
        """Yield the frames with these ascending indices."""
        depths = {self._pairs[k][0] for k in chosen}
        colors = {self._pairs[k][1] for k in chosen}
        seen: dict[tuple[str, int], Any] = {}
        waiting = list(chosen)
        with open_bag(self.path) as bag:
            for message in bag.messages([self._depth, self._color]):
                stamp = message.stamp_ns or message.time_ns
                if stamp in (depths if message.topic == self._depth else colors):
                    seen[message.topic, stamp] = message.decode()
                while waiting:
                    depth, color = self._pairs[waiting[0]]
                    if (self._depth, depth) not in seen or (self._color, color) not in seen:
                        break
                    yield self._frame(waiting.pop(0), seen.pop((self._depth, depth)), seen[self._color, color])
                if not waiting:
                    return
        raise RecordingError(f"{self.path} changed while it was read")

    def _frame(self, index: int, depth: Any, color: Any) -> RecordedFrame:
        _, stamp = self._pairs[index]
        root = self._transforms.to_root(self._frames[self._color], stamp)
        return RecordedFrame(
            self.times_s[index],
            color_of(color, self.path),
            depth_of(depth, self._unit, self.path),
            self.K,
            self.K_depth,
            self.X_color_depth,
            self.distortion,
            root[1] if root is not None and root[2] else None,
        )


def _camera(cameras: Mapping[str, Any], topic: str, path: Path) -> Any:
    """Return the camera of an image topic: the one whose topic has the longest common beginning."""
    if not cameras or (best := max(sorted(cameras), key=lambda t: _common(t, topic))) is None:
        raise RecordingError(f"{path} contains no intrinsics (sensor_msgs/CameraInfo); record them with the images")
    return cameras[best]


def _common(a: str, b: str) -> int:
    """Return the number of parts that two topics have in common at their beginning."""
    parts = zip(a.strip("/").split("/"), b.strip("/").split("/"), strict=False)
    count = 0
    for one, other in parts:
        if one != other:
            break
        count += 1
    return count


def _pairs(depths: Collection[int], colors: Collection[int]) -> list[tuple[int, int]]:
    """Return for each depth image the time [ns] of the color image that is nearest in time, if there is one."""
    order, out = sorted(set(colors)), []
    for depth in sorted(set(depths)):
        at = bisect_left(order, depth)
        near = min(order[max(0, at - 1) : at + 1], key=lambda t: abs(t - depth), default=None)
        if near is not None and abs(near - depth) <= SAME_TIME_NS:
            out.append((depth, near))
    return out
