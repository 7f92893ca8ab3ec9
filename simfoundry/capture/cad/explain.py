"""Correct the segmentation of an image by the models of a library that explain it.

Depth alone cannot tell a part of an object from an object: two pieces of a bowl behind a clamp are two regions, and
scissors that lie on a banana are in its region. A model that is registered with a part of its object shows where all of
it is. Models are registered with the regions that were found, and then located in the pixels that no model explains so
far. Those that agree with the image wherever they are visible are chosen, the ones that explain most pixels first, and
each pixel belongs to the chosen model whose surface is there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from simfoundry.capture.cad.library import CadLibrary
from simfoundry.capture.cad.locate import LocatedModel, located_models, pose_worth, turned_by_color
from simfoundry.capture.cad.match import ModelMatch, best_match
from simfoundry.capture.cad.placed_model import ObservedScene, PlacedModel, Source
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.segment.decompose import EDGE_ZONE, MIN_PIXELS, is_within
from simfoundry.capture.segment.masks import Labels, Mask, components, disk, grown, opened
from simfoundry.capture.segment.merge_regions import compact
from simfoundry.capture.segment.regions import pixel_area
from simfoundry.capture.segment.support_graph import carriers, parts_of
from simfoundry.capture.shapes.evidence import Evidence, gather
from simfoundry.capture.shapes.register_mesh import refine_registration

# Number of rounds in which models are located in the pixels that no model explains, and of models refined in each.
ROUNDS, REFINED = 4, 8

# Least share of the visible part of a model that must be where a surface was measured, least share of the pixels of its
# region that it must explain, and largest cost of its registration beyond the share that it leaves. On six piles, right
# models have at least 0.89, 0.55 and at most 0.15, wrong ones at most 0.87, or a cost of at least 0.3.
PRECISE, OWN_SHARE, MAX_COST = 0.85, 0.4, 0.25

# Least share of the visible part of a model that must have its color, if it was registered with a region, or located.
# On twelve piles, right models have at least 0.5, and wrong ones that agree in depth at most 0.35 unless both are gray.
COLORED, LOCATED_COLORED = 0.45, 0.6

# Largest cost of the registration of a model that was located. On the same piles, right models have at most 0.27, and
# wrong ones, if the library lacks every other object, at least 0.31 or nearly the same shape.
LOCATED_COST = 0.3

# The same limits for models that are right beyond doubt. Others compete with models that are located in their pixels.
OBVIOUS_SHARE, OBVIOUSLY_PRECISE, OBVIOUSLY_COLORED = 0.8, 0.93, 0.8

# Least share of the pixels that a model explains that no other chosen model explains.
NEW_SHARE = 0.5

# Fewest pixels that a model must explain to be chosen: with fewer, many models agree, even in color.
FEWEST = 60

# Width [px] of the rim of a model within which pixels belong to it though its surface is not there: flying pixels, and
# the error of its pose.
RIM = 4

# Radius [px] of the narrowest remainder that may be an object, and its least height above the support [m]: what is
# lower is the support beside an object. If more than a share of the region of a model is left, the model is not sure,
# because lookalikes explain three quarters: mixed pixels of a time-of-flight camera behind a mug are 7 % of its region.
NARROW, FLAT, LEFT_SHARE = 2, 0.01, 0.15

# Least area of a remainder that is an object without a model [m²]: behind a mug, mixed pixels cover 11 cm².
LARGE = 2e-3

# A model is a candidate for an object that overlaps the pixels with which it was registered by more than this (IoU).
SAME = 0.7


@dataclass(frozen=True, eq=False)
class CadSegmentation:
    """A segmentation that was corrected by models, and the best model for each object, by number."""

    segmentation: Segmentation
    matches: dict[int, ModelMatch] = field(default_factory=dict)


def explained_segmentation(
    frame: Frame, support: SupportSurface, segmentation: Segmentation, library: CadLibrary
) -> CadSegmentation:
    """Return a segmentation that the models of a library explain better, with the models.

    Regions that no model explains stay as they are, apart from pixels that belong to others.
    """
    scene = ObservedScene.of(frame.cleaned(), support)
    labels = segmentation.labels
    tried = _of_regions(scene, library, labels)
    found = [one for one in tried if _is_sure(one)]
    chosen = [one for one in found if _is_obvious(one)]
    within = (labels > 0) | is_within(support, scene.points_W.reshape(-1, 3)[:, :2], -EDGE_ZONE).reshape(labels.shape)
    for _ in range(ROUNDS):
        asked = scene.standing & within & ~grown(_explained(scene.standing, chosen), disk(1))
        before, new = chosen, _located(scene, library, labels, asked)
        found += new
        chosen = _chosen(found)
        if not new and chosen == before:
            break
    chosen = _of_explained_regions(scene, chosen)
    return _corrected(scene, segmentation, chosen, tried)


def _of_regions(scene: ObservedScene, library: CadLibrary, labels: Labels) -> list[PlacedModel]:
    """Return the best model for each region that has one."""
    out = []
    for k in range(1, int(labels.max()) + 1):
        seed = labels == k
        evidence = _evidence(scene, labels, seed)
        match = best_match(evidence, library) if evidence is not None else None
        if evidence is not None and match is not None:
            out.append(_placed(scene, library, match, evidence, seed, "region"))
    return out


def _located(scene: ObservedScene, library: CadLibrary, labels: Labels, asked: Mask) -> list[PlacedModel]:
    """Return models that explain pixels which no model explains so far."""
    out: list[PlacedModel] = []
    left, tries = asked.copy(), 0
    for one in located_models(scene, library, asked):
        if one.worth < FEWEST or tries == REFINED:
            break
        rough = scene.placed(ModelMatch(one.model.name, one.X_WO, 0.0), one.template, asked, "located")
        own = rough.agree & left
        if int(own.sum()) < max(FEWEST, NEW_SHARE * int((rough.agree & asked).sum())) or rough.color < COLORED:
            continue
        tries += 1
        seed = grown(own, disk(1)) & left
        evidence = _evidence(scene, labels, seed)
        if evidence is None:
            continue
        match = _refined_match(scene, one, evidence, asked)
        found = _placed(scene, library, match, evidence, seed, "located")
        if _is_sure(found):
            out.append(found)
            left &= ~grown(found.agree, disk(1))
    return out


def _refined_match(scene: ObservedScene, one: LocatedModel, evidence: Evidence, asked: Mask) -> ModelMatch:
    """Refine a located model by depth, unless it explains fewer pixels then: depth alone lets a pen slide along."""
    better = refine_registration(evidence, one.template, one.X_WO)
    before, after = (pose_worth(scene, one.template, X_WO, asked) for X_WO in (one.X_WO, better.X_WO))
    return ModelMatch(one.model.name, better.X_WO if after >= before else one.X_WO, better.cost)


def _evidence(scene: ObservedScene, labels: Labels, seed: Mask) -> Evidence | None:
    """Return what the camera sees of an object at some pixels, or None if that is too little."""
    if int((seed & np.isfinite(scene.frame.depth)).sum()) < MIN_PIXELS:
        return None
    around = np.where(seed, 1, np.where((labels > 0) | scene.standing, 2, 0)).astype(np.int32)
    evidence = gather(scene.frame, scene.support, seed, 0.0, around)
    return evidence if len(evidence.points) >= MIN_PIXELS else None


def _placed(
    scene: ObservedScene, library: CadLibrary, match: ModelMatch, evidence: Evidence, seed: Mask, source: Source
) -> PlacedModel:
    """Turn a registered model by its color, and compare it with the image."""
    template = library.template(library.named(match.model))
    assert template is not None  # only models with a template are matched
    X_WO = turned_by_color(scene, template, match.X_WO, seed)
    if X_WO is not match.X_WO:
        better = refine_registration(evidence, template, X_WO)  # the other side of a scan is not quite the same
        match = ModelMatch(match.model, better.X_WO, better.cost)
    return scene.placed(match, template, seed, source)


def _is_sure(one: PlacedModel) -> bool:
    """Return True if a model agrees with the image wherever it is visible, and explains much of its seed."""
    if int(one.agree.sum()) < FEWEST or one.own_share < OWN_SHARE or one.precision < PRECISE:
        return False
    if one.source == "located":
        return one.color >= LOCATED_COLORED and one.match.cost <= LOCATED_COST
    return one.color >= COLORED and one.match.cost - (1 - one.own_share) <= MAX_COST


def _is_obvious(one: PlacedModel) -> bool:
    """Return True if no other model needs to be tried for the pixels that a model explains."""
    return one.own_share >= OBVIOUS_SHARE and one.precision >= OBVIOUSLY_PRECISE and one.color >= OBVIOUSLY_COLORED


def _explained(image: Mask, chosen: list[PlacedModel]) -> Mask:
    """Return a mask of the pixels that chosen models explain."""
    out = np.zeros_like(image)
    for one in chosen:
        out |= one.agree
    return out


def _chosen(sure: list[PlacedModel]) -> list[PlacedModel]:
    """Return the models that explain what no other does, those of most pixels first."""
    out: list[PlacedModel] = []
    for one in sorted(sure, key=lambda one: -one.gain):
        explained = _explained(one.agree, out)
        if int((one.agree & ~explained).sum()) >= max(FEWEST, NEW_SHARE * int(one.agree.sum())):
            out.append(one)
    return out


def _of_explained_regions(scene: ObservedScene, chosen: list[PlacedModel]) -> list[PlacedModel]:
    """Return the models whose regions are explained, together with the other models.

    A model that explains only a part of its region is right if other models explain the rest, and otherwise may be a
    lookalike of the object. Models that were located have no region.
    """
    explained = grown(_explained(scene.standing, chosen), disk(NARROW)) | (scene.points_W[..., 2] < FLAT)
    kept = [
        one for one in chosen if one.source == "located" or (one.seed & ~explained).sum() <= LEFT_SHARE * one.seed.sum()
    ]
    return kept if len(kept) == len(chosen) else _of_explained_regions(scene, kept)


def _corrected(
    scene: ObservedScene, segmentation: Segmentation, chosen: list[PlacedModel], tried: list[PlacedModel]
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


def _owners(old: Labels, chosen: list[PlacedModel]) -> Labels:
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
