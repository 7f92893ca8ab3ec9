"""Recordings written with the libraries of their formats, for the tests of their readers."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from simfoundry.geometry.frames import Pose, matrix_from_quat, quat_from_matrix, quat_from_rpy, to_xyzw
from tests.capture import captures

K = (150.0, 0.0, 79.5, 0.0, 150.0, 59.5, 0.0, 0.0, 1.0)

# Depth camera: half the resolution, 3 cm to the left of the color camera.
K_DEPTH = (75.0, 0.0, 39.5, 0.0, 75.0, 29.5, 0.0, 0.0, 1.0)
X_COLOR_DEPTH = Pose.of([-0.03, 0.0, 0.0], quat_from_rpy(0.0, 0.02, 0.0))

# The camera in the frame in which it is tracked, at the time of frame k.
POSES = [Pose.of([0.1 * k, -0.2, 0.3], quat_from_rpy(0.3, -0.4, 1.1 + 0.05 * k)) for k in range(3)]

STEP_NS = 33_000_000


def depth_mm() -> np.ndarray:
    """Depth as the depth camera measures it [mm], with a hole in a corner that no flip or transposition keeps."""
    small = captures.plane()[::2, ::2]
    out = np.rint(small * 1000).astype(np.uint16)
    out[:4, :6] = 0
    return out


# -- Record3D ---------------------------------------------------------------------------------------------------------


def write_r3d(file: Path, changes: dict[str, Any] | None = None, depth: bytes | None = None) -> Path:
    """Three frames as Record3D exports them: K by columns, and poses of a camera with x right, y up, z backward."""
    import lzfse

    flip = np.diag([1.0, -1.0, -1.0])
    poses = []
    for X_WC in POSES:
        q = to_xyzw(quat_from_matrix(matrix_from_quat(X_WC.q) @ flip))
        poses.append([*q.tolist(), *X_WC.p.tolist()])
    metadata = {"w": 160, "h": 120, "dw": 80, "dh": 60, "fps": 30, "K": np.reshape(K, (3, 3)).T.ravel().tolist()}
    metadata |= {"poses": poses} | (changes or {})
    meters = (depth_mm() / 1000).astype("<f4")
    meters[meters == 0] = np.nan
    confidence = np.full((60, 80), 2, np.uint8)
    confidence[-3:, -5:] = 0
    jpeg = io.BytesIO()
    Image.fromarray(captures.color()).save(jpeg, format="JPEG", quality=98)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("metadata", json.dumps(metadata))
        for k in range(3):
            archive.writestr(f"rgbd/{k}.jpg", jpeg.getvalue())
            archive.writestr(f"rgbd/{k}.depth", depth if depth is not None else lzfse.compress(meters.tobytes()))
            archive.writestr(f"rgbd/{k}.conf", lzfse.compress(confidence.tobytes()))
    return file


# -- ROS 1, as RealSense cameras record -------------------------------------------------------------------------------


def write_realsense_bag(file: Path, unit: float = 0.001, offset: bool = True) -> Path:
    """Three frames as the RealSense Viewer records them: transforms lead from a reference stream to each stream."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    T = store.types
    time = T["builtin_interfaces/msg/Time"]

    def header(k: int, frame: str = "0") -> Any:
        return T["std_msgs/msg/Header"](seq=k, stamp=time(sec=0, nanosec=1_000 + k * STEP_NS), frame_id=frame)

    def info(size: tuple[int, int], K: tuple[float, ...]) -> Any:
        roi = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        three = np.array(K)
        return T["sensor_msgs/msg/CameraInfo"](
            header(0), size[1], size[0], "Brown Conrady", np.zeros(5), three, np.zeros(9), np.zeros(12), 0, 0, roi
        )

    def image(k: int, pixels: np.ndarray, encoding: str) -> Any:
        rows = pixels.reshape(len(pixels), -1).view(np.uint8)
        step = rows.shape[1] + 4  # rows may be padded
        data = np.zeros((len(rows), step), np.uint8)
        data[:, :-4] = rows
        size = pixels.shape[:2]
        return T["sensor_msgs/msg/Image"](header(k), size[0], size[1], encoding, 0, step, data.ravel())

    def transform(X: Pose) -> Any:
        x, y, z, w = to_xyzw(X.q).tolist()
        vector = T["geometry_msgs/msg/Vector3"](*X.p.tolist())
        return T["geometry_msgs/msg/Transform"](vector, T["geometry_msgs/msg/Quaternion"](x, y, z, w))

    X_depth_reference = Pose.of([0.01, 0.02, 0.0], quat_from_rpy(0.0, 0.0, 0.01))
    depth, color = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"
    messages: list[tuple[str, str, Any, int]] = [
        (f"{depth}/info/camera_info", "sensor_msgs/msg/CameraInfo", info((80, 60), K_DEPTH), 0),
        (f"{color}/info/camera_info", "sensor_msgs/msg/CameraInfo", info((160, 120), K), 0),
        ("/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32", T["std_msgs/msg/Float32"](unit), 0),
    ]
    if offset:
        both = ((depth, X_depth_reference), (color, X_COLOR_DEPTH @ X_depth_reference))
        messages += [(f"{t}/tf/0", "geometry_msgs/msg/Transform", transform(X), 0) for t, X in both]
    raw = np.rint(depth_mm() * (0.001 / unit)).astype(np.uint16)
    for k in range(3):
        at = 1_000 + k * STEP_NS
        messages.append((f"{depth}/image/data", "sensor_msgs/msg/Image", image(k, raw, "mono16"), at))
        messages.append((f"{color}/image/data", "sensor_msgs/msg/Image", image(k, captures.color(), "rgb8"), at + 5000))
        infrared = np.zeros((60, 80), np.uint8)
        name = "/device_0/sensor_0/Infrared_1/image/data"
        messages.append((name, "sensor_msgs/msg/Image", image(k, infrared, "8UC1"), at))
    with Writer(file) as writer:
        made: dict[str, Any] = {}
        for topic, kind, message, at in messages:
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(made[topic], at, store.serialize_ros1(message, kind))
    return file


# -- ROS 2 ------------------------------------------------------------------------------------------------------------

HEADER = "std_msgs/Header header\n"
DEFINITIONS = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""

TYPES = {
    "sensor_msgs/msg/Image": HEADER
    + "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data",
    "sensor_msgs/msg/CompressedImage": HEADER + "string format\nuint8[] data",
    "sensor_msgs/msg/CameraInfo": HEADER
    + "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n"
    "uint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}


def write_mcap(file: Path, compressed: bool = False, moving: bool = True) -> Path:
    """Three frames as a driver publishes them and `ros2 bag record -s mcap` stores them, with transforms."""
    from mcap_ros2.writer import Writer

    def header(k: int, frame: str) -> dict[str, Any]:
        return {"stamp": {"sec": 100, "nanosec": k * STEP_NS}, "frame_id": frame}

    def info(frame: str, size: tuple[int, int], K: tuple[float, ...]) -> dict[str, Any]:
        roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        return {
            "header": header(0, frame), "height": size[1], "width": size[0], "distortion_model": "plumb_bob",
            "d": [0.0] * 5, "k": list(K), "r": [0.0] * 9, "p": [0.0] * 12, "binning_x": 0, "binning_y": 0, "roi": roi,
        }  # fmt: skip

    def transform(k: int, parent: str, child: str, X: Pose) -> dict[str, Any]:
        x, y, z, w = to_xyzw(X.q).tolist()
        p = dict(zip("xyz", X.p.tolist(), strict=True))
        body = {"translation": p, "rotation": {"x": x, "y": y, "z": z, "w": w}}
        return {"header": header(k, parent), "child_frame_id": child, "transform": body}

    def image(k: int, frame: str, pixels: np.ndarray, encoding: str) -> tuple[str, dict[str, Any]]:
        if compressed:
            stream = io.BytesIO()
            Image.fromarray(pixels).save(stream, format="PNG")
            is_depth = pixels.dtype == np.uint16
            data = (bytes(12) if is_depth else b"") + stream.getvalue()
            form = "16UC1; compressedDepth png" if is_depth else "rgb8; png compressed rgb8"
            return "sensor_msgs/msg/CompressedImage", {"header": header(k, frame), "format": form, "data": data}
        big = pixels.astype(pixels.dtype.newbyteorder(">"))
        step = big.nbytes // len(big)
        body = {"header": header(k, frame), "height": len(big), "width": big.shape[1], "encoding": encoding}
        return "sensor_msgs/msg/Image", body | {"is_bigendian": 1, "step": step, "data": big.tobytes()}

    X_link_color = Pose.of([0.0, 0.015, 0.0], quat_from_rpy(-np.pi / 2, 0.0, -np.pi / 2))
    suffix = "/compressed" if compressed else ""
    color, depth = f"/camera/color/image_raw{suffix}", f"/camera/depth/image_rect_raw{suffix and '/compressedDepth'}"
    rows: list[tuple[str, str, dict[str, Any], int]] = [
        ("/camera/color/camera_info", "sensor_msgs/msg/CameraInfo", info("color", (160, 120), K), 0),
        ("/camera/depth/camera_info", "sensor_msgs/msg/CameraInfo", info("depth", (80, 60), K_DEPTH), 0),
    ]
    static = [transform(0, "link", "color", X_link_color)]
    static += [transform(0, "link", "depth", X_link_color @ X_COLOR_DEPTH)]
    rows.append(("/tf_static", "tf2_msgs/msg/TFMessage", {"transforms": static}, 0))
    for k, X_WC in enumerate(POSES):
        if moving:
            moved = transform(k, "odom", "link", X_WC @ X_link_color.inverse())
            rows.append(("/tf", "tf2_msgs/msg/TFMessage", {"transforms": [moved]}, k))
        rows.append((color, *image(k, "color", captures.color()[..., ::-1], "bgr8"), k))
        rows.append((depth, *image(k, "depth", depth_mm(), "16UC1"), k))
    with file.open("wb") as stream:
        writer = Writer(stream)
        schemas = {kind: writer.register_msgdef(kind, text + DEFINITIONS) for kind, text in TYPES.items()}
        for topic, kind, body, k in rows:
            at = 100_000_000_000 + k * STEP_NS
            writer.write_message(topic, schemas[kind], body, log_time=at, publish_time=at)
        writer.finish()
    return file
