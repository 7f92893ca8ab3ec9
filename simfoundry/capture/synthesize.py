"""Synthesize a capture folder from a scene by simulating the recording of a real sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame
from simfoundry.geometry.frames import Array
from simfoundry.render.raycast import Raycast, raycast
from simfoundry.runtime.files import MARK, write_atomically, writing_atomically
from simfoundry.scene.model import Camera, Scene
from simfoundry.spec.models.capture import CaptureSpec, DepthImage, Intrinsics, Masks, Shot
from simfoundry.spec.yaml.write import to_yaml


@dataclass(frozen=True)
class SensorModel:
    """A noise model of a structured-light or active-stereo depth camera.

    The standard deviation of depth along the optical axis is ``axial_base + axial_growth * (z - axial_origin)^2``, plus
    ``axial_tilt / sqrt(z) * t^2 / (pi/2 - t)^2`` on a surface tilted by t [rad] relative to the image plane. The model
    and its defaults were fitted to a Kinect by Nguyen, Izadi and Lovell, "Modeling Kinect Sensor Noise for Improved 3D
    Reconstruction and Tracking", 3DIMPVT 2012. The authors add the last term only beyond 60 degrees. Here, the term
    grows from zero to avoid a discontinuity. ``lateral`` is the authors' value of 0.8 px for a surface that faces the
    camera.
    """

    axial_base: float = 0.0012  # Standard deviation at ``axial_origin`` [m]
    axial_growth: float = 0.0019  # Growth of the standard deviation with the square of the distance [1/m]
    axial_origin: float = 0.4  # Distance at which the standard deviation is smallest [m]
    axial_tilt: float = 0.0001  # Coefficient of the additional noise on tilted surfaces [m^1.5]
    lateral: float = 0.8  # Standard deviation of an edge's position in the image [px]
    # Disparity resolution [px], or 0 for unlimited. Depth is quantized in steps of z^2 * step / (fx * baseline).
    disparity_step: float = 0.125
    baseline: float = 0.075  # Distance between projector and camera, or between the two cameras [m]
    # Relative depth change between neighbors that counts as an edge, in excess of the slope of the surface.
    edge_jump: float = 0.03
    edge_band: int = 2  # Distance from an edge within which the farther surface has no depth [px]
    grazing_deg: float = 78.0  # Maximum tilt relative to the image plane [deg]; steeper surfaces return no depth
    dropout: float = 0.002  # Probability that a pixel returns no depth for no particular reason
    nearest: float = 0.25  # Minimum depth [m]
    farthest: float = 4.0  # Maximum depth [m]
    correlation: float = 0.0  # Standard deviation of the kernel that correlates the noise of neighboring pixels [px]


# A short-range active-stereo camera on a desk, with a standard deviation of about 0.9 mm at 0.5 m.
ACTIVE_STEREO = SensorModel(
    axial_base=0.0004, axial_growth=0.0019, axial_origin=0.0, lateral=0.6, disparity_step=0.03125
)

# Sensors by name. Matching windows of a stereo camera correlate the noise of neighbors, and widen the blind band beside
# objects. A time-of-flight camera has no disparity; its noise grows linearly, and its edges are smeared.
SENSORS = {
    "active_stereo": ACTIVE_STEREO,
    "structured_light": SensorModel(),
    "stereo": SensorModel(
        axial_base=0.0003, axial_growth=0.0022, axial_origin=0.0, lateral=1.2, disparity_step=0.03125, baseline=0.05,
        edge_band=5, dropout=0.01, correlation=2.0,
    ),
    "time_of_flight": SensorModel(
        axial_base=0.0012, axial_growth=0.0006, axial_origin=0.0, lateral=1.0, disparity_step=0.0, edge_band=1,
        grazing_deg=82.0, correlation=0.7,
    ),
}  # fmt: skip


def simulate_depth(ray: Raycast, rng: np.random.Generator, model: SensorModel = ACTIVE_STEREO) -> Array:
    """Return the depth that ``model`` would measure [m], as an array of shape (h, w).

    Pixels without a reading are NaN. ``rng`` is the only source of randomness.
    """
    tilt = _tilt(ray)
    edge, behind = _edges(ray, tilt, model)
    depth = np.where(edge, _jittered(ray.depth, rng, model.lateral), ray.depth)
    depth = depth + _axial_spread(ray.depth, tilt, model) * _noise(rng, depth.shape, model.correlation)
    if model.disparity_step > 0:
        disparity = ray.camera.fx * model.baseline / np.maximum(depth, 1e-6)
        steps = np.maximum(np.rint(disparity / model.disparity_step), 1.0)
        depth = np.where(np.isnan(depth), np.nan, ray.camera.fx * model.baseline / (steps * model.disparity_step))
    lost = behind | (tilt > math.radians(model.grazing_deg)) | (rng.random(depth.shape) < model.dropout)
    lost |= ~((depth >= model.nearest) & (depth <= model.farthest))
    return np.asarray(np.where(lost, np.nan, depth))


def simulate_color(ray: Raycast, rng: np.random.Generator, read: float = 1.2, shot: float = 0.12) -> NDArray[np.uint8]:
    """Return the color image with sensor noise, as an array of shape (h, w, 3).

    The variance of the noise is ``read^2 + shot^2 * value`` in 8-bit units.
    """
    value = ray.color.astype(np.float64)
    noisy = value + np.sqrt(read**2 + shot**2 * value) * rng.standard_normal(value.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def simulate_frame(ray: Raycast, rng: np.random.Generator, model: SensorModel = ACTIVE_STEREO) -> Frame:
    """Return color, depth, intrinsics and instance masks as a real camera would record them."""
    c = ray.camera
    K = np.array([[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]])
    return Frame(color=simulate_color(ray, rng), depth=simulate_depth(ray, rng, model), K=K, instances=ray.objects)


def write_capture(folder: Path, frame: Frame, depth_scale: float = 1e-4) -> Shot:
    """Write the images of a capture. Identical frames produce identical bytes.

    The files are ``color.png`` (8-bit RGB), ``depth.png`` (16-bit in units of ``depth_scale`` [m], 0 for missing depth)
    and, if the frame has masks, ``instances.png`` (16-bit labels).

    Raises:
        ValueError: A depth or a label does not fit in 16 bits. Nothing is written in this case.
    """
    counts = np.rint(np.where(np.isnan(frame.depth), 0.0, frame.depth) / depth_scale)
    if counts.min() < 0 or counts.max() > 65535:
        low, high = float(np.nanmin(frame.depth)), float(np.nanmax(frame.depth))
        raise ValueError(
            f"depth from {low:.4g} to {high:.4g} m does not fit in 16 bits with a depth_scale of {depth_scale:g} m; "
            f"the maximum is {65535 * depth_scale:.4g} m; use a larger depth_scale"
        )
    if frame.instances is not None and (frame.instances.min() < 0 or frame.instances.max() > 65535):
        raise ValueError(f"instance labels must be between 0 and 65535; the maximum is {frame.instances.max()}")
    folder.mkdir(parents=True, exist_ok=True)
    _write_png(folder / "color.png", frame.color)
    _write_png(folder / "depth.png", counts.astype(np.uint16))
    if frame.instances is not None:
        _write_png(folder / "instances.png", frame.instances.astype(np.uint16))
    fx, fy, cx, cy = (float(frame.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Shot(
        color="color.png",
        depth=DepthImage(image="depth.png", scale=depth_scale),
        camera=Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy),
        masks=None if frame.instances is None else Masks(image="instances.png"),
    )


def _write_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_text("Software", MARK)
    with writing_atomically(path) as stream:
        Image.fromarray(image).save(stream, format="PNG", compress_level=6, pnginfo=info)


def _tilt(ray: Raycast) -> Array:
    """Return the angle between each surface normal and the viewing ray [rad], as an array of shape (h, w).

    Pixels without a surface are NaN.
    """
    c = ray.camera
    u, v = np.meshgrid(np.arange(c.width), np.arange(c.height))
    local = np.stack([(u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones(u.shape)], axis=-1)
    direction = (local / np.linalg.norm(local, axis=-1, keepdims=True)) @ c.X_WC.rotation.T
    return np.asarray(np.arccos(np.clip(-(direction * ray.normals).sum(axis=-1), 0.0, 1.0)))


def _axial_spread(z: Array, tilt: Array, model: SensorModel) -> Array:
    """Return the standard deviation of the depth [m], as an array of shape (h, w)."""
    t = np.minimum(tilt, math.radians(85.0))  # the model diverges at 90 degrees
    facing = model.axial_base + model.axial_growth * (z - model.axial_origin) ** 2
    return np.asarray(facing + model.axial_tilt / np.sqrt(z) * t**2 / (math.pi / 2 - t) ** 2)


def _noise(rng: np.random.Generator, shape: tuple[int, ...], correlation: float) -> Array:
    """Return noise of unit variance that is correlated over ``correlation`` [px], as an array of ``shape``."""
    from scipy.ndimage import gaussian_filter

    white = rng.standard_normal(shape)
    if correlation <= 0:
        return white
    smooth: Array = gaussian_filter(white, correlation, mode="wrap")
    return smooth / float(smooth.std())


def _edges(ray: Raycast, tilt: Array, model: SensorModel) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two masks of pixels beside depth jumps.

    The first mask contains the pixels whose depth is uncertain. The second mask contains the hidden pixels on the
    farther side of a jump.
    """
    z = np.where(np.isnan(ray.depth), np.inf, ray.depth)
    # The depth of a plane tilted by t changes by z tan(t) / f from pixel to pixel; only larger changes are jumps.
    steepness = np.tan(np.minimum(np.nan_to_num(tilt), math.radians(85.0))) / min(ray.camera.fx, ray.camera.fy)
    slack = 2 * np.nan_to_num(ray.depth) * steepness
    near_side, far_side = np.zeros(z.shape, dtype=np.bool_), np.zeros(z.shape, dtype=np.bool_)
    for axis in (0, 1):
        one, two = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        with np.errstate(invalid="ignore"):
            gap = np.nan_to_num(z[two] - z[one], posinf=np.inf, neginf=-np.inf)
        limit = model.edge_jump * np.minimum(z[one], z[two]) + np.maximum(slack[one], slack[two])
        rises, falls = gap > limit, -gap > limit
        near_side[one] |= rises
        far_side[two] |= rises
        far_side[one] |= falls
        near_side[two] |= falls
    uncertain = _grown(near_side | far_side, 1 if model.lateral > 0 else 0)
    hidden = _grown(far_side & ~near_side, model.edge_band - 1, ~near_side)
    return uncertain, hidden & (model.edge_band > 0)


def _grown(mask: NDArray[np.bool_], steps: int, within: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Dilate a mask by ``steps`` pixels (Manhattan distance).

    The mask grows only along paths that stay ``within`` another mask.
    """
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(mask, iterations=steps, mask=within)) if steps > 0 else mask


def _jittered(depth: Array, rng: np.random.Generator, spread: float) -> Array:
    """Return the depth with each pixel sampled at a random offset.

    The standard deviation of the offset is ``spread`` [px] per axis.
    """
    h, w = depth.shape
    v, u = np.indices((h, w)) + np.rint(spread * rng.standard_normal((2, h, w))).astype(np.int64)
    return np.asarray(depth[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)])


CAPTURE_FILES = ("capture.yaml", "color.png", "depth.png", "instances.png")  # Files in a synthesized capture


def synthesize(
    scene: Scene, camera: Camera, folder: Path, seed: int, masks: bool = False, truth: Path | None = None
) -> Path:
    """Write a capture of ``scene``, as seen by ``camera``, to ``folder``: color, depth and ``capture.yaml``.

    Identical scenes and seeds produce identical bytes. If the scene document ``truth`` is in the same folder, the
    capture refers to that document as ground truth.

    Returns:
        The path of the capture document.
    """
    frame = simulate_frame(raycast(scene, camera), np.random.default_rng(seed))
    shot = write_capture(folder, frame if masks else replace(frame, instances=None))
    beside = truth is not None and truth.resolve().parent == folder.resolve()
    spec = CaptureSpec(
        simfoundry="capture/1",
        name=folder.resolve().name,
        description=f"The scene {scene.name} as seen by a simulated sensor at {camera.name}, seed {seed}.",
        frames={camera.name: shot},
        truth=truth.name if beside and truth is not None else None,
    )
    path = folder / CAPTURE_FILES[0]
    write_atomically(path, to_yaml(spec, comment=f"{MARK}; delete this line to keep your edits.").encode())
    return path
