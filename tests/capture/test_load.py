"""Capture files in: what is right arrives as it was measured, what is wrong is said with its place and its remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simfoundry.capture.frame import Frame
from simfoundry.capture.frames.load import load_frame, matrix
from simfoundry.capture.frames.sensors import register
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.spec.diagnostics import Diagnostic, SpecError
from simfoundry.spec.load import load_capture
from simfoundry.spec.models.capture import Intrinsics
from tests.capture.captures import HEIGHT, WIDTH, color, cut, edit, plane, write

NPY = ("image: depth.png", "image: depth.npy")
MASKS = ("    camera:", "    masks: {image: masks.png}\n    camera:")
DEPTH_CAMERA = "      camera: {fx: 150, fy: 150, cx: 79.5, cy: 59.5}\n      pose: {xyz: [%s, 0, 0]}\n"


def frame_of(folder: Path, name: str | None = None) -> Frame:
    return load_frame(load_capture(folder / "capture.yaml"), name)


def findings_of(folder: Path, name: str | None = None) -> list[Diagnostic]:
    with pytest.raises(SpecError) as caught:
        frame_of(folder, name)
    return caught.value.diagnostics


def only(folder: Path) -> Diagnostic:
    findings = findings_of(folder)
    assert len(findings) == 1, findings
    return findings[0]


def save(folder: Path, name: str, picture: np.ndarray) -> None:
    Image.fromarray(picture).save(folder / name)


def save_npy(folder: Path, picture: np.ndarray) -> None:
    edit(folder, *NPY)
    np.save(folder / "depth.npy", picture)


def test_what_is_measured_arrives(tmp_path: Path) -> None:
    depth = plane()
    depth[3, 5], depth[7, 9], depth[11, 13] = 0.0, 0.05, 30.0  # no measurement, too near, too far
    frame = frame_of(write(tmp_path, depth=depth))
    lost = np.isnan(frame.depth)
    assert set(zip(*(i.tolist() for i in np.nonzero(lost)), strict=True)) == {(3, 5), (7, 9), (11, 13)}
    assert np.abs(frame.depth - depth)[~lost].max() <= 0.0005
    assert np.array_equal(frame.color, color())
    assert frame.K.tolist() == [[150, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]
    assert frame.instances is None


def test_nan_negative_and_infinite_depth_are_no_measurement(tmp_path: Path) -> None:
    folder, depth = write(tmp_path), plane().astype(np.float32)
    depth[0, :4] = np.nan, -0.8, np.inf, -np.inf
    save_npy(folder, depth)
    edit(folder, "scale: 0.001", "scale: 1")
    frame = frame_of(folder)
    assert np.isnan(frame.depth[0, :4]).all() and np.isfinite(frame.depth).sum() == WIDTH * HEIGHT - 4
    assert frame.depth[50, 60] == pytest.approx(plane()[50, 60], rel=1e-6)


@pytest.mark.parametrize(("scale", "is_known"), [("0.00025", True), ("0.001004", True), ("0.0015", False)])
def test_a_unit_that_no_camera_has_is_doubted(tmp_path: Path, scale: str, is_known: bool) -> None:
    folder = write(tmp_path)
    edit(folder, "scale: 0.001", f"scale: {scale}")
    assert [f.code for f in frame_of(folder).findings] == ([] if is_known else ["SF628"])


def test_values_named_invalid_are_no_measurement(tmp_path: Path) -> None:
    folder = write(tmp_path)
    raw = np.rint(plane() * 1000)
    value = int(raw[70, 80])
    edit(folder, "scale: 0.001", f"scale: 0.001\n      invalid: [0, {value}]")
    assert np.array_equal(np.isnan(frame_of(folder).depth), raw == value)


def test_a_palette_of_masks_keeps_its_numbers(tmp_path: Path) -> None:
    folder = write(tmp_path)
    edit(folder, "    camera:", "    masks: {image: masks.png, background: [0, 9], names: {mug: 3}}\n    camera:")
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[10:20, 30:50], labels[40:60, 70:80], labels[90:95] = 3, 7, 9
    picture = Image.fromarray(labels, mode="P")
    picture.putpalette([v for k in range(256) for v in (255 - k, k, 40)])
    picture.save(folder / "masks.png")
    expected = np.where(labels == 9, 0, labels)
    assert np.array_equal(np.asarray(frame_of(folder).instances), expected)


def test_an_exif_turn_moves_no_pixel(tmp_path: Path) -> None:
    folder = write(tmp_path)
    exif = Image.Exif()
    exif[0x0112] = 3  # turned by 180 degrees, as phones note it
    Image.fromarray(color()).save(folder / "color.png", exif=exif)
    assert np.array_equal(frame_of(folder).color, color())


def test_a_misspelled_frame(tmp_path: Path) -> None:
    folder = write(tmp_path)
    other = (
        "  front_left: {color: color.png, depth: {image: depth.png}, camera: {fx: 150, fy: 150, cx: 79.5, cy: 59.5}}\n"
    )
    (folder / "capture.yaml").write_text((folder / "capture.yaml").read_text() + other)
    assert frame_of(folder, "front_left").depth.shape == (HEIGHT, WIDTH)
    finding = findings_of(folder, "frontleft")[0]
    assert (finding.code, finding.line, finding.column) == ("SF201", 3, 1)
    assert finding.hint == "did you mean `front_left`?"


def _wrong_size(folder: Path) -> None:
    save(folder, "depth.png", np.full((60, 80), 800, np.uint16))


def _cut_color(folder: Path) -> None:
    cut(folder / "color.png")


def _cut_depth(folder: Path) -> None:
    cut(folder / "depth.png", 0.9)


def _text(folder: Path) -> None:
    (folder / "color.png").write_text("no picture")


def _empty(folder: Path) -> None:
    (folder / "depth.png").write_bytes(b"")


def _all_invalid(folder: Path) -> None:
    save(folder, "depth.png", np.zeros((HEIGHT, WIDTH), np.uint16))


def _all_nan(folder: Path) -> None:
    save_npy(folder, np.full((HEIGHT, WIDTH), np.nan))


def _meters_as_millimeters(folder: Path) -> None:
    save_npy(folder, plane())


def _millimeters_as_meters(folder: Path) -> None:
    edit(folder, "scale: 0.001", "scale: 1")


def _millimeters_as_tenths(folder: Path) -> None:
    edit(folder, "scale: 0.001", "scale: 0.0001")


def _tenths_as_millimeters(folder: Path) -> None:
    save(folder, "depth.png", np.rint(plane() * 10000).astype(np.uint16))


def _eight_bits(folder: Path) -> None:
    Image.fromarray(np.full((HEIGHT, WIDTH), 80, np.uint8)).save(folder / "depth.png")


def _channels(folder: Path) -> None:
    save(folder, "depth.png", color())


def _words(folder: Path) -> None:
    save_npy(folder, np.full((HEIGHT, WIDTH), "far"))


def _scalar(folder: Path) -> None:
    save_npy(folder, np.array(0.8))


def _row(folder: Path) -> None:
    save_npy(folder, np.full(WIDTH * HEIGHT, 800))


def _pickled(folder: Path) -> None:
    edit(folder, *NPY)
    np.save(folder / "depth.npy", np.array([{}]), allow_pickle=True)


def _cut_npy(folder: Path) -> None:
    save_npy(folder, plane())
    cut(folder / "depth.npy")


def _hardly_any(folder: Path) -> None:
    depth = np.zeros((HEIGHT, WIDTH), np.uint16)
    depth[50, :60] = 800
    save(folder, "depth.png", depth)


def _masks_of_another_size(folder: Path) -> None:
    edit(folder, *MASKS)
    save(folder, "masks.png", np.ones((60, 80), np.uint8))


def _masks_in_color(folder: Path) -> None:
    edit(folder, *MASKS)
    save(folder, "masks.png", color())


def _fractional_masks(folder: Path) -> None:
    edit(folder, MASKS[0], MASKS[1].replace("png", "npy"))
    np.save(folder / "masks.npy", np.full((HEIGHT, WIDTH), 0.5))


def _name_without_pixels(folder: Path) -> None:
    edit(folder, "    camera:", "    masks: {image: masks.png, names: {mug: 4}}\n    camera:")
    save(folder, "masks.png", np.ones((HEIGHT, WIDTH), np.uint8))


def _larger_intrinsics(folder: Path) -> None:
    edit(folder, "cx: 79.5, cy: 59.5", "cx: 319.5, cy: 239.5")


def _smaller_intrinsics(folder: Path) -> None:
    edit(folder, "cx: 79.5, cy: 59.5", "cx: 39.5, cy: 29.5")


def _absurd_focal(folder: Path) -> None:
    edit(folder, "fx: 150", "fx: 15000")


def _swapped(folder: Path) -> None:
    edit(folder, "{fx: 150, fy: 150, cx: 79.5, cy: 59.5}", "{fx: 79.5, fy: 130, cx: 140, cy: 59.5}")


def _flat_pixels(folder: Path) -> None:
    edit(folder, "fx: 150", "fx: 600")


def _looks_elsewhere(folder: Path) -> None:
    edit(folder, "    camera:", f"{DEPTH_CAMERA % '9'}    camera:")


BAD = {
    "sizes": (_wrong_size, "SF501", (7, 14), "80 x 60, but color.png is 160 x 120", "register depth to color"),
    "cut color": (_cut_color, "SF501", (5, 12), "color.png could not be read as an image", "export it again"),
    "cut depth": (_cut_depth, "SF501", (7, 14), "depth.png could not be read as an image", "export it again"),
    "text": (_text, "SF501", (5, 12), "cannot identify image file", "export it again"),
    "empty": (_empty, "SF501", (7, 14), "depth.png could not be read as an image", "export it again"),
    "all 0": (_all_invalid, "SF502", (7, 14), "all values are invalid", "check `invalid`"),
    "all NaN": (_all_nan, "SF502", (7, 14), "all values are invalid", "check `invalid`"),
    "m as mm": (_meters_as_millimeters, "SF502", (8, 14), "median is 0.0008 m", "meters; use `scale: 1`"),
    "mm as m": (_millimeters_as_meters, "SF502", (8, 14), "median is 800 m", "millimeters; use `scale: 0.001`"),
    "mm as 0.1 mm": (_millimeters_as_tenths, "SF502", (8, 14), "median is 0.08 m", "millimeters; use `scale: 0.001`"),
    "0.1 mm as mm": (_tenths_as_millimeters, "SF502", (8, 14), "0% of depth.png", "tenths of a millimeter"),
    "channels": (_channels, "SF501", (7, 14), "depth.png has 3 channels", "16-bit PNG"),
    "8 bits": (_eight_bits, "SF501", (7, 14), "depth.png has 8 bits per pixel", "16-bit PNG"),
    "words": (_words, "SF501", (7, 14), "does not contain an image", ""),
    "scalar": (_scalar, "SF501", (7, 14), "does not contain an image", ""),
    "row": (_row, "SF501", (7, 14), "has 1 dimensions", "16-bit PNG"),
    "pickle": (_pickled, "SF501", (7, 14), "could not be read", "export it again"),
    "cut npy": (_cut_npy, "SF501", (7, 14), "could not be read", "export it again"),
    "hardly any": (_hardly_any, "SF502", (7, 14), "60 usable pixels", "check `invalid`"),
    "masks size": (_masks_of_another_size, "SF501", (9, 20), "80 x 60", "pixel by pixel"),
    "masks color": (_masks_in_color, "SF501", (9, 20), "3 channels", "a unique number per object"),
    "masks fraction": (_fractional_masks, "SF501", (9, 20), "float64", "a unique number per object"),
    "masks name": (_name_without_pixels, "SF501", (9, 44), "no pixel with the number 4", ""),
    "intrinsics larger": (_larger_intrinsics, "SF501", (9, 5), "(319.5, 239.5) is outside", "another resolution"),
    "intrinsics smaller": (_smaller_intrinsics, "SF501", (9, 5), "far from the middle", "an image of 80 x 60"),
    "focal": (_absurd_focal, "SF501", (9, 18), "`fx` 15000 px", "in pixels"),
    "swapped": (_swapped, "SF501", (9, 5), "far from the middle", "swapped"),
    "aspect": (_flat_pixels, "SF501", (9, 5), "implausible aspect ratio", ""),
    "looks elsewhere": (_looks_elsewhere, "SF501", (10, 7), "almost none of the points", "inverted"),
}


@pytest.mark.parametrize(("spoil", "code", "place", "message", "hint"), BAD.values(), ids=BAD)
def test_each_fault_has_its_finding(
    tmp_path: Path, spoil: Callable[[Path], None], code: str, place: tuple[int, int], message: str, hint: str
) -> None:
    folder = write(tmp_path)
    spoil(folder)
    findings = findings_of(folder)
    assert code in {d.code for d in findings}
    finding = next(d for d in findings if d.code == code and message in d.message)
    assert (finding.line, finding.column) == place
    assert hint in finding.hint
    assert finding.file == str(folder / "capture.yaml")


def test_all_faults_are_said_at_once(tmp_path: Path) -> None:
    folder = write(tmp_path)
    _cut_color(folder)
    _channels(folder)
    _masks_in_color(folder)
    assert [d.path for d in findings_of(folder)] == [
        "frames.view.color",
        "frames.view.depth.image",
        "frames.view.masks.image",
    ]


@pytest.mark.parametrize("crop", ["{fx: 150, fy: 150, cx: 20, cy: 59.5}", "{fx: 150, fy: 150, cx: 79.5, cy: 100}"])
def test_a_cropped_picture_is_fine(tmp_path: Path, crop: str) -> None:
    folder = write(tmp_path)
    edit(folder, "{fx: 150, fy: 150, cx: 79.5, cy: 59.5}", crop)
    assert np.isfinite(frame_of(folder).depth).all()


def test_far_walls_do_not_make_the_unit_wrong(tmp_path: Path) -> None:
    depth = plane()
    depth[: HEIGHT // 2] = 6.5
    frame = frame_of(write(tmp_path, depth=depth))
    assert np.isnan(frame.depth[: HEIGHT // 2]).all() and np.isfinite(frame.depth[HEIGHT // 2 :]).all()


def test_depth_moves_into_the_color_camera() -> None:
    """A slanted plane seen by a turned, shifted depth camera gives the plane that the color camera would measure."""
    K_depth = matrix(Intrinsics(fx=140, fy=146, cx=70, cy=64))
    K_color = matrix(Intrinsics(fx=150, fy=152, cx=79.5, cy=59.5))
    X_color_depth = Pose.of([0.03, -0.02, 0.01], quat_from_rpy(0.04, -0.06, 0.09))
    normal, offset = np.array([0.1, -0.5, -0.86]), -0.7  # the plane n . p = offset in the color camera
    n_depth = X_color_depth.rotation.T @ normal
    offset_depth = offset - float(normal @ X_color_depth.p)

    def depth_of(K: np.ndarray, n: np.ndarray, d: float) -> np.ndarray:
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones((HEIGHT, WIDTH))], axis=-1)
        return np.asarray(d / (rays @ n))

    seen = register(depth_of(K_depth, n_depth, offset_depth), K_depth, X_color_depth, K_color, (HEIGHT, WIDTH))
    expected = depth_of(K_color, normal, offset)
    both = np.isfinite(seen)
    assert both[30:90, 40:120].mean() > 0.99
    assert np.abs(seen - expected)[both].max() < 0.012  # one pixel of this slope
    assert abs(float(np.median((seen - expected)[both]))) < 0.004


def test_a_document_that_is_no_capture(tmp_path: Path) -> None:
    folder = write(tmp_path)
    edit(folder, "name: desk", "name: My Desk")
    with pytest.raises(SpecError) as caught:
        load_capture(folder / "capture.yaml")
    finding = caught.value.diagnostics[0]
    assert (finding.line, finding.column, finding.path) == (2, 7, "name")
    assert "lower" in finding.hint + finding.message
