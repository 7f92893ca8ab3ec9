"""The methods that need no model, on scenes whose truth is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh

from simfoundry.models.contract import ModelError
from simfoundry.models.offline import OfflineDepth, OfflineImages, OfflineMasks, OfflineMeshes
from simfoundry.models.tasks.masks import SegmentationPrompt, mask_overlap

RNG = np.random.default_rng(3)


def _texture(height: int, width: int) -> np.ndarray:
    noise = RNG.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.2), np.uint8)


def test_stereo_finds_two_depths() -> None:
    far, near = _texture(120, 260), _texture(60, 100)
    left, right = far[:, 30:230].copy(), far[:, 34:234].copy()  # disparity 4
    left[30:90, 60:160], right[30:90, 48:148] = near, near  # disparity 12
    K = np.array([[200.0, 0, 99.5], [0, 200.0, 59.5], [0, 0, 1]])
    found = OfflineDepth().match_stereo(left, right, K, 0.06)
    assert np.median(found.depth[40:80, 80:140]) == pytest.approx(200 * 0.06 / 12, rel=0.01)
    assert np.median(found.depth[:25, 40:][found.valid[:25, 40:]]) == pytest.approx(200 * 0.06 / 4, rel=0.01)
    assert found.valid.mean() > 0.7 and (found.depth[~found.valid] == 0).all()
    with pytest.raises(ModelError, match="need texture"):
        OfflineDepth().match_stereo(np.zeros_like(left), np.zeros_like(left), K, 0.06)


def test_a_hole_in_a_plane_is_filled_exactly() -> None:
    v, u = np.mgrid[:40, :60]
    depth = (1 / (0.8 + 0.004 * u - 0.006 * v)).astype(np.float32)  # the inverse depth of a plane is linear
    mask = np.zeros(depth.shape, bool)
    mask[10:30, 15:45] = True
    prior = np.where(mask, 0, depth)
    prior[3, 3] = np.nan
    filled = OfflineDepth().complete_depth(np.zeros((40, 60, 3), np.uint8), prior, mask).depth
    np.testing.assert_allclose(filled, depth, rtol=1e-4)
    with pytest.raises(ModelError, match="no depth"):
        OfflineDepth().complete_depth(np.zeros((40, 60, 3), np.uint8), 0 * depth, mask)


def test_boxes_and_points_give_the_disk() -> None:
    image = np.full((80, 100, 3), (60, 90, 60), np.uint8) + RNG.integers(0, 12, (80, 100, 3), dtype=np.uint8)
    truth = (np.hypot(*np.mgrid[-40:40, -50:50]) < 18).astype(bool)
    image[truth] = (200, 60, 40)
    found = OfflineMasks().segment(image, SegmentationPrompt(boxes=((26, 16, 74, 64),)))
    assert mask_overlap(found.masks[0], truth) > 0.97
    points = OfflineMasks().segment(image, SegmentationPrompt(points=((50, 40, 1), (5, 5, 0))))
    assert mask_overlap(points.masks[0], truth) > 0.9
    with pytest.raises(ModelError, match="phrases can only be found by a model"):
        OfflineMasks().segment(image, SegmentationPrompt(phrases=("disk",)))
    nothing = OfflineMasks().segment(image, SegmentationPrompt(boxes=((-5, -5, -1, -1),)))
    assert len(nothing.masks) == 0


def test_masks_follow_a_moving_patch_both_ways() -> None:
    ground, patch = _texture(80, 100), _texture(24, 24)
    frames, truths = [], []
    for t in range(4):
        frame, truth = ground.copy(), np.zeros((80, 100), bool)
        frame[20 + t : 44 + t, 30 + 3 * t : 54 + 3 * t] = patch
        truth[20 + t : 44 + t, 30 + 3 * t : 54 + 3 * t] = True
        frames.append(frame)
        truths.append(truth)
    found = OfflineMasks().track(frames, truths[1][None], keyframe=1).masks
    assert (found[1, 0] == truths[1]).all()
    assert all(mask_overlap(found[t, 0], truths[t]) > 0.7 for t in (0, 2, 3))


def test_a_hole_in_an_even_picture_is_filled_evenly() -> None:
    image = np.full((40, 40, 3), (10, 200, 90), np.uint8)
    mask = np.zeros((40, 40), bool)
    mask[10:20, 10:20] = True
    image[mask] = 0
    assert (
        np.abs(OfflineImages().inpaint(image, mask).image.astype(int) - (10, 200, 90)).max() <= 3
    )  # levels, by rounding
    video = OfflineImages().inpaint_video([image] * 2, np.stack([mask] * 2))
    assert len(video.frames) == 2 and (video.frames[1][~mask] == (10, 200, 90)).all()


def test_pieces_of_a_mesh_are_its_parts() -> None:
    boxes = [
        trimesh.creation.box((0.1, 0.1, 0.1), transform=trimesh.transformations.translation_matrix((x, 0, 0)))
        for x in (0, 1)
    ]
    mesh = trimesh.util.concatenate(boxes)
    labels = OfflineMeshes().segment_mesh(mesh.vertices, mesh.faces.astype(np.int32)).labels
    assert labels.tolist() == [0] * 12 + [1] * 12
