"""Names of objects: as stated, as in the last run, or after color and shape."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simfoundry.capture.description.describe import LEVEL_NAME, color_word, unique_names
from simfoundry.capture.description.kinds import kind_of
from simfoundry.capture.frame import Frame, Segmentation
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.texture import dominant_color
from simfoundry.capture.statements.overrides import Overrides

# Least ratio of intersection and union at which two masks show the same object; two objects cannot both exceed it.
SAME_MASK = 0.5


def found_names(
    frame: Frame,
    segmentation: Segmentation,
    shapes: Mapping[int, FittedShape],
    given: Mapping[str, int],
    read: Mapping[int, str],
) -> dict[int, str]:
    """Name every object after its name in the capture, else as a model names it, else after its color and shape.

    ``given`` contains the numbers in ``frame.instances`` of the objects that the capture names, and ``read`` the names
    that a model states, by number in the segmentation.
    """
    labels = segmentation.labels
    wanted = {} if frame.instances is None else matched_names(labels, frame.instances, given)
    wanted |= {k: name for name, k in segmentation.pieces.items()}
    wanted = {**read, **wanted}
    for k, shape in shapes.items():
        noun = LEVEL_NAME if k in segmentation.surfaces else kind_of(shape).name
        wanted.setdefault(k, shape.model or f"{color_word(dominant_color(frame, labels == k))}_{noun}")
    return dict(zip(shapes, unique_names(wanted[k] for k in shapes), strict=True))


def matched_names(labels: Labels, other: Labels, names: Mapping[str, int]) -> dict[int, str]:
    """Return the names of objects, by their numbers in ``labels``, given their numbers in ``other``.

    An object gets the name of the number in ``other`` that covers it most.
    """
    out: dict[int, str] = {}
    for name, number in names.items():
        covered = labels[(other == number) & (labels > 0)]
        if len(covered):
            out[int(np.bincount(covered).argmax())] = name
    return out


def kept_names(labels: Labels, last: Labels, last_names: Mapping[str, int], found: Mapping[int, str]) -> dict[int, str]:
    """Return the names of objects that the last run saw at the same place and that look alike.

    Two objects look alike if their names, such as `red_box`, share a word.
    """
    out: dict[int, str] = {}
    if last.shape != labels.shape:
        return out
    for name, number in last_names.items():
        mask = last == number
        covered = labels[mask & (labels > 0)]
        if not len(covered):
            continue
        k = int(np.bincount(covered).argmax())
        shared = int((covered == k).sum())
        union = int(mask.sum()) + int((labels == k).sum()) - shared
        if k in found and shared >= SAME_MASK * union and set(name.split("_")) & set(found[k].split("_")):
            out[k] = name
    return out


def final_names(
    found: Mapping[int, str], stated: Mapping[int, str], kept: Mapping[int, str], overrides: Overrides
) -> dict[int, str]:
    """Return the names of objects in the scene, by number.

    Args:
        found: Names from the capture, or from color and shape.
        stated: Names that a person states by number; they are used before all others.
        kept: Names in the last run, which are used before those that are found.
        overrides: What a person states about objects, by name.
    """
    wanted = {k: kept.get(k, name) for k, name in found.items()}
    exact = dict(stated)
    for k, name in found.items():
        _, override = overrides.of((stated.get(k, name), wanted[k], name))
        if override.name is not None:
            exact[k] = override.name
    order = [k for k in found if k in exact] + [k for k in found if k not in exact]
    names = dict(zip(order, unique_names(exact.get(k, wanted[k]) for k in order), strict=True))
    return {k: names[k] for k in found}
