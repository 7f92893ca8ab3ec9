"""Losses of a compiled scene: typed records, from which ``loss.json`` and all reports are generated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

from simfoundry.backends.features import FEATURES, NO_RANDOM_VALUES, Cells, Fidelity, native_count
from simfoundry.scene.attachments import Options
from simfoundry.scene.model import Scene


class Size(NamedTuple):
    """The size of an approximation error, consisting of a value and its unit (``1`` for ratios and coefficients)."""

    value: float
    unit: str


@dataclass(frozen=True)
class Loss:
    """A scene feature that a target cannot preserve exactly.

    Attributes:
        feature: A key of :data:`FEATURES`.
        element: The scene name of the affected object, joint, collider or light, or an empty string if all elements
            that use the feature are affected.
        fidelity: The way in which the target fails to preserve the feature.
        reason: A sentence that explains the loss.
        size: The approximation error, or None if it is unknown.
    """

    feature: str
    element: str
    fidelity: Fidelity
    reason: str
    size: Size | None = None

    @property
    def path(self) -> str:
        """The affected element and quantity, such as ``cup.friction``, or only the quantity if all are affected."""
        words = dict.fromkeys((self.element, FEATURES[self.feature].quantity))
        return ".".join(filter(None, words)) or self.feature


def approximate(feature: str, element: str, reason: str, value: float | None = None, unit: str = "1") -> Loss:
    """Return the loss for a feature that is approximated.

    The approximation error is ``value``, measured in ``unit``.
    """
    size = None if value is None else Size(float(f"{value:.3g}"), unit)
    return Loss(feature, element, Fidelity.APPROXIMATED, reason, size)


def drop(feature: str, element: str, reason: str) -> Loss:
    """Return the loss for a feature that is omitted."""
    return Loss(feature, element, Fidelity.DROPPED, reason)


def combination_reason(simulator: str, rule: str, a: float, b: float, got: float, wanted: float) -> str:
    """Return the reason for a loss in a simulator that combines two coefficients by a different rule than the scene."""
    return f"{simulator} uses {rule} of a pair: {got:.3g} for {a:.3g} and {b:.3g}; the scene specifies {wanted:.3g}."


def shared_losses(scene: Scene) -> Iterator[Loss]:
    """Yield the losses that lowering causes for every target, such as omitted parts and simplified colliders."""
    for part in scene.left_out:
        yield drop("robots" if part.path.startswith("robots.") else "mounted_cameras", part.path, part.reason)
    for value in scene.random_values:
        yield drop("vary", value.name, NO_RANDOM_VALUES)
    for item in scene.objects:
        error = max((link.collision_error for link in item.links), default=0.0)
        if error:
            count = sum(len(link.colliders) for link in item.links)
            subject = f"The {count} colliders are" if count > 1 else "The collider is"
            reason = f"{subject} up to {1000 * error:.2g} mm away from the visual surface."
            yield approximate("collision_shape", item.name, reason, 1000 * error, "mm")


def variant_losses(scene: Scene, target: str) -> Iterator[Loss]:
    """Yield one loss per object with variants, for targets whose files can contain only one variant."""
    for item in scene.objects:
        if item.variants:
            others = ", ".join(f"`{v.variant}`" for v in item.variants)
            reason = f"{target} supports only one variant: `{item.variant}` is written; {others} are omitted."
            yield drop("variants", item.name, reason)


def splat_losses(scene: Scene, target: str) -> Iterator[Loss]:
    """Yield the loss of a Gaussian splat in a target that renders only surfaces."""
    if scene.background is not None and scene.background.splat is not None:
        yield drop("background_splat", "background", f"{target} renders only surfaces, not Gaussian splats.")


def unused_native_losses(scene: Scene) -> Iterator[Loss]:
    """Yield a loss for native data of links, joints and parts that has no effect, because the scene has none itself."""
    if scene.native is None and (found := native_count(scene)):
        known = ", ".join(f"{count} {word}" for word, count in found.items())
        reason = f"The native attributes of {known} take effect only in a scene with `native: {{mjcf: …}}` of its own."
        yield drop("native", "native.mjcf", reason)


def attachment_losses(scene: Scene, cells: Cells, drives: bool) -> Iterator[Loss]:
    """Yield the losses of sites, sensors, actuators, options and native data in a format that does not hold them.

    With ``drives``, the format has joint drives, and those actuators that became drives are not lost.
    """
    for item in scene.objects:
        driven = {joint.drive.actuator for joint in item.joints if joint.drive is not None} if drives else set()
        for feature in ("sites", "sensors", "actuators"):
            if cells[feature].fidelity is not None:
                for each in getattr(item, feature):
                    if feature != "actuators" or each.name not in driven:
                        yield drop(feature, f"{item.name}.{each.name}", cells[feature].reason)
    if cells["options"].fidelity is not None and scene.options != Options():
        yield Loss("options", "options", cells["options"].fidelity, cells["options"].reason)
    if found := native_count(scene):
        known = ", ".join(f"{count} {word}" for word, count in found.items())
        yield drop("native", "native.mjcf", f"{known} {'are' if sum(found.values()) > 1 else 'is'} known to MJCF only.")


def count_fates(scene: Scene, losses: Iterable[Loss]) -> dict[str, dict[str, int]]:
    """Count the elements for which each used feature is preserved, approximated or lost, omitting counts of zero.

    An element with several losses is counted under the most severe of them.
    """
    users = _users(scene)
    worst: dict[str, dict[str, Fidelity]] = {name: {} for name in users}
    for loss in losses:
        whole_robot = loss.feature == "robots" and loss.fidelity is Fidelity.DROPPED
        for name in ("robots", "robot_motors", "robot_contacts") if whole_robot else (loss.feature,):
            for user in _elements(users[name], loss.element):
                if worst[name].get(user, Fidelity.APPROXIMATED) is Fidelity.APPROXIMATED:
                    worst[name][user] = loss.fidelity
    counts = {name: Counter(worst[name].get(each, "kept") for each in elements) for name, elements in users.items()}
    return {name: {f: found[f] for f in ("kept", *Fidelity) if f in found} for name, found in counts.items() if found}


def _users(scene: Scene) -> Mapping[str, list[str]]:
    """Return the elements that use each feature in a scene. The result is cached because every target needs it."""
    if scene not in _USERS:
        _USERS[scene] = {name: list(feature.users(scene)) for name, feature in FEATURES.items()}
    return _USERS[scene]


_USERS: WeakKeyDictionary[Scene, Mapping[str, list[str]]] = WeakKeyDictionary()


def _elements(users: list[str], element: str) -> list[str]:
    """Return the elements affected by a loss.

    These are ``element`` itself, its parts, or, if ``element`` is empty, all elements that use the feature.
    """
    if not element or element in users:
        return [element] if element else users
    return [user for user in users if element.startswith(f"{user}.")]
