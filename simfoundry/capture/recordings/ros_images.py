"""Images and cameras in messages of ROS."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.recordings.recording import RecordingError, checked_size, decoded_image
from simfoundry.geometry.frames import Array, Pose, from_xyzw

# Encodings of depth: their type, and whether values are in meters.
DEPTH_ENCODINGS = {"16UC1": (np.uint16, False), "mono16": (np.uint16, False), "32FC1": (np.float32, True)}

# Encodings of color: the number of channels, and the order of red, green and blue among them.
COLOR_ENCODINGS = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)),  # as OpenCV stores colors
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "8UC4": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}

# Encodings with two bytes per pixel, and OpenCV's names of their conversions.
YUV_ENCODINGS = {
    "yuv422": "COLOR_YUV2RGB_UYVY",
    "uyvy": "COLOR_YUV2RGB_UYVY",
    "yuv422_yuy2": "COLOR_YUV2RGB_YUY2",
    "yuyv": "COLOR_YUV2RGB_YUY2",
}

# Size of the header of the transport `compressedDepth` [bytes]: an enumeration and two parameters.
COMPRESSED_DEPTH_HEADER = 12


def is_depth(message: Any) -> bool:
    """Return True if a message of the type ``Image`` or ``CompressedImage`` is a depth image."""
    if hasattr(message, "encoding"):
        return message.encoding in DEPTH_ENCODINGS
    return "compressedDepth" in message.format or message.format.split(";")[0].strip() in DEPTH_ENCODINGS


def is_color(message: Any) -> bool:
    """Return True if a message of the type ``Image`` or ``CompressedImage`` is a color image."""
    if hasattr(message, "encoding"):
        return message.encoding in COLOR_ENCODINGS or message.encoding.lower() in YUV_ENCODINGS
    return not is_depth(message)


def color_of(message: Any, file: Path) -> NDArray[np.uint8]:
    """Return the RGB image in a message, shape (h, w, 3).

    Raises:
        RecordingError: It is damaged.
    """
    if not hasattr(message, "encoding"):
        return decoded_image(bytes(message.data), file)
    if message.encoding.lower() in YUV_ENCODINGS:
        import cv2

        pixels = np.ascontiguousarray(_pixels(message, np.dtype(np.uint8), 2, file))
        return np.asarray(cv2.cvtColor(pixels, getattr(cv2, YUV_ENCODINGS[message.encoding.lower()])))
    channels, order = COLOR_ENCODINGS[message.encoding]
    return np.ascontiguousarray(_pixels(message, np.dtype(np.uint8), channels, file)[..., order])


def depth_of(message: Any, unit: float, file: Path) -> Array:
    """Return the depth image in a message [m], shape (h, w), NaN where there is none. ``unit`` [m] is that of integers.

    Raises:
        RecordingError: It is damaged.
    """
    if hasattr(message, "encoding"):
        kind, is_metric = DEPTH_ENCODINGS[message.encoding]
        raw = _pixels(message, np.dtype(kind), 1, file)[..., 0]
        values = raw.astype(np.float64) * (1.0 if is_metric else unit)
    else:
        values = _compressed_depth(bytes(message.data), message.format, unit, file)
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def _compressed_depth(data: bytes, form: str, unit: float, file: Path) -> Array:
    """Decode depth of the transport `compressedDepth`: PNG, of inverse depth if the image had fractions."""
    header = COMPRESSED_DEPTH_HEADER if "compressedDepth" in form else 0
    raw = decoded_image(data[header:], file, mode="").astype(np.float64)
    if raw.ndim != 2:
        raise RecordingError(f"{file} contains a compressed depth image with {raw.ndim} dimensions")
    if not form.startswith("32FC1"):
        return raw * unit
    a, b = struct.unpack_from("<2f", data, 4)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(raw > 0, a / (raw - b), np.nan))


def _pixels(message: Any, dtype: np.dtype[Any], channels: int, file: Path) -> NDArray[Any]:
    """Return the pixels of an uncompressed image, shape (h, w, channels)."""
    width, height, step = int(message.width), int(message.height), int(message.step)
    checked_size(width, height, file)
    row = width * channels * dtype.itemsize
    data = np.frombuffer(bytes(message.data), dtype=np.uint8)
    if step < row or data.size < step * height:
        raise RecordingError(f"{file} contains an image of {width} x {height} pixels that is cut off")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row])
    order = dtype.newbyteorder(">" if message.is_bigendian else "<")
    return rows.view(order).reshape(height, width, channels)


def camera_of(message: Any, file: Path) -> tuple[Array, tuple[float, ...]]:
    """Return the intrinsic matrix [px] and the lens of a message of the type ``CameraInfo``.

    Raises:
        RecordingError: The camera is not calibrated, or has a lens that no pinhole camera has.
    """
    K = np.array(message.k if hasattr(message, "k") else message.K, dtype=np.float64).reshape(3, 3)
    lens = tuple(float(v) for v in (message.d if hasattr(message, "d") else message.D))
    if not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise RecordingError(f"{file} contains a camera without intrinsics: calibrate it, or write a capture.yaml")
    if any(lens) and message.distortion_model not in ("plumb_bob", "rational_polynomial", "Brown Conrady", ""):
        if message.distortion_model == "Inverse Brown Conrady":  # RealSense: tiny, and not what OpenCV inverts
            return K, ()
        raise RecordingError(
            f"{file} contains a camera with the lens model {message.distortion_model}; rectify the images"
        )
    return K, lens if any(lens) else ()


def transform_of(message: Any) -> Pose:
    """Return the pose in a message of the type ``Transform``."""
    p, q = message.translation, message.rotation
    return Pose.of((p.x, p.y, p.z), from_xyzw([q.x, q.y, q.z, q.w]))
