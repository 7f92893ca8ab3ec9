"""Rotor inertia for engines whose joints have none: added to the links that the joints turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simfoundry.geometry.frames import frozen_array
from simfoundry.scene.model import JointType, SceneObject


def with_rotors(item: SceneObject) -> SceneObject:
    """Return the object with the armature of each turning joint in the inertia of the link below it.

    Geared motors make most of the inertia of a finger, up to a thousand times that of its links. Bullet solves contacts
    by impulses, a few dozen a step, each as large as the inertia of what it pushes: bare fingers, 1e-5 kg m^2, press
    with a hundredth of their motor's force. A rotor is added as a thin disc, half its inertia across its axis, because
    Bullet takes an inertia that no body has for none at all.
    """
    rotors = {
        joint.child: joint.armature / 2 * (np.eye(3) + np.outer(joint.axis, joint.axis))
        for joint in item.joints
        if joint.armature > 0 and joint.type in (JointType.REVOLUTE, JointType.CONTINUOUS)
    }
    links = (
        replace(link, inertia=frozen_array(link.inertia + rotors[link.name])) if link.name in rotors else link
        for link in item.links
    )
    return replace(item, links=tuple(links))
