"""The mass properties of objects, and where each mass comes from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from simfoundry.assets import mass
from simfoundry.geometry.frames import Array, Pose, principal_inertia
from simfoundry.scene.bodies import USUAL_DENSITY
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Link, SceneObject
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.models.asset import AssetSpec, LinkSpec
from simfoundry.spec.models.base import BodySpec, Estimate, Material, quantity_value
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec, variant_of
from simfoundry.spec.models.shapes import CompoundShape


@dataclass(frozen=True, eq=False)
class MassFacts:
    """The mass properties of an object in its frame, or of a link in its own frame.

    Attributes:
        mass: The mass [kg].
        com: The center of mass [m], shape (3,).
        moments: The principal moments of inertia about the center of mass [kg m^2], shape (3,).
    """

    mass: float
    com: Array
    moments: Array


def link_mass(link: Link) -> MassFacts:
    """Return the mass properties of a link."""
    return MassFacts(link.mass, link.com, link.principal[0])


def object_mass(item: SceneObject) -> MassFacts:
    """Return the mass properties of an object in its initial state."""
    if len(item.links) == 1:
        return link_mass(item.root)
    poses = link_poses(item)
    total, com, inertia = mass.combine([(link.mass, _moments(link, poses[link.name])) for link in item.links])
    return MassFacts(total, com, principal_inertia(inertia)[0])


def _moments(link: Link, X_OL: Pose) -> mass.SolidMoments:
    """Return the moments of a link as those of a solid of volume 1, whose density is the mass of the link."""
    return mass.SolidMoments(1.0, link.com, link.inertia / link.mass).moved(X_OL.rotation, X_OL.p)


def mass_source(loaded: Loaded, item: SceneObject, link: str = "") -> str:
    """Explain where the mass of an object comes from, as in ``700 kg/m^3 (wood) x 571 cm^3``.

    Args:
        loaded: The scene document, or the asset document that defines the object.
        item: The object.
        link: The link to explain, or empty for the whole object.
    """
    if isinstance(loaded.spec, AssetSpec):
        return _asset_source(loaded.spec, item, link)
    assert isinstance(loaded.spec, SceneSpec)
    written = loaded.spec.objects[item.name]
    if item.variant:
        written = variant_of(written, item.variant)
    if written.asset is not None and is_document(written.asset):
        asset = loaded.used(written.asset)
        return _asset_source(asset.spec, item, link) if asset and isinstance(asset.spec, AssetSpec) else ""
    return _body_source(written, loaded.spec.materials, item.root.mass, _part_materials(written), item.fixed)


def _asset_source(spec: AssetSpec, item: SceneObject, link: str) -> str:
    if not link and len(item.links) > 1:
        return f"sum of {len(item.links)} links"
    name = link or item.root.name
    body = spec.links[name]
    kg = next(each.mass for each in item.links if each.name == name)
    return _body_source(body, spec.materials, kg, (part.material for part in body.parts.values()), False)


def _part_materials(written: ObjectSpec) -> Iterable[str | None]:
    if isinstance(written.shape, CompoundShape):
        return [part.material for part in written.shape.compound.values()]
    return [None]


def _body_source(
    body: BodySpec, materials: dict[str, Material], kg: float, parts: Iterable[str | None], fixed: bool
) -> str:
    """Explain the mass of a body [kg], whose parts have the given materials, or None for that of the body."""
    if isinstance(body.mass, Estimate):
        return _estimate(body.mass, "kg")
    if body.mass is not None:
        return "given, including the inertia" if isinstance(body, LinkSpec) and body.weighed else "given"
    density, origin = quantity_value(body.density), ""
    if isinstance(body.density, Estimate):
        origin = f" ({_estimate(body.density, 'kg/m³')})"
    if density is None:
        names = {body.material if name is None else name for name in parts}
        if len(names) > 1:
            return f"from the densities of {', '.join(sorted(f'`{name}`' for name in names if name is not None))}"
        name = names.pop() if names else body.material
        density = materials[name].density if name is not None else None
        origin = f" (`{name}`)"
    if density is None:
        density, origin = USUAL_DENSITY, " (assumed, because the object is fixed)" if fixed else " (assumed)"
    return f"{density:.4g} kg/m³{origin} × {volume_text(kg / density)}"


def _estimate(given: Estimate, unit: str) -> str:
    limits = f", {given.range[0]:.4g} to {given.range[1]:.4g} {unit}" if given.range is not None else ""
    return f"estimated by {given.source}{limits}"


def volume_text(volume: float) -> str:
    """Format a volume [m^3] with a suitable unit."""
    if volume >= 0.1:
        return f"{volume:.4g} m³"
    return f"{volume * 1e3:.4g} l" if volume >= 1e-3 else f"{volume * 1e6:.4g} cm³"
