"""Load the images of a capture as a registered frame, and report all problems with them together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.doubts.size_priors import unit_doubt
from simfoundry.capture.findings import MODEL_FAILED, CaptureFinding
from simfoundry.capture.frame import FARTHEST, NEAREST, UNITS, Frame, in_range
from simfoundry.capture.frames.foreign import foreign_capture, media_error, scene_folder
from simfoundry.capture.frames.image_files import read_image
from simfoundry.capture.frames.sensors import estimated_depth, register, stereo_depth, undistorted
from simfoundry.geometry.frames import Array
from simfoundry.models.contract import ModelError
from simfoundry.models.provenance import ModelIdentity, model_use
from simfoundry.models.setup import ModelSetup, load_setup
from simfoundry.scene.lower import pose
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, nearest
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load, load_capture
from simfoundry.spec.models.capture import CaptureSpec, DepthImage, Intrinsics, Pixel, Shot
from simfoundry.spec.yaml.write import to_yaml

FEWEST = 100  # Minimum number of pixels with usable depth

USABLE_SHARE = 0.1  # Minimum fraction of usable readings; with fewer, the unit is wrong or no table is visible

CLOSEST_MEDIAN = 0.15  # Minimum median depth of a table [m]; below this, the unit is wrong if a different unit fits

DEPTH_HINT = (
    "add a measured `depth` image or the `stereo` pair, or configure a model of the task `depth` (docs/models.md)"
)

MATCHED_HINT = "the depth was computed by semi-global matching; run again when the model answers"

CHECK_INVALID = "check `invalid`, and make sure that the sensor returned depth"

EXAMPLE = (
    "write one, as `{simfoundry: capture/1, name: desk, frames: {view: {color: color.png, depth: {image: depth.png, "
    "scale: 0.001}, camera: {fx: 610, fy: 610, cx: 319.5, cy: 239.5}}}}`; `simfoundry schema capture` prints all keys"
)

T = TypeVar("T")


def open_capture(path: Path) -> Loaded:
    """Load the capture document at ``path``, or ``capture.yaml`` if ``path`` is a folder.

    A folder without this file may have the layout of another data set; see :mod:`simfoundry.capture.frames.foreign`.

    Raises:
        SpecError: There is no valid capture. The error contains all findings.
        SimfoundryError: A file of another data set cannot be read.
    """
    if not path.is_dir():
        error = media_error(path)
        if error is not None:
            raise error
        return load_capture(path)
    file = path / "capture.yaml"
    foreign = None if file.exists() else foreign_capture(path)
    if foreign is not None:
        loaded = load(file, text=to_yaml(foreign))
        if loaded.errors:
            raise SpecError(loaded.errors)
        return loaded
    if not file.exists():
        message = "the folder has no capture.yaml, which describes the files in the capture"
        inner = scene_folder(path)
        hint = EXAMPLE if inner is None else f"it contains captures, of which one is `simfoundry capture {inner}`"
        raise SpecError([Diagnostic("SF001", Severity.ERROR, message, str(file), hint=hint)])
    return load_capture(file)


def load_frame(loaded: Loaded, name: str | None = None, setup: ModelSetup | None = None) -> Frame:
    """Load the frame called ``name`` from a checked capture document. The default is the first frame.

    ``setup`` names the models of depth; by default, those that are configured for the document.

    Raises:
        SpecError: The frame cannot be used. The error contains all findings.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    name = checked_frame_name(loaded, name)
    return _Reader(loaded, ("frames", name), loaded.spec.frames[name], setup).frame()


def checked_frame_name(loaded: Loaded, name: str | None = None) -> str:
    """Return the name of a frame of a capture document. The default is the first frame.

    Raises:
        SpecError: The capture has no such frame.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    frames = loaded.spec.frames
    name = name or next(iter(frames))
    if name not in frames:
        message = f"the capture has no frame `{name}`"
        raise SpecError([loaded.finding("SF201", ("frames",), message, nearest(name, frames))])
    return name


@dataclass
class _Reader:
    """A reader that loads the images of a single frame and collects findings."""

    loaded: Loaded
    place: tuple[str, ...]
    shot: Shot
    setup: ModelSetup | None = None
    findings: list[Diagnostic] = field(default_factory=list)
    models: tuple[dict[str, Any], ...] = ()
    doubts: tuple[CaptureFinding, ...] = ()

    def fail(self, code: str, path: tuple[str, ...], message: str, hint: str = "") -> None:
        """Add a finding."""
        self.findings.append(self.loaded.finding(code, (*self.place, *path), message, hint))

    def refuse(self, code: str, path: tuple[str, ...], message: str, hint: str = "") -> NoReturn:
        """Raise an error with a finding about an image that cannot be used."""
        raise SpecError([self.loaded.finding(code, (*self.place, *path), message, hint)])

    def read(self, image: Callable[[], T]) -> T | None:
        """Read an image.

        If this fails, the findings are added to those of the reader, and None is returned.
        """
        try:
            return image()
        except SpecError as error:
            self.findings += error.diagnostics
            return None

    def frame(self) -> Frame:
        shot, color, masks = self.shot, self.read(self.color), self.read(self.masks)
        depth = None if color is None else self.read(partial(self.any_depth, color))
        measured = shot.depth
        if color is not None:
            self.intrinsics(shot.camera, color.shape[1], color.shape[0], ("camera",), shot.color)
        elif measured is not None:  # its own problems are reported, too
            self.read(partial(self.depth, measured))
        if depth is not None and measured is not None and measured.camera is not None:
            height, width = depth.shape
            self.intrinsics(measured.camera, width, height, ("depth", "camera"), measured.image)
        elif depth is not None and measured is not None and color is not None and depth.shape != color.shape[:2]:
            message = f"{measured.image} is {_size(depth)}, but {shot.color} is {_size(color)}"
            hint = "register depth to color, or specify the `camera` and `pose` of the depth camera"
            self.fail("SF501", ("depth", "image"), message, hint)
        if masks is not None and color is not None and masks.shape != color.shape[:2]:
            image = shot.masks.image if shot.masks is not None else ""
            message = f"{image} is {_size(masks)}, but {shot.color} is {_size(color)}"
            self.fail("SF501", ("masks", "image"), message, "masks must match the color image pixel by pixel")
        if color is not None:
            self.pixels(color.shape[1], color.shape[0])
        if self.findings or color is None or depth is None:
            raise SpecError(self.findings)
        K, lens = matrix(shot.camera), shot.camera.distortion
        color = undistorted(color, K, lens, smooth=True)
        masks = None if masks is None else undistorted(masks, K, lens)
        if measured is None or measured.camera is None or measured.pose is None:
            depth = depth if shot.stereo is not None else undistorted(depth, K, lens)
        else:
            X_color_depth, K_depth = pose(measured.pose), matrix(measured.camera)
            depth = undistorted(depth, K_depth, measured.camera.distortion)
            depth = register(depth, K_depth, X_color_depth, K, (color.shape[0], color.shape[1]))
            if np.isfinite(depth).sum() < FEWEST:
                message = f"almost none of the points in {measured.image} are visible in {shot.color}"
                hint = "`pose` must be the depth camera's pose in the color camera's frame, in meters; is it inverted?"
                self.fail("SF501", ("depth", "pose"), message, hint)
                raise SpecError(self.findings)
        if measured is not None:
            self.doubts = (*self.doubts, *unit_doubt(measured.scale))
        return Frame(color, depth, K, masks, shot.decomposition, shot.support, self.doubts, self.models)

    def pixels(self, width: int, height: int) -> None:
        """Add a finding for each stated pixel that is not in the image."""
        marked: list[tuple[tuple[str, ...], tuple[Pixel, ...]]] = []
        if (given := self.shot.decomposition) is not None:
            marked += [(("decomposition", "pieces", name), pixels) for name, pixels in given.pieces.items()]
            marked += [(("decomposition", "ignore"), given.ignore)]
        if self.shot.support is not None and self.shot.support.pixel is not None:
            marked += [(("support", "pixel"), (self.shot.support.pixel,))]
        for path, stated in marked:
            for u, v in stated:
                if u >= width or v >= height:
                    message = f"the pixel [{u}, {v}] is not in the image, which has {width} x {height} pixels"
                    self.fail("SF104", path, message, "pixels are [column, row], counted from the top left")

    def color(self) -> NDArray[np.uint8]:
        """Return the color image as RGB.

        Any EXIF rotation is ignored because depth, masks and intrinsics refer to the pixels as stored.
        """
        picture = self.stored(self.shot.color, ("color",), mode="RGB")
        if picture.shape[2:] != (3,):
            self.refuse("SF501", ("color",), f"{self.shot.color} is not a color image", "provide a PNG or a JPEG")
        return picture.astype(np.uint8, copy=False)

    def any_depth(self, color: NDArray[np.uint8]) -> Array:
        """Return the depth [m] of the image ``color``: measured, computed from a stereo pair, or estimated by a model.

        Pixels without a reading are NaN.
        """
        if self.shot.depth is not None:
            return self.depth(self.shot.depth)
        setup, K = self.setup or load_setup(self.loaded.path), matrix(self.shot.camera)
        stereo = self.shot.stereo
        try:
            if stereo is None:
                return self.stated(setup, "depth", *estimated_depth(color, K, setup))
            right = self.stored(stereo.right, ("stereo", "right"), mode="RGB").astype(np.uint8, copy=False)
            if right.shape != color.shape:
                message = f"{stereo.right} is {_size(right)}, but {self.shot.color} is {_size(color)}"
                self.refuse("SF501", ("stereo", "right"), message, "rectify both images to the same camera")
            lens = self.shot.camera.distortion
            if lens:
                hint = "rectify the pair, and state the intrinsics of the rectified images without `distortion`"
                self.refuse("SF501", ("camera", "distortion"), "a stereo pair must be rectified", hint)
            return self.matched(partial(stereo_depth, color, right, K, stereo.baseline), setup)
        except ModelError as error:
            place = ("depth",) if stereo is None else ("stereo",)
            missing = "the frame has neither `depth` nor `stereo`: " if stereo is None else ""
            self.refuse("SF502", () if stereo is None else place, f"{missing}{error}", DEPTH_HINT)

    def matched(self, match: Callable[[ModelSetup], tuple[Array, ModelIdentity]], setup: ModelSetup) -> Array:
        """Return the depth [m] that ``match`` finds for a stereo pair with the configured model.

        If that fails, the offline method is used, which is a finding.

        Raises:
            ModelError: No depth was found.
        """
        source = setup.source("stereo")
        if source is None or source.offline:
            return match(setup)[0]
        try:
            return self.stated(setup, "stereo", *match(setup))
        except ModelError as error:
            self.doubts += (CaptureFinding(MODEL_FAILED, str(error), MATCHED_HINT),)
            return match(setup.without("stereo"))[0]

    def stated(self, setup: ModelSetup, task: str, depth: Array, made_by: ModelIdentity) -> Array:
        """Return the depth that was found for a task, and note the model, if it is not the offline method."""
        source = setup.source(task)
        if source is not None and not source.offline:
            self.models += (model_use(task, made_by).model_dump(exclude_none=True),)
        return depth

    def depth(self, measured: DepthImage) -> Array:
        """Return the measured depth [m].

        Pixels without a reading are NaN.
        """
        hint = "provide raw distances as a 16-bit PNG, TIFF or .npy file, not a depth image rendered for viewing"
        raw = self.raw(measured.image, ("depth", "image"), hint)
        if raw.dtype.itemsize == 1:
            message = f"{measured.image} has 8 bits per pixel, whose 256 steps are too coarse for depth"
            self.refuse("SF501", ("depth", "image"), message, hint)
        values = raw.astype(np.float64)
        valid = np.isfinite(values) & (values > 0) & ~np.isin(raw, measured.invalid)
        if not valid.any():
            message = f"{measured.image} contains no measurements: all values are invalid"
            self.refuse("SF502", ("depth", "image"), message, CHECK_INVALID)
        meters = np.where(valid, values * measured.scale, np.nan)
        usable = in_range(meters)
        median = float(np.median(values[valid]))
        fitting = [s for s in UNITS if 0.2 <= median * s <= 4.0 and s != measured.scale]
        too_close = bool(fitting) and median * measured.scale < CLOSEST_MEDIAN
        if usable.sum() < USABLE_SHARE * valid.sum() or too_close:
            hint = (
                f"its values seem to be in {UNITS[fitting[0]]}; use `scale: {fitting[0]:g}`"
                if fitting
                else "check `scale`"
            )
            percent = 100 * usable.sum() / valid.sum()
            share = f"{percent:.0f}% of {measured.image} is between {NEAREST:g} and {FARTHEST:g} m"
            self.refuse("SF502", ("depth", "scale"), f"{share}; its median is {median * measured.scale:.4g} m", hint)
        if usable.sum() < FEWEST:
            message = f"{measured.image} has {usable.sum()} usable pixels; at least {FEWEST} are required"
            self.refuse("SF502", ("depth", "image"), message, CHECK_INVALID)
        return np.where(usable, meters, np.nan)

    def masks(self) -> NDArray[np.int32] | None:
        """Return the object number at each pixel, which is 0 for the background.

        The result is None if the frame has no masks.
        """
        masks = self.shot.masks
        if masks is None:
            return None
        hint = "use a single channel with a unique number per object, not colors"
        raw = self.raw(masks.image, ("masks", "image"), hint)
        if raw.dtype.kind not in "bui" or raw.max() > np.iinfo(np.int32).max:
            self.refuse("SF501", ("masks", "image"), f"{masks.image} contains {raw.dtype}, not object numbers", hint)
        labels = raw.astype(np.int32)
        labels[np.isin(labels, masks.background)] = 0
        for name, number in masks.names.items():
            if not (labels == number).any():
                self.fail("SF501", ("masks", "names", name), f"{masks.image} has no pixel with the number {number}")
        return labels

    def raw(self, image: str, path: tuple[str, ...], hint: str) -> NDArray[Any]:
        """Return a single-channel image as stored.

        ``hint`` describes the expected content.
        """
        picture = self.stored(image, path)
        if picture.ndim == 3 and picture.shape[2] == 1:
            picture = picture[:, :, 0]
        if picture.ndim != 2:
            what = f"{picture.shape[2]} channels" if picture.ndim == 3 else f"{picture.ndim} dimensions"
            self.refuse("SF501", path, f"{image} has {what}; one channel is expected", hint)
        return picture

    def stored(self, image: str, path: tuple[str, ...], mode: str = "") -> NDArray[Any]:
        """Return the pixel values in an image file. They are converted to ``mode`` if it is specified."""
        file = self.loaded.file(image)
        try:
            picture = read_image(file, mode)
        except (OSError, ValueError, SyntaxError, EOFError, OverflowError, AttributeError) as error:
            reason = " ".join(str(error).split("\n")[0].split())[:120] or type(error).__name__
            self.refuse("SF501", path, f"{image} could not be read as an image: {reason}", "export it again")
        if picture.size == 0 or picture.ndim == 0 or picture.dtype.kind not in "buif":
            self.refuse("SF501", path, f"{image} does not contain an image: {picture.dtype}, shape {picture.shape}")
        return picture

    def intrinsics(self, camera: Intrinsics, width: int, height: int, path: tuple[str, ...], image: str) -> None:
        """Check that the principal point is inside the image and that the field of view is realistic."""
        if not (0 <= camera.cx < width and 0 <= camera.cy < height):
            message = f"the principal point ({camera.cx:g}, {camera.cy:g}) is outside {image}, {width} x {height}"
            self.fail("SF501", path, message, "are the intrinsics for another resolution?")
        else:
            self.center(camera, width, height, path, image)
        for key, focal, extent in (("fx", camera.fx, width), ("fy", camera.fy, height)):
            if not 0.2 * extent <= focal <= 20 * extent:
                message = f"`{key}` {focal:g} px is implausible for an image of {extent} px"
                self.fail("SF501", (*path, key), message, "specify the focal length in pixels of this image")
        if not 0.5 <= camera.fx / camera.fy <= 2:
            self.fail(
                "SF501",
                path,
                f"`fx` {camera.fx:g} and `fy` {camera.fy:g} imply pixels with an implausible aspect ratio",
            )

    def center(self, camera: Intrinsics, width: int, height: int, path: tuple[str, ...], image: str) -> None:
        """Check that the principal point is plausible.

        If it isn't, the intrinsics may be swapped or may belong to a different image.
        """
        x, y = (camera.cx + 0.5) / width, (camera.cy + 0.5) / height
        message = f"the principal point ({camera.cx:g}, {camera.cy:g}) is far from the middle of {image}"
        if abs(x - 0.5) > 0.2 and abs(x - y) < 0.05:  # scaling moves it along the diagonal, cropping does not
            size = f"{round(2 * camera.cx + 1)} x {round(2 * camera.cy + 1)}"
            hint = f"the intrinsics seem to be for an image of {size}; this image is {width} x {height}"
            self.fail("SF501", path, message, hint)
        elif (abs(x - 0.5) > 0.2 and abs(camera.fx / width - 0.5) < 0.05) or (
            abs(y - 0.5) > 0.2 and abs(camera.fy / height - 0.5) < 0.05
        ):
            self.fail("SF501", path, message, "are `fx` and `cx`, or `fy` and `cy`, swapped?")


def matrix(camera: Intrinsics) -> Array:
    """Return the intrinsic matrix K [px], as an array of shape (3, 3)."""
    return np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])


def _size(picture: NDArray[np.generic] | Array) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]}"
