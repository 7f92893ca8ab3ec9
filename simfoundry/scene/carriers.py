"""Objects, links and parts that carry other objects or frames."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.hulls import Hulls
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import hulls


class PlaceError(Exception):
    """Raised if a placement is infeasible. The message contains the relevant sizes, and the hint suggests a fix."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message, self.hint = message, hint


# Caches of the parts of placed objects and of their mirror images; many objects may be placed on the same surface.
standing = lru_cache(maxsize=16)(hulls)
flipped = lru_cache(maxsize=16)(Hulls.flipped)


@dataclass(frozen=True, eq=False)
class Carrier:
    """The support for a placement.

    It consists of the ``whole`` object, the named ``part``, and the frame of this part. ``pieces`` are the indices of
    the convex parts that the named part consists of, or None if the whole object is named.
    """

    name: str
    whole: Hulls
    part: Hulls
    pieces: frozenset[int] | None
    X_WC: Pose

    @classmethod
    def of(cls, name: str, placed: Mapping[str, SceneObject]) -> Carrier:
        """Return the carrier with a name such as `shelf` or `shelf.board`, which is a link or a part of a link.

        Raises:
            PlaceError: If the object is not placed yet, or there is no such link or part.
        """
        owner, _, part = name.partition(".")
        if owner not in placed:
            raise PlaceError(f"`{owner}` is not placed itself", f"place `{owner}` without depending on this object")
        item = placed[owner]
        whole = standing(item)
        if not part:
            found, pieces, X_WC = whole, None, item.X_WO
        else:
            link, chosen = _pieces(item, part)
            pieces = frozenset(chosen)
            found, X_WC = whole.of_parts(chosen), item.X_WO @ link_poses(item)[link]
        if not len(found.corners):
            raise PlaceError(f"`{name}` has no colliders, so it cannot support objects", "add a `collision` to it")
        return cls(name, whole, found, pieces, X_WC)

    def top(self) -> Pose:
        """Return the frame at the center of the top side, with the orientation of the carrier."""
        axes = self.X_WC.rotation
        (x0, x1), (y0, y1), (_, z1) = (self.part.extent(axes[:, k]) for k in range(3))
        return Pose.of(axes @ np.array([(x0 + x1) / 2, (y0 + y1) / 2, z1]), self.X_WC.q)


def _pieces(item: SceneObject, part: str) -> tuple[str, list[int]]:
    """Return the link that a part belongs to, and the indices of its convex parts in :func:`hulls`.

    Raises:
        PlaceError: If there is no such link or part, or if several links have a part with this name.
    """
    named = [(link.name, piece.name) for link in item.links for piece in (link.colliders or link.visuals)]
    if part in {link.name for link in item.links}:
        return part, [k for k, (link, _) in enumerate(named) if link == part]
    # A part that consists of several convex pieces numbers them.
    numbered = re.compile(rf"{re.escape(part)}_[0-9]+\Z")
    found = [k for k, (_, name) in enumerate(named) if name == part]
    found = found or [k for k, (_, name) in enumerate(named) if numbered.match(name)]
    links = list(dict.fromkeys(named[k][0] for k in found))
    if len(links) == 1:
        return links[0], found
    if links:
        shown = ", ".join(f"`{link}`" for link in links)
        raise PlaceError(f"the links {shown} of `{item.name}` both have a part `{part}`", "rename one of the parts")
    known = dict.fromkeys([*(link.name for link in item.links), *(name for _, name in named)])
    raise PlaceError(f"`{item.name}` has no link or part `{part}`", f"available: {', '.join(known)}")
