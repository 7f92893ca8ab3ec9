"""What a person states about the objects in a capture, and what the segmentation and the fit make of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simfoundry.capture.frame import Frame, Segmentation
from simfoundry.capture.frames.load import load_frame
from simfoundry.capture.reconstruct import fit_segments
from simfoundry.capture.segment.constraints import without_occluders
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.geometry.shapes import Cylinder as CylinderGeometry
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_capture
from simfoundry.spec.models.capture import Decomposition
from tests.capture import captures
from tests.capture.pictures import Box, Cylinder, Setup, photograph

# A box in front of a wider one, a box in front of a can, and two boxes that touch and look like one.
FRONT_AND_BACK = Setup((Box((0.12, 0.0, 0.09), (0.06, 0.26, 0.18)), Box((-0.06, 0.0, 0.08), (0.05, 0.09, 0.16))))
CAN_BEHIND_GLASS = Setup((Cylinder((0.08, 0.0, 0.08), 0.08, 0.16), Box((-0.05, 0.05, 0.09), (0.04, 0.1, 0.18))))
SIDE_BY_SIDE = Setup((Box((0.0, 0.06, 0.06), (0.1, 0.12, 0.12)), Box((0.0, -0.06, 0.06), (0.1, 0.12, 0.12))))


def middle(mask: np.ndarray) -> tuple[int, int]:
    """The pixel (column, row) of a mask that is nearest to its mean."""
    rows, columns = np.nonzero(mask)
    at = np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2)
    return int(columns[at]), int(rows[at])


def segmented(frame: Frame, given: Decomposition) -> Segmentation:
    frame = replace(frame, decomposition=given)
    return decompose(frame, find_support(frame))


def share(found: Segmentation, name: str, truth: np.ndarray, item: int) -> float:
    """Intersection over union of a named piece and a true object."""
    mask = found.labels == found.pieces[name]
    return float((mask & (truth == item)).sum() / (mask | (truth == item)).sum())


def test_what_looks_like_one_is_divided_where_the_pixels_say() -> None:
    frame, truth = photograph(SIDE_BY_SIDE)
    assert decompose(frame, find_support(frame)).labels.max() == 1
    given = Decomposition(pieces={"left": (middle(truth == 1),), "right": (middle(truth == 2),)})
    found = segmented(frame, given)
    assert sorted(found.pieces) == ["left", "right"] and found.unmet == ()
    assert sorted(found.supports) == sorted(found.pieces.values()) == [1, 2]
    assert share(found, "left", truth, 1) > 0.85 and share(found, "right", truth, 2) > 0.85


def test_what_looks_like_two_is_one_piece() -> None:
    frame, truth = photograph(FRONT_AND_BACK)
    found = segmented(frame, Decomposition(pieces={"chair": (middle(truth == 1), middle(truth == 2))}))
    assert found.pieces == {"chair": 1} and found.labels.max() == 1
    both = truth > 0
    assert ((found.labels == 1) & both).sum() / ((found.labels == 1) | both).sum() > 0.85


def test_what_is_no_object_is_left_out_and_the_numbers_stay_dense() -> None:
    frame, truth = photograph(FRONT_AND_BACK)
    found = segmented(frame, Decomposition(ignore=(middle(truth == 2),)))
    assert np.unique(found.labels).tolist() == [0, 1] and sorted(found.supports) == [1]
    assert (found.labels[truth == 2] > 0).mean() < 0.1


def test_pixels_without_an_object_are_reported() -> None:
    frame, truth = photograph(FRONT_AND_BACK)
    found = segmented(frame, Decomposition(pieces={"lid": ((2, 3),), "front": (middle(truth == 2),)}))
    assert sorted(found.pieces) == ["front"]
    assert found.unmet == ("lid: no object was found at the pixels [2, 3]",)


def test_a_segmentation_without_constraints_stays_as_it_was() -> None:
    frame, _ = photograph(FRONT_AND_BACK)
    plain, given = decompose(frame, find_support(frame)), segmented(frame, Decomposition())
    assert plain.labels.tobytes() == given.labels.tobytes() and plain.supports == given.supports


@pytest.mark.slow  # 5 s
def test_an_occluder_whose_depth_is_wrong_does_not_cut_what_is_behind_it() -> None:
    frame, truth = photograph(CAN_BEHIND_GLASS)
    # One sees through the front to the table behind everything, so the can seems to end where the front begins.
    glass = replace(frame, depth=np.where(truth == 2, photograph(Setup(()))[0].depth, frame.depth))
    pieces: dict[str, tuple[tuple[int, int], ...]] = {"can": (middle(truth == 1),), "glass": (middle(truth == 2),)}
    hidden: dict[str, dict[str, tuple[str, ...]]] = {"unstated": {}, "stated": {"glass": ("can",)}}
    found = Segmentation(truth.astype(np.int32), {1: 0, 2: 0}, {"can": 1, "glass": 2})
    support, fitted = find_support(frame), {}
    for name, occludes in hidden.items():
        seen = replace(glass, decomposition=Decomposition(pieces=pieces, occludes=occludes))
        assert bool(np.isnan(without_occluders(seen, found, 1).depth[truth == 2]).all()) == (name == "stated")
        assert without_occluders(seen, found, 2) is seen
        fitted[name] = fit_segments(seen, support, found, lambda stage, share: None)[0][1]
    can = fitted["stated"].geometry
    assert isinstance(can, CylinderGeometry) and not isinstance(fitted["unstated"].geometry, CylinderGeometry)
    assert abs(can.radius - 0.08) < 0.001 and abs(can.height - 0.16) < 0.001
    assert fitted["stated"].confidence > 0.95 > fitted["unstated"].confidence


def test_pixels_outside_of_the_image_and_unknown_pieces_are_errors(tmp_path: Path) -> None:
    folder = captures.write(tmp_path / "a")
    constraints = "    decomposition: {pieces: {cup: [[10, 20]], pot: [[160, 20]]}, occludes: {cup: [pot]}}\n"
    captures.edit(folder, "    camera: {fx", constraints + "    camera: {fx")
    with pytest.raises(SpecError, match=r"SF104.*\[160, 20\] is not in the image, which has 160 x 120"):
        load_frame(load_capture(folder / "capture.yaml"))
    captures.edit(folder, "[160, 20]", "[150, 20]")
    frame = load_frame(load_capture(folder / "capture.yaml"))
    assert frame.decomposition is not None and frame.decomposition.pieces["pot"] == ((150, 20),)
    captures.edit(folder, "{cup: [pot]}", "{cup: [kettle]}")
    with pytest.raises(SpecError, match=r"SF107.*`kettle`, which `pieces` does not define"):
        load_capture(folder / "capture.yaml")
    captures.edit(folder, "{cup: [kettle]}", "{cup: [cup]}")
    with pytest.raises(SpecError, match="`cup` cannot occlude itself"):
        load_capture(folder / "capture.yaml")
