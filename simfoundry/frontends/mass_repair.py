"""Bodies made sound: frames that weigh nothing melt into what carries them, and every link gets a mass it can have."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.frontends.draft import BodyDraft, Draft, JointDraft, LinkDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.geometry.frames import Array, Pose

USUAL_DENSITY = 1000.0
"""Density [kg/m^3] of what states no mass, as MuJoCo and UsdPhysics take it: that of water."""

WIDEST_GYRATION = 2.0
"""Radius of gyration [m] above which an inertia was never meant: nothing on or around a table is so large. In MJCF it
is: MuJoCo takes such inertias, and models use them to keep a thing from turning."""

FEATHER_SHARE = 1e-7
"""Mass of a link that only joins two joints, as a share of what it carries: less than single precision sees."""

LIGHTEST_FEATHER = 1e-12
"""The least mass [kg] of such a link: MuJoCo refuses bodies below 1e-15 kg or kg m^2, others divide by it."""

LEAST_INERTIA = 1e-14
"""The least moment of inertia [kg m^2] that is given to anything, ten times what MuJoCo needs."""

ROUNDING = 0.01
"""Share by which moments may miss the triangle inequality through rounding."""

SURFACE = ("friction", "restitution", "torsional", "rolling")
"""What a link says about the surfaces of its parts."""

WORLD = ("world", "map", "universe")
"""Names of a root link that stand for the world."""


def make_sound(draft: Draft, file: str) -> None:
    """Give every link of every body a mass and an inertia that simulators accept; what is changed is noted.

    Joints that start beyond a limit start at it.
    """
    for body in draft.bodies:
        for joint in body.joints:
            _start_inside(draft, joint)
        _melt(draft, body)
        for link in list(body.links.values()):
            if not link.mass and (link.density is None or not any(part.use != "visual" for part in link.parts)):
                _weigh(draft, body, link, file)
            elif link.mass:
                _mend_inertia(draft, body, link)


def _start_inside(draft: Draft, joint: JointDraft) -> None:
    target = joint.drive.target if joint.drive is not None else None
    if joint.limits is not None and target is not None and not joint.limits[0] <= target <= joint.limits[1]:
        why = "it pulls to a place beyond the limits of its joint, which cannot be said"
        draft.dropped(f"drive of joint `{joint.name}`", why, f"to {target:.4g}")
        joint.drive = None
    if joint.limits is None or joint.limits[0] <= joint.position <= joint.limits[1]:
        return
    margin = 1e-6 * (joint.limits[1] - joint.limits[0])  # a number on the limit may be rounded past it
    inside = min(max(joint.position, joint.limits[0] + margin), joint.limits[1] - margin)
    why = "it starts beyond its limits; here it starts at the nearer one"
    draft.changed(f"position of joint `{joint.name}`", why, f"{joint.position:.4g} to {inside:.4g}")
    joint.position = inside


def _melt(draft: Draft, body: BodyDraft) -> None:
    """Join links without a mass to their neighbours at fixed joints."""
    for link in list(body.links.values()):
        if link.mass or link.density is not None:
            continue
        carrier = body.carrier(link.name)
        if carrier is not None and carrier.type == "fixed":
            _join(draft, body, body.links[carrier.parent], link, carrier)
            what = "its shapes are" if link.parts else "its frame is"
            why = f"it weighs nothing and is fixed: {what} part of the link that carries it"
            draft.changed(f"link `{link.name}`", why, f"`{carrier.parent}` {_at(carrier.X_PC)}")
            continue
        below = [j for j in body.joints if j.parent == link.name and j.type == "fixed" and body.links[j.child].mass]
        if below and not link.parts:
            _absorb(draft, body, link, below[0])


def _join(draft: Draft, body: BodyDraft, parent: LinkDraft, child: LinkDraft, joint: JointDraft) -> None:
    """Make a child without a mass a part of its parent."""
    _join_contacts(draft, body, parent, child)
    for part in child.parts:
        part.X_LG = joint.X_PC @ part.X_LG
        part.name = child.name if len(child.parts) == 1 else f"{child.name}_{part.name}"
        for word in SURFACE:
            if getattr(part, word) is None:
                setattr(part, word, getattr(child, word))
    parent.parts += child.parts
    body.joints.remove(joint)
    del body.links[child.name]
    _reparent(draft, body, child.name, parent.name, joint.X_PC)


def _join_contacts(draft: Draft, body: BodyDraft, parent: LinkDraft, child: LinkDraft) -> None:
    """Let the pairs that never touch speak of ``parent`` in place of ``child``, as far as they mean the same.

    A pair leaves out all contact of a link, so it cannot speak of the shapes of one of two that are joined.
    """
    old, new = (body.name, child.name), (body.name, parent.name)
    touches, carrier_touches = _touches(child), _touches(parent)
    pairs = [((body.name, a), (body.name, b)) for a, b in body.no_contact] + draft.no_contact
    excluded = {name: {b if a == name else a for a, b in pairs if name in (a, b)} for name in (old, new)}
    body.no_contact = [pair for pair in body.no_contact if child.name not in pair]
    draft.no_contact = [pair for pair in draft.no_contact if old not in pair]
    if not touches:
        return
    for other in sorted(excluded[old] ^ excluded[new] if carrier_touches else excluded[old]):
        if other in (old, new):
            continue
        if carrier_touches:
            why = "links that are joined pass through another one whole or not at all"
            done = "all of it passes" if other in excluded[new] else "nothing of it passes"
            draft.changed(f"excluded contact of `{child.name}` and `{other[1]}`", why, f"{done} through")
        elif other[0] == body.name:
            body.no_contact.append((parent.name, other[1]))
        else:
            draft.no_contact.append((new, other))


def _touches(link: LinkDraft) -> bool:
    return any(part.use != "visual" for part in link.parts)


def _absorb(draft: Draft, body: BodyDraft, frame: LinkDraft, joint: JointDraft) -> None:
    """Give a frame without a mass or shape what is fixed to it, so that the frame stays where it is."""
    child, X_PC = body.links[joint.child], joint.X_PC
    frame.parts = child.parts
    for part in frame.parts:
        part.X_LG = X_PC @ part.X_LG
    frame.mass = child.mass
    for word in SURFACE:
        setattr(frame, word, getattr(child, word))
    frame.com = None if child.com is None else X_PC.apply(child.com)
    frame.inertia = None if child.inertia is None else X_PC.rotation @ child.inertia @ X_PC.rotation.T
    body.joints.remove(joint)
    # The frame itself touches nothing, so what is said of it is said in vain.
    of_frame, of_child = (body.name, frame.name), (body.name, child.name)
    rename = {child.name: frame.name}
    kept = [pair for pair in body.no_contact if frame.name not in pair]
    body.no_contact = [(rename.get(a, a), rename.get(b, b)) for a, b in kept]
    draft.no_contact = [
        tuple(of_frame if end == of_child else end for end in pair)  # type: ignore[misc]
        for pair in draft.no_contact
        if of_frame not in pair
    ]
    del body.links[child.name]
    _reparent(draft, body, child.name, frame.name, X_PC)
    why = "it is one with the link that carries it, which weighs nothing by itself"
    draft.changed(f"link `{child.name}`", why, f"`{frame.name}`")
    if frame.name.lower() in WORLD:
        body.fixed = True


def _reparent(draft: Draft, body: BodyDraft, old: str, new: str, X_NO: Pose) -> None:
    """Hang what a link carries, joints and cameras, on another link, in which its frame has the pose ``X_NO``."""
    for joint in body.joints:
        if joint.parent == old:
            joint.parent, joint.X_PC = new, X_NO @ joint.X_PC
    for camera in draft.cameras:
        if camera.mount == (body.name, old):
            camera.mount, camera.X_WC = (body.name, new), X_NO @ camera.X_WC


def _at(X_PC: Pose) -> str:
    x, y, z = (f"{v:.4g}" for v in X_PC.p + 0.0)
    return f"at ({x}, {y}, {z})"


def _weigh(draft: Draft, body: BodyDraft, link: LinkDraft, file: str) -> None:
    """A mass for a link that states none."""
    root = link.name == body.root
    if root and (link.mass == 0 or link.name.lower() in WORLD):
        body.fixed = True
    link.mass, link.com, link.inertia = None, None, None
    if any(part.use != "visual" for part in link.parts):
        take_density(draft, link, f"{USUAL_DENSITY:g} kg/m^3 over its shapes, as MuJoCo takes it", root and body.fixed)
    elif root:
        link.mass, link.com, link.inertia, link.assumed = 1.0, np.zeros(3), 0.4 * 0.1**2 * np.eye(3), "import"
        if not body.fixed:
            draft.assumed(
                f"mass of `{link.name}`", "none is given and nothing of it touches; 1 kg, as PyBullet takes it"
            )
    elif any(joint.parent == link.name for joint in body.joints):
        feather = feather_link(link.name, _mass_below(body, link.name))
        link.mass, link.com, link.inertia, link.assumed = feather.mass, feather.com, feather.inertia, "import"
        why = "none is given and it only joins two joints; almost none, so that nobody notices"
        draft.assumed(f"mass of `{link.name}`", why, f"{link.mass:.3g} kg")
    else:
        message = f"link `{link.name}` moves and has neither a mass nor a shape to weigh"
        raise ImportRefusedError(file, message, hint="give it an inertial")


def take_density(draft: Draft, link: LinkDraft, usual: str, is_still: bool = False) -> None:
    """Weigh a link without a mass by the user's density, or else by the usual one; of what stands still say nothing.

    Of these only the latter is an assumption of the importer, which is warned about.
    """
    link.density, link.assumed = draft.density or USUAL_DENSITY, "" if draft.density else "import"
    if not is_still:
        said = f"{draft.density:g} kg/m^3 over its shapes, as you said" if draft.density else usual
        draft.assumed(f"mass of `{link.name}`", f"none is given; {said}")


def _mass_below(body: BodyDraft, link: str) -> float:
    """The mass [kg] of all that a link carries, as far as it is known."""
    carried = [joint.child for joint in body.joints if joint.parent == link]
    return sum((body.links[child].mass or 0.0) + _mass_below(body, child) for child in carried)


def feather_link(name: str, carried: float) -> LinkDraft:
    """A link between two joints that is too light to be noticed by what it carries [kg]."""
    mass = max(LIGHTEST_FEATHER, FEATHER_SHARE * carried)
    return LinkDraft(name, mass=mass, com=np.zeros(3), inertia=ball(mass), assumed="import")


def _mend_inertia(draft: Draft, body: BodyDraft, link: LinkDraft) -> None:
    """An inertia that no body has is replaced by that of the shapes; one that misses by rounding is rounded up.

    None at all is that of a point, where a fixed joint makes the link one with another.
    """
    if link.inertia is None or link.mass is None:
        if not any(part.use != "visual" for part in link.parts):
            _as_ball(draft, link, "none is given")
        return
    link.inertia = link.inertia / 2 + link.inertia.T / 2
    is_finite = bool(np.isfinite(link.inertia).all())  # numbers of 1e308 overflow where they are turned
    moments = np.linalg.eigvalsh(link.inertia) if is_finite else np.full(3, np.nan)
    missing = float(moments[2] - moments[0] - moments[1])
    shown = ", ".join(f"{m:.3g}" for m in moments)
    if moments[0] > 0 and missing <= moments[2] * 1e-9:
        gyration = math.sqrt(float(moments[2]) / link.mass)
        if gyration <= WIDEST_GYRATION or draft.format == "MJCF":
            return
        reason, detail = "only something many metres wide has it", f"{shown} kg m^2 for {link.mass:.3g} kg"
    elif not link.inertia.any() and (carrier := body.carrier(link.name)) is not None and carrier.type == "fixed":
        link.inertia = LEAST_INERTIA * np.eye(3)
        draft.changed(f"inertia of `{link.name}`", "it has a mass and no inertia; it is fixed, so it stays a point")
        return
    elif moments[0] > 0 and missing <= moments[2] * ROUNDING:
        link.inertia = link.inertia + missing * (1 + 1e-6) * np.eye(3)
        why = "rounding took it out of what a body can have; rounded back"
        draft.changed(f"inertia of `{link.name}`", why, f"moments {shown} kg m^2, by {missing / moments[2]:.1g}")
        return
    else:
        reason, detail = "no body has such moments", f"{shown} kg m^2"
    if any(part.use != "visual" for part in link.parts):
        link.inertia = None
        draft.changed(f"inertia of `{link.name}`", f"{reason}; computed from its shapes", detail)
    else:
        _as_ball(draft, link, reason, detail)


def _as_ball(draft: Draft, link: LinkDraft, reason: str, detail: str = "") -> None:
    assert link.mass is not None
    link.com = np.zeros(3) if link.com is None else link.com
    link.inertia = ball(link.mass)
    draft.assumed(f"inertia of `{link.name}`", f"{reason}; that of a ball of water stands for it", detail)


def ball(mass: float) -> Array:
    """Inertia [kg m^2] of a ball of water of a mass [kg], or the least that there may be."""
    radius = (3 * mass / (4 * math.pi * 1000.0)) ** (1 / 3)
    return np.diag([max(0.4 * mass * radius**2, LEAST_INERTIA)] * 3)
