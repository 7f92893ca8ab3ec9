"""Repair mass properties by merging massless links into their neighbors and making all masses and inertias valid."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.frontends.draft import BodyDraft, JointDraft, LinkDraft, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.geometry.frames import Array

# Density [kg/m^3] of links without a mass, which is the default in MuJoCo and UsdPhysics.
WATER_DENSITY = 1000.0

# Radius of gyration [m] above which an inertia is treated as a unit error, because tabletop objects are smaller.
#
# MJCF files are exempt: MuJoCo accepts large inertias, and models use them to keep a body from rotating.
WIDEST_GYRATION = 2.0

# Mass of a link that only connects two joints, relative to the mass it supports; below single precision.
FEATHER_SHARE = 1e-7

# Minimum mass [kg] of a link that only connects two joints.
#
# MuJoCo rejects bodies with less than 1e-15 kg or kg m^2, and other simulators divide by the mass.
LIGHTEST_FEATHER = 1e-12

# Minimum moment of inertia [kg m^2] assigned to a link: ten times MuJoCo's minimum.
LEAST_INERTIA = 1e-14

# Relative violation of the triangle inequality that is treated as rounding; some files have only two digits.
ROUNDING = 0.01

# Distance of a clamped joint position from the limit, relative to the range; prevents rounding beyond the limit.
INSIDE_LIMITS = 1e-6

# Names of root links that represent the world.
WORLD_NAMES = ("world", "map", "universe")


def repair_masses(draft: ModelDraft, file: str) -> None:
    """Give every link a mass and an inertia that simulators accept, and record the changes in the draft.

    Joint positions are also clamped to the joint limits.

    Raises:
        ImportRefusedError: If a moving link has no mass, no shape and no child link.
    """
    for body in draft.bodies:
        for joint in body.joints:
            _clamp_position(draft, joint)
        _join_massless_links(draft, body)
        for link in list(body.links.values()):
            if link.mass:
                _repair_inertia(draft, body, link)
            elif link.density is None or not link.colliders:
                _assume_mass(draft, body, link, file)


def _clamp_position(draft: ModelDraft, joint: JointDraft) -> None:
    if joint.limits is None:
        return
    low, high = joint.limits
    target = joint.drive.target if joint.drive is not None else None
    if target is not None and not low <= target <= high:
        why = "the drive target is beyond the joint limits, which cannot be expressed"
        draft.dropped(f"drive of joint `{joint.name}`", why, f"target {target:.4g}")
        joint.drive = None
    if not low <= joint.position <= high:
        margin = INSIDE_LIMITS * (high - low)
        inside = min(max(joint.position, low + margin), high - margin)
        why = "the initial position is beyond the joint limits and was moved to the nearest limit"
        draft.changed(f"position of joint `{joint.name}`", why, f"{joint.position:.4g} to {inside:.4g}")
        joint.position = inside


def _join_massless_links(draft: ModelDraft, body: BodyDraft) -> None:
    """Merge links without a mass into their neighbors at fixed joints."""
    for link in list(body.links.values()):
        if link.mass or link.density is not None:
            continue
        carrier = body.carrier(link.name)
        if carrier is not None and carrier.type == "fixed":
            what = "its shapes were" if link.parts else "the link was"
            _join_to_parent(draft, body, body.links[carrier.parent], link, carrier)
            why = f"the link has no mass and a fixed joint to its parent, so {what} merged into the parent link"
            x, y, z = (f"{v:.4g}" for v in carrier.X_PC.p + 0.0)
            draft.changed(f"link `{link.name}`", why, f"`{carrier.parent}` at ({x}, {y}, {z})")
            continue
        below = [j for j in body.joints if j.parent == link.name and j.type == "fixed" and body.links[j.child].mass]
        if below and not link.parts:
            _absorb_child(draft, body, link, below[0])


def _join_to_parent(draft: ModelDraft, body: BodyDraft, parent: LinkDraft, child: LinkDraft, joint: JointDraft) -> None:
    """Merge a child link without a mass into its parent."""
    _join_exclusions(draft, body, parent, child)
    for part in child.parts:
        part.X_LG = joint.X_PC @ part.X_LG
        part.name = child.name if len(child.parts) == 1 else f"{child.name}_{part.name}"
        part.contact = child.contact | part.contact
    parent.parts += child.parts
    _remove_link(draft, body, child.name, parent.name, joint)


def _join_exclusions(draft: ModelDraft, body: BodyDraft, parent: LinkDraft, child: LinkDraft) -> None:
    """Replace ``child`` with ``parent`` in excluded contact pairs if this does not change their meaning.

    A pair always excludes all shapes of a link. After two links are merged, it can therefore no longer refer to the
    shapes from only one of them.
    """
    old, new = (body.name, child.name), (body.name, parent.name)
    pairs = [((body.name, a), (body.name, b)) for a, b in body.no_contact] + draft.no_contact
    excluded = {name: {b if a == name else a for a, b in pairs if name in (a, b)} for name in (old, new)}
    body.no_contact = [pair for pair in body.no_contact if child.name not in pair]
    draft.no_contact = [pair for pair in draft.no_contact if old not in pair]
    if not child.colliders:
        return
    for other in sorted(excluded[old] ^ excluded[new] if parent.colliders else excluded[old]):
        if other in (old, new):
            continue
        if parent.colliders:
            why = "contact can be excluded only for all shapes of a merged link"
            done = "excluded for all shapes" if other in excluded[new] else "not excluded"
            draft.changed(f"excluded contact of `{child.name}` and `{other[1]}`", why, done)
        elif other[0] == body.name:
            body.no_contact.append((parent.name, other[1]))
        else:
            draft.no_contact.append((new, other))


def _absorb_child(draft: ModelDraft, body: BodyDraft, frame: LinkDraft, joint: JointDraft) -> None:
    """Merge a link into its parent ``frame``.

    The parent has no mass or shape, and keeps its pose.
    """
    child, X_PC = body.links[joint.child], joint.X_PC
    frame.parts, frame.mass, frame.contact = child.parts, child.mass, child.contact
    for part in frame.parts:
        part.X_LG = X_PC @ part.X_LG
    frame.com = None if child.com is None else X_PC.apply(child.com)
    frame.inertia = None if child.inertia is None else X_PC.rotation @ child.inertia @ X_PC.rotation.T
    # The frame itself has no colliders, so its exclusions had no effect.
    old, new = (body.name, child.name), (body.name, frame.name)
    names, paths = {child.name: frame.name}, {old: new}
    body.no_contact = [(names.get(a, a), names.get(b, b)) for a, b in body.no_contact if frame.name not in (a, b)]
    draft.no_contact = [(paths.get(a, a), paths.get(b, b)) for a, b in draft.no_contact if new not in (a, b)]
    _remove_link(draft, body, child.name, frame.name, joint)
    why = "the link was merged into its parent link, which has no mass of its own"
    draft.changed(f"link `{child.name}`", why, f"`{frame.name}`")
    if frame.name.lower() in WORLD_NAMES:
        body.fixed = True


def _remove_link(draft: ModelDraft, body: BodyDraft, old: str, new: str, joint: JointDraft) -> None:
    """Remove the link ``old`` and its parent joint.

    Its child joints and cameras are attached to the link ``new`` instead.
    """
    body.joints.remove(joint)
    del body.links[old]
    for below in body.joints:
        if below.parent == old:
            below.parent, below.X_PC = new, joint.X_PC @ below.X_PC
    for camera in draft.cameras:
        if camera.mount == (body.name, old):
            camera.mount, camera.X_WC = (body.name, new), joint.X_PC @ camera.X_WC


def _assume_mass(draft: ModelDraft, body: BodyDraft, link: LinkDraft, file: str) -> None:
    """Assume a mass for a link that has none."""
    is_root = link.name == body.root
    if is_root and (link.mass == 0 or link.name.lower() in WORLD_NAMES):
        body.fixed = True
    link.mass, link.com, link.inertia = None, None, None
    what = f"mass of `{link.name}`"
    if link.colliders:
        assume_density(draft, link, "MuJoCo", is_root and body.fixed)
    elif is_root:
        link.mass, link.com, link.inertia, link.assumed = 1.0, np.zeros(3), 0.4 * 0.1**2 * np.eye(3), "import"
        if not body.fixed:
            draft.assumed(what, "the file specifies neither a mass nor colliders; 1 kg is assumed, as in PyBullet")
    elif any(joint.parent == link.name for joint in body.joints):
        feather = feather_link(link.name, _mass_below(body, link.name))
        link.mass, link.com, link.inertia, link.assumed = feather.mass, feather.com, feather.inertia, "import"
        why = "the link has no mass and only connects joints; a negligible mass is assumed"
        draft.assumed(what, why, f"{link.mass:.3g} kg")
    else:
        message = f"link `{link.name}` moves but has neither a mass nor a shape from which to compute it"
        raise ImportRefusedError(file, message, hint="add an `inertial` element")


def assume_density(draft: ModelDraft, link: LinkDraft, simulator: str, is_static: bool = False) -> None:
    """Set the density of a link without a mass to the user's density or, by default, to the density of water.

    Args:
        draft: Draft in which the assumption is recorded.
        link: Link without a mass.
        simulator: Simulator that has the same default density and is named in the record.
        is_static: True for links that do not move, for which nothing is recorded.
    """
    link.density, link.assumed = draft.density or WATER_DENSITY, "" if draft.density else "import"
    if not is_static:
        reason = "as set by --density" if draft.density else f"as in {simulator}"
        value = f"computed from its shapes at {link.density:g} kg/m^3, {reason}"
        draft.assumed(f"mass of `{link.name}`", f"the file specifies none; {value}")


def _mass_below(body: BodyDraft, link: str) -> float:
    """Return the total known mass [kg] of all descendants of a link."""
    carried = [joint.child for joint in body.joints if joint.parent == link]
    return sum((body.links[child].mass or 0.0) + _mass_below(body, child) for child in carried)


def feather_link(name: str, carried: float) -> LinkDraft:
    """Return a link to insert between two joints, with a mass that is negligible compared to ``carried`` [kg]."""
    mass = max(LIGHTEST_FEATHER, FEATHER_SHARE * carried)
    return LinkDraft(name, mass=mass, com=np.zeros(3), inertia=ball_inertia(mass), assumed="import")


def _repair_inertia(draft: ModelDraft, body: BodyDraft, link: LinkDraft) -> None:
    """Correct an inertia that is slightly invalid due to rounding, or recompute an impossible inertia from the shapes.

    If the link is connected to its parent by a fixed joint, a zero inertia is replaced with a tiny inertia, as for a
    point mass.
    """
    assert link.mass is not None
    what = f"inertia of `{link.name}`"
    if link.inertia is None:
        if not link.colliders:
            _assume_ball(draft, link, "the file specifies none")
        return
    link.inertia = link.inertia / 2 + link.inertia.T / 2
    is_finite = bool(np.isfinite(link.inertia).all())  # numbers near 1e308 overflow when rotated
    moments = np.linalg.eigvalsh(link.inertia) if is_finite else np.full(3, np.nan)
    excess = float(moments[2] - moments[0] - moments[1])
    detail = f"{', '.join(f'{m:.3g}' for m in moments)} kg m^2"
    reason = "the principal moments are physically impossible"
    if moments[0] > 0 and excess <= moments[2] * 1e-9:  # rounding of double precision
        if math.sqrt(float(moments[2]) / link.mass) <= WIDEST_GYRATION or draft.format == "MJCF":
            return
        reason, detail = "only an object many meters wide could have it", f"{detail} for {link.mass:.3g} kg"
    elif not link.inertia.any() and (carrier := body.carrier(link.name)) is not None and carrier.type == "fixed":
        link.inertia = LEAST_INERTIA * np.eye(3)
        draft.changed(what, "the inertia is zero and the link is fixed, so it is treated as a point mass")
        return
    elif moments[0] > 0 and excess <= moments[2] * ROUNDING:
        link.inertia = link.inertia + excess * (1 + 1e-6) * np.eye(3)
        why = "rounding made the inertia physically impossible; it was corrected to the nearest valid one"
        draft.changed(what, why, f"moments {detail}, by {excess / moments[2]:.1g}")
        return
    if link.colliders:
        link.inertia = None
        draft.changed(what, f"{reason}; recomputed from its shapes", detail)
    else:
        _assume_ball(draft, link, reason, detail)


def inertia_of_moments(moments: Array, axes: Array, noise: float) -> Array:
    """Return the inertia tensor with the given principal moments.

    Args:
        moments: Principal moments, shape (3,).
        axes: Principal axes as columns, shape (3, 3).
        noise: Elements smaller than this fraction of the trace are set to zero, because they are rounding errors that
            come from the axes.

    Returns:
        Inertia tensor, shape (3, 3).
    """
    inertia = axes @ np.diag(moments) @ axes.T
    return np.where(np.abs(inertia) < noise * np.trace(inertia), 0.0, (inertia + inertia.T) / 2)


def _assume_ball(draft: ModelDraft, link: LinkDraft, reason: str, detail: str = "") -> None:
    assert link.mass is not None
    link.com = np.zeros(3) if link.com is None else link.com
    link.inertia = ball_inertia(link.mass)
    draft.assumed(f"inertia of `{link.name}`", f"{reason}; replaced by the inertia of a ball of water", detail)


def ball_inertia(mass: float) -> Array:
    """Return the inertia [kg m^2] of a ball of water with the given mass [kg], or the minimum allowed inertia."""
    radius = (3 * mass / (4 * math.pi * WATER_DENSITY)) ** (1 / 3)
    return np.diag([max(0.4 * mass * radius**2, LEAST_INERTIA)] * 3)
