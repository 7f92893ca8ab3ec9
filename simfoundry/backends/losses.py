"""Losses of a compile: typed records from which ``loss.json`` and every report are generated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

from simfoundry.backends.features import FEATURES, Fidelity
from simfoundry.scene.model import Scene

_KEPT = "kept"
"""The entry for a feature that a target preserves exactly."""

_OF_ROBOTS = ("robots", "robot_motors", "robot_contacts")
"""The features that are lost together with a robot if the robot is dropped."""


class Size(NamedTuple):
    """The size of an approximation: a value and its unit, where ``1`` means a ratio or a coefficient."""

    value: float
    unit: str


@dataclass(frozen=True)
class Loss:
    """A feature of the scene that a target cannot keep exactly.

    ``feature`` is a key of :data:`FEATURES`. ``element`` is the name in the scene of the object, joint, collider or
    light that is affected, or empty if all users of the feature are. ``size`` is the error of an approximation, None if
    it is unknown.
    """

    feature: str
    element: str
    fidelity: Fidelity
    reason: str
    size: Size | None = None

    @property
    def path(self) -> str:
        """The element and its quantity, such as ``cup.friction``, or only the quantity if all elements are affected."""
        words = dict.fromkeys((self.element, FEATURES[self.feature].quantity))
        return ".".join(filter(None, words)) or self.feature


def approximate(feature: str, element: str, reason: str, value: float | None = None, unit: str = "1") -> Loss:
    """Return the loss of a feature that is approximated with an error of ``value`` in ``unit``."""
    size = None if value is None else Size(float(f"{value:.3g}"), unit)
    return Loss(feature, element, Fidelity.APPROXIMATED, reason, size)


def drop(feature: str, element: str, reason: str) -> Loss:
    """Return the loss of a feature that is left out."""
    return Loss(feature, element, Fidelity.DROPPED, reason)


def shared_losses(scene: Scene) -> Iterator[Loss]:
    """Yield the losses that lowering causes in every target, such as omitted parts and simplified colliders."""
    for part in scene.left_out:
        yield drop("robots" if part.path.startswith("robots.") else "mounted_cameras", part.path, part.reason)
    for item in scene.objects:
        error = max((link.collision_error for link in item.links), default=0.0)
        if error:
            count = sum(len(link.colliders) for link in item.links)
            subject = f"Its {count} colliders are" if count > 1 else "Its collider is"
            reason = f"{subject} up to {1000 * error:.2g} mm away from the visual surface."
            yield approximate("collision_shape", item.name, reason, 1000 * error, "mm")


def variant_losses(scene: Scene, target: str) -> Iterator[Loss]:
    """Yield one loss per object with variants, for a target whose files hold only one variant."""
    for item in scene.objects:
        if item.variants:
            others = ", ".join(f"`{v.variant}`" for v in item.variants)
            reason = f"{target} holds one variant: `{item.variant}` is written; {others} are left out."
            yield drop("variants", item.name, reason)


def splat_losses(scene: Scene, target: str) -> Iterator[Loss]:
    """Yield the loss of a Gaussian splat in a target that draws only surfaces."""
    if scene.background is not None and scene.background.splat is not None:
        yield drop("background_splat", "background", f"{target} renders surfaces, and a Gaussian splat has none.")


def count_fates(scene: Scene, losses: Iterable[Loss]) -> dict[str, dict[str, int]]:
    """Count the elements that keep each used feature, have it approximated, or lose it; zeros are omitted.

    If an element has several losses, the worst one counts.
    """
    users = _users(scene)
    worst: dict[str, dict[str, Fidelity]] = {name: {} for name in users}
    for loss in losses:
        for name in _features_lost(loss):
            for user in _elements(users[name], loss.element):
                if worst[name].get(user, Fidelity.APPROXIMATED) is Fidelity.APPROXIMATED:
                    worst[name][user] = loss.fidelity
    return {name: _count(elements, worst[name]) for name, elements in users.items() if elements}


def _features_lost(loss: Loss) -> tuple[str, ...]:
    whole_robot = loss.feature == "robots" and loss.fidelity is Fidelity.DROPPED
    return _OF_ROBOTS if whole_robot else (loss.feature,)


def _users(scene: Scene) -> Mapping[str, list[str]]:
    """Return the elements that use each feature of a scene; cached because every target needs them."""
    if scene not in _USERS:
        _USERS[scene] = {name: list(feature.users(scene)) for name, feature in FEATURES.items()}
    return _USERS[scene]


_USERS: WeakKeyDictionary[Scene, Mapping[str, list[str]]] = WeakKeyDictionary()


def _elements(users: list[str], element: str) -> list[str]:
    """Return the elements that a loss affects: the element or its owner if one is named, otherwise all users."""
    if not element or element in users:
        return [element] if element else users
    return [user for user in users if element.startswith(f"{user}.")]


def _count(elements: list[str], worst: Mapping[str, Fidelity]) -> dict[str, int]:
    fates = [worst[element].value if element in worst else _KEPT for element in elements]
    return {fate: fates.count(fate) for fate in (_KEPT, *Fidelity) if fate in fates}
