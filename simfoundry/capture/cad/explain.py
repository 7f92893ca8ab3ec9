"""Correct the segmentation of an image by the models of a library that explain it.

Depth alone cannot tell a part of an object from an object: two pieces of a bowl behind a clamp are two regions, and
scissors that lie on a banana are in its region. A model that is registered with a part of its object shows where all of
it is. Models are registered with the regions that were found, then with the pixels that no model explains so far, with
smooth parts of them, and with pairs. Those that agree with the image wherever they are visible are chosen, the ones
that explain most pixels first, and each pixel belongs to the chosen model whose surface is there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np

from simfoundry.capture.cad.library import CadLibrary
from simfoundry.capture.cad.match import ModelMatch, best_match
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.segment.decompose import (
    EDGE_ZONE,
    LOW,
    MIN_PIXELS,
    initial_regions,
    is_within,
    standing_mask,
)
from simfoundry.capture.segment.masks import Labels, Mask, components, disk, grown, opened
from simfoundry.capture.segment.merge_regions import compact
from simfoundry.capture.segment.regions import pixel_area
from simfoundry.capture.segment.support_graph import carriers, parts_of
from simfoundry.capture.shapes.evidence import depth_scale, gather
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.geometry.frames import Array

# Rounds of registration: regions, what they leave, and what that leaves.
ROUNDS = 3

# Least share of the visible part of a model that must be where a surface was measured, least share of the pixels of its
# region that it must explain, and largest cost of its registration beyond the share that it leaves. On six piles, right
# models have at least 0.89, 0.55 and at most 0.15, wrong ones at most 0.87, or a cost of at least 0.3.
PRECISE, OWN_SHARE, MAX_COST = 0.85, 0.4, 0.25

# For pixels that are no region of the segmentation: least precision, largest cost, and least share of the silhouette
# of the model that explains something. Any carton explains a small plane if most of it is hidden. On eight piles,
# right models have at least 0.89, 0.52 and at most 0.32, wrong ones a share of at most 0.4 or a cost of at least 0.39.
PRECISE_REST, MAX_COST_REST, VISIBLE = 0.88, 0.33, 0.45

# For pixels that are in no region at all, and may show the room behind the table: least precision, largest cost, least
# share of these pixels that the model must explain, and least share of them above the support and away from its edge.
PRECISE_ALONE, MAX_COST_ALONE, OWN_ALONE, WITHIN = 0.95, 0.25, 0.9, 0.9

# Least share of the pixels that a model explains that no other chosen model explains.
NEW_SHARE = 0.5

# Fewest pixels that a model must explain to be chosen: with fewer, many models agree.
FEWEST = 100

# Width [px] of the rim of a model within which pixels belong to it though its surface is not there: flying pixels, and
# the error of its pose.
RIM = 4

# Radius [px] of the narrowest remainder that may be an object, and its least height above the support [m]: what is
# lower is the support beside an object. If more than a share of the region of a model is left, the model is not sure,
# because lookalikes explain three quarters: mixed pixels of a time-of-flight camera behind a mug are 7 % of its region.
NARROW, FLAT, LEFT_SHARE = 2, 0.01, 0.15

# Pairs of remainders that are tried in each round: those that are nearest to each other in space, and the largest gap.
MAX_PAIRS, PAIR_GAP = 4, 0.08

# Largest number of remainders that are tried in each round, those of most pixels first: each takes 2 s.
MAX_REMAINDERS = 5

# Least area of a remainder that is an object without a model [m²]: behind a mug, mixed pixels cover 11 cm².
LARGE = 2e-3

# Smooth parts of a remainder are tried as well, unless a part is this share of it or more.
MOST_OF_IT = 0.85

# A model is a candidate for an object that overlaps the pixels with which it was registered by more than this (IoU).
SAME = 0.7


@dataclass(frozen=True, eq=False)
class CadSegmentation:
    """A segmentation that was corrected by models, and the best model for each object, by number."""

    segmentation: Segmentation
    matches: dict[int, ModelMatch] = field(default_factory=dict)


# Pixels with which models are registered, and those of the region around them, shape (h, w).
_Seed = tuple[Mask, Mask]

_Source = Literal["region", "rest", "alone"]


@dataclass(frozen=True, eq=False)
class _Instance:
    """A model at a pose.

    ``agree`` are the pixels at which its surface was measured, with ``distance`` [m] to it, ``silhouette`` all its
    pixels, and ``precision`` the share of its visible part at which it was measured. ``seed`` are the pixels with which
    it was registered, and ``whole`` those of the region around it, all of which it must explain together with other
    models. All have shape (h, w). ``source`` tells what the seed is: a region, the rest of one, or in no region.
    """

    match: ModelMatch
    seed: Mask
    whole: Mask
    silhouette: Mask
    agree: Mask
    distance: Array
    precision: float
    source: _Source

    @property
    def gain(self) -> float:
        """The number of pixels that the model explains, less ten for each that it contradicts."""
        count = int(self.agree.sum())
        return count - 10 * count * (1 / max(self.precision, 0.1) - 1)

    @property
    def is_sure(self) -> bool:
        """True if the model agrees with the image wherever it is visible, and explains much of its seed."""
        count = int(self.agree.sum())
        own = float((self.agree & self.seed).sum()) / max(1, int(self.seed.sum()))
        if count < FEWEST or own < OWN_SHARE:
            return False
        if self.source == "region":
            return self.precision >= PRECISE and self.match.cost - (1 - own) <= MAX_COST
        if count < VISIBLE * int(self.silhouette.sum()):
            return False
        if self.source == "alone":
            return self.precision >= PRECISE_ALONE and self.match.cost <= MAX_COST_ALONE and own >= OWN_ALONE
        return self.precision >= PRECISE_REST and self.match.cost <= MAX_COST_REST


def explained_segmentation(
    frame: Frame, support: SupportSurface, segmentation: Segmentation, library: CadLibrary
) -> CadSegmentation:
    """Return a segmentation that the models of a library explain better, with the models.

    Regions that no model explains stay as they are, apart from pixels that belong to others.
    """
    scene = _Scene.of(frame.cleaned(), support)
    labels = segmentation.labels
    tried: dict[bytes, _Instance | None] = {}
    chosen: list[_Instance] = []
    smooth = None
    for _ in range(ROUNDS):
        before = chosen
        seeds = list(_seeds(scene, labels, chosen))
        _register(scene, library, [(seed, seed) for seed in (_largest(seeds) if chosen else seeds)], labels, tried)
        chosen = _chosen(scene, tried)
        left = [seed for seed in _seeds(scene, labels, chosen) if (labels[seed] > 0).any()]
        if left:
            smooth = initial_regions(scene.frame, scene.points_W, support) if smooth is None else smooth
            _register(scene, library, _parts(smooth, labels, left), labels, tried)
            chosen = _chosen(scene, tried)
        pairs = _pairs(scene, _largest(list(_seeds(scene, labels, chosen))))
        _register(scene, library, [(pair, pair) for pair in pairs], labels, tried)
        chosen = _chosen(scene, tried)
        if chosen == before:
            break
    chosen = _of_explained_regions(scene, chosen)
    return _corrected(scene, segmentation, chosen, [one for one in tried.values() if one is not None])


@dataclass(frozen=True, eq=False)
class _Scene:
    """An image: its points in the world (h, w, 3) [m], and the pixels that stand on the support."""

    frame: Frame
    support: SupportSurface
    points_W: Array
    standing: Mask

    @classmethod
    def of(cls, frame: Frame, support: SupportSurface) -> _Scene:
        points_W = support.X_WC.apply(frame.points)
        standing = standing_mask(frame.depth, points_W, support)
        return cls(frame, support, points_W, standing)

    def instance(self, match: ModelMatch, template: MeshTemplate, seed: _Seed, source: _Source) -> _Instance:
        """Compare a model with all of the image."""
        eye, frame = self.support.X_WC.p, self.frame
        vertices = match.X_WO.apply(template.vertices)
        window = self._window(vertices)
        rows, columns = np.mgrid[window]
        rays = np.stack([(columns - frame.K[0, 2]) / frame.K[0, 0], (rows - frame.K[1, 2]) / frame.K[1, 1],
                         np.ones(rows.shape)], axis=-1).reshape(-1, 3) @ self.support.X_WC.rotation.T  # fmt: skip
        hits = cast_mesh(eye, rays, vertices, template.faces)
        depth, slant = hits.depth.reshape(rows.shape), hits.slant.reshape(rows.shape)
        measured = frame.depth[window]
        hit, known = np.isfinite(depth), np.isfinite(measured)
        gap = np.where(hit & known, np.where(known, measured, 0) - np.where(hit, depth, 0), 0)
        scale = depth_scale(float(np.median(measured[hit & known]))) if (hit & known).any() else 0.01
        near = hit & known & (np.abs(gap) * slant < scale) & self.standing[window]
        missed = hit & known & ~near & (gap > scale)  # the camera saw through the model
        distance = np.full(frame.depth.shape, np.inf)
        distance[window] = np.where(near, np.abs(gap) * slant, np.inf)
        agree, silhouette = np.zeros((2, *frame.depth.shape), dtype=bool)
        agree[window], silhouette[window] = near, hit
        precision = float(near.sum()) / max(1, int(near.sum() + missed.sum()))
        return _Instance(match, *seed, silhouette, agree, distance, precision, source)

    def _window(self, vertices: Array) -> tuple[slice, slice]:
        """Return the rows and columns of the image in which points of the world are."""
        p = self.support.X_WC.inverse().apply(vertices)
        K, (h, w) = self.frame.K, self.frame.depth.shape
        z = np.maximum(p[:, 2], 1e-3)
        u, v = p[:, 0] / z * K[0, 0] + K[0, 2], p[:, 1] / z * K[1, 1] + K[1, 2]
        left, right = (int(np.clip(x, 0, w - 1)) for x in (u.min() - 2, u.max() + 2))
        top, bottom = (int(np.clip(y, 0, h - 1)) for y in (v.min() - 2, v.max() + 2))
        return slice(top, bottom + 1), slice(left, right + 1)


def _explained(scene: _Scene, chosen: list[_Instance]) -> Mask:
    """Return a mask of the pixels that chosen models explain."""
    out = np.zeros(scene.standing.shape, dtype=bool)
    for one in chosen:
        out |= one.agree
    return out


def _seeds(scene: _Scene, labels: Labels, chosen: list[_Instance]) -> Iterator[Mask]:
    """Yield the regions of the segmentation without the pixels that models explain, and what was in no region."""
    explained = _explained(scene, chosen)
    for k in range(int(labels.max()) + 1):
        if k == 0 and not chosen:
            continue  # first the regions: what else there is may be background
        region = labels == k if k else (labels == 0) & scene.standing
        rest = region & ~explained
        if k and rest.sum() == region.sum():
            yield region
            continue
        rims = np.zeros_like(rest)
        for one in chosen:
            if (one.agree & region).any() or k == 0:
                rims |= grown(one.agree, disk(1))
        inner = opened(rest & ~rims, disk(NARROW))
        parts, areas = components(inner, connectivity=8)
        if k and (areas >= MIN_PIXELS).sum() > 1:
            yield grown(inner, disk(NARROW)) & rest  # parts of one object, perhaps
        for part in np.flatnonzero(areas >= MIN_PIXELS):
            seed = grown(parts == part, disk(NARROW)) & rest
            points = scene.points_W[seed & np.isfinite(scene.frame.depth)]
            if len(points) < MIN_PIXELS or np.percentile(points[:, 2], 90) <= (FLAT if k else LOW):
                continue
            if k or is_within(scene.support, points[:, :2], -EDGE_ZONE).mean() >= WITHIN:
                yield seed


def _largest(seeds: list[Mask]) -> list[Mask]:
    return sorted(seeds, key=lambda seed: -int(seed.sum()))[:MAX_REMAINDERS]


def _parts(smooth: Labels, labels: Labels, left: list[Mask]) -> list[_Seed]:
    """Return the largest smooth parts of what no model explains, each with the region that it is in."""
    out = []
    for seed in left:
        whole = labels == np.bincount(labels[seed]).argmax()
        for part in np.unique(smooth[seed & (smooth > 0)]):
            mask = seed & (smooth == part)
            if 2 * FEWEST <= mask.sum() < MOST_OF_IT * seed.sum():
                out.append((mask, whole))
    return sorted(out, key=lambda each: -int(each[0].sum()))[:MAX_REMAINDERS]


def _register(
    scene: _Scene, library: CadLibrary, seeds: list[_Seed], labels: Labels, tried: dict[bytes, _Instance | None]
) -> None:
    """Find the best model for each seed that was not tried before, and remember it, or None if there is none."""
    for seed, whole in seeds:
        key = np.packbits(seed).tobytes()
        if key in tried:
            continue
        tried[key] = None
        if int((seed & np.isfinite(scene.frame.depth)).sum()) >= MIN_PIXELS:
            around = np.where(seed, 1, np.where((labels > 0) | scene.standing, 2, 0)).astype(np.int32)
            evidence = gather(scene.frame, scene.support, seed, 0.0, around)
            match = best_match(evidence, library) if len(evidence.points) >= MIN_PIXELS else None
            template = None if match is None else library.template(library.named(match.model))
            if match is not None and template is not None:
                source = _source(seed, labels)
                tried[key] = scene.instance(match, template, (seed, whole), source)


def _source(seed: Mask, labels: Labels) -> _Source:
    inside = labels[seed]
    if float((inside > 0).mean()) < 0.5:
        return "alone"
    k = int(inside[0])
    return "region" if (inside == k).all() and len(inside) == int((labels == k).sum()) else "rest"


def _chosen(scene: _Scene, tried: dict[bytes, _Instance | None]) -> list[_Instance]:
    """Return the models that agree with the image and explain what no other does, those of most pixels first."""
    explained: Mask = np.zeros(scene.standing.shape, dtype=bool)
    out = []
    sure = [one for one in tried.values() if one is not None and one.is_sure]
    for one in sorted(sure, key=lambda one: -one.gain):
        if int((one.agree & ~explained).sum()) >= max(FEWEST, NEW_SHARE * int(one.agree.sum())):
            out.append(one)
            explained |= one.agree
    return out


def _of_explained_regions(scene: _Scene, chosen: list[_Instance]) -> list[_Instance]:
    """Return the models whose regions are explained, together with the other models.

    A model that explains only a part of a region is right if something else is there, or a lookalike of the object.
    """
    explained = grown(_explained(scene, chosen), disk(NARROW)) | (scene.points_W[..., 2] < FLAT)
    left = [float((one.whole & ~explained).sum()) / max(1, int(one.whole.sum())) for one in chosen]
    kept = [one for one, share in zip(chosen, left, strict=True) if share <= LEFT_SHARE]
    return kept if len(kept) == len(chosen) else _of_explained_regions(scene, kept)


def _pairs(scene: _Scene, seeds: list[Mask]) -> Iterator[Mask]:
    """Yield the unions of two seeds that are close to each other in space, the closest first."""
    from scipy.spatial import cKDTree

    clouds = [scene.points_W[seed & np.isfinite(scene.frame.depth)] for seed in seeds]
    trees = [cKDTree(cloud[:: max(1, len(cloud) // 300)]) for cloud in clouds]
    gaps = []
    for i, j in combinations(range(len(seeds)), 2):
        if len(clouds[i]) and len(clouds[j]):
            gap = float(trees[i].query(trees[j].data)[0].min())
            if gap <= PAIR_GAP:
                gaps.append((gap, i, j))
    for _, i, j in sorted(gaps)[:MAX_PAIRS]:
        yield seeds[i] | seeds[j]


def _corrected(
    scene: _Scene, segmentation: Segmentation, chosen: list[_Instance], tried: list[_Instance]
) -> CadSegmentation:
    """Return the segmentation in which each pixel belongs to the model whose surface is there."""
    old, area = segmentation.labels, pixel_area(scene.frame)
    owner = _owners(old, chosen)
    labels, count = owner.copy(), len(chosen)
    for k in range(1, int(old.max()) + 1):
        rest = (old == k) & (owner == 0)
        within = np.bincount(owner[(old == k) & (owner > 0)], minlength=1)
        if rest.sum() > LEFT_SHARE * (old == k).sum():  # something in the region has no model
            count += 1
            labels[rest] = count
            continue
        labels[rest] = int(np.argmax(within))
        parts, sizes = components(opened(rest, disk(NARROW)), connectivity=8)
        for part in np.flatnonzero(sizes >= MIN_PIXELS):
            new = grown(parts == part, disk(NARROW)) & rest
            if float(np.nansum(area[new])) >= LARGE:
                count += 1
                labels[new] = count
    labels = compact(labels)
    numbers = {int(i): int(labels[owner == i][0]) for i in np.unique(owner[owner > 0])}
    matches = {numbers[i]: replace(one.match, is_sure=True) for i, one in enumerate(chosen, 1) if i in numbers}
    for k in range(1, int(labels.max()) + 1):
        if k not in matches:
            near = [one for one in tried if _overlap(one.seed, labels == k) > SAME]
            if near:
                matches[k] = min(near, key=lambda one: one.match.cost).match
    supports = carriers(parts_of(labels, scene.points_W, area))
    return CadSegmentation(Segmentation(labels, supports, segmentation.pieces, segmentation.unmet), matches)


def _owners(old: Labels, chosen: list[_Instance]) -> Labels:
    """Return the number of the model that each pixel belongs to, from 1, or 0."""
    owner = np.zeros(old.shape, np.int32)
    best = np.full(old.shape, np.inf)
    for i, one in enumerate(chosen, 1):
        closer = one.distance < best
        owner[closer], best[closer] = i, one.distance[closer]
    rims = np.zeros_like(owner)
    for i, one in enumerate(chosen, 1):
        rims[grown(one.agree, disk(RIM)) & (owner == 0) & (old > 0) & (rims == 0)] = i
    return np.where(owner > 0, owner, rims).astype(np.int32)


def _overlap(a: Mask, b: Mask) -> float:
    return float((a & b).sum()) / max(1, int((a | b).sum()))
