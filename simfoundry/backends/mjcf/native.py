"""Writing of scenes with native MJCF data, for which MuJoCo's own rules and defaults apply.

Bodies, joints and geoms are written one for one, as in the file that was imported: a link that is merged is not a body,
several joints may belong to one body, and a part is one geom. All values that the language has come from the scene;
native attributes add to them. There are no default classes, and numbers are exact.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from simfoundry.backends.artifact import exact, exacts
from simfoundry.backends.mjcf import contact_rules as rules
from simfoundry.backends.mjcf.attachments import add_actuators, add_sensors, add_site
from simfoundry.backends.mjcf.attribute_values import (
    attribute_text,
    attribute_texts,
    exact_pose,
    inertial_attributes,
    with_exact_values,
)
from simfoundry.backends.mjcf.bodies import JOINT_TYPES, Assets, free_joint_name
from simfoundry.backends.mjcf.surroundings import camera_attributes
from simfoundry.backends.names import InvalidSceneError
from simfoundry.geometry.frames import IDENTITY, Pose
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from simfoundry.scene.kinematics import Tree, joint_transform, trees
from simfoundry.scene.meshfile import has_texture
from simfoundry.scene.model import Collider, Joint, JointType, Link, Scene, SceneObject, Visual

# Torsional and rolling friction of a geom in MuJoCo by default.
_RESISTANCE = (0.005, 0.0001)

_FLAGS = {False: "disable", True: "enable"}


@dataclass(frozen=True)
class NativeWriter:
    """A writer of a scene with native data into the ``root`` of an MJCF file."""

    scene: Scene
    root: ET.Element
    world: ET.Element
    assets: Assets

    def write(self) -> tuple[list[float], list[float]]:
        """Add the objects and everything that refers to them, and return the initial ``qpos`` and ``ctrl``."""
        qpos = [value for item in self.scene.objects for value in self._object(item)]
        self._elements("worldbody", self.world)
        self._exclusions()
        for section in ("asset", "contact", "tendon", "custom"):
            self._elements(section)
        self._mimics()
        self._elements("equality")
        ctrl = self._drives() + add_actuators(self.root, self.scene)
        ctrl += [0.0] * len(self._data.get("actuator", ()))
        self._elements("actuator")
        add_sensors(self.root, self.scene)
        self._elements("sensor")
        return qpos, self._order(ctrl)

    @property
    def _data(self) -> Mapping[str, Any]:
        assert self.scene.native is not None
        return self.scene.native

    def settings(self) -> None:
        """Add the settings that the native data specifies."""
        option = next(iter(self.root.iter("option")))
        for key in ("integrator", "cone", "impratio"):
            option.attrib.pop(key, None)
        if self.scene.options.solver_iterations is not None:
            option.set("iterations", str(self.scene.options.solver_iterations))
        option.attrib.update(attribute_texts(self._data.get("option", {})))
        if flags := self._data.get("flag"):
            ET.SubElement(option, "flag", {k: _FLAGS.get(v, str(v)) for k, v in flags.items()})
        for section in ("size", "statistic"):
            if given := self._data.get(section):
                ET.SubElement(self.root, section, attribute_texts(given))

    def keyframes(self, qpos: list[float], ctrl: list[float]) -> None:
        """Add the initial state and the other keyframes."""
        state = {name: exacts(values) for name, values in (("qpos", qpos), ("ctrl", ctrl)) if values}
        state |= attribute_texts(self._data.get("initial", {}))
        keyframe = ET.SubElement(self.root, "keyframe")
        ET.SubElement(keyframe, "key", {"name": "initial"} | state)
        for element in self._data.get("keyframe", ()):
            ET.SubElement(keyframe, "key", attribute_texts(element["key"]))

    def _elements(self, section: str, parent: ET.Element | None = None) -> None:
        """Add the elements of a section as they are."""
        if not (elements := self._data.get(section)):
            return
        parent = self.root.find(section) if parent is None else parent
        parent = ET.SubElement(self.root, section) if parent is None else parent
        for element in elements:
            ((tag, attributes),) = element.items()
            added = ET.SubElement(parent, tag, attribute_texts(attributes, "path"))
            for step in attributes.get("path", ()):
                ((inner, values),) = step.items()
                ET.SubElement(added, inner, attribute_texts(values))

    def _order(self, ctrl: list[float]) -> list[float]:
        """Sort the elements of sections by the order in the native data; others come last. Return ``ctrl`` sorted."""
        for section, names in self._data.get("order", {}).items():
            parent = self.root.find(section)
            if parent is None:
                continue
            rank = {name: k for k, name in enumerate(names)}
            old = list(parent)
            new = sorted(old, key=lambda e: rank.get(e.get("name", ""), len(rank)))
            parent[:] = new
            if section == "actuator" and ctrl:
                values = dict(zip(map(id, old), ctrl, strict=True))
                ctrl = [values[id(element)] for element in new]
        return ctrl

    # -- bodies --------------------------------------------------------------------------------------------------------

    def _object(self, item: SceneObject) -> Iterator[float]:
        for tree in trees(item):
            native = item.native.links.get(tree.root.name, {})
            if native.get("merge") and tree.fixed:
                yield from self._fill(self.world, tree, tree.root, tree.X_WT, is_world=True)
                continue
            X_LB = _body_frame(native)
            body = self._body(self.world, tree.name, tree.X_WT @ X_LB, native)
            if not tree.fixed:
                free = {"name": free_joint_name(tree), "type": "free"} | attribute_texts(native.get("freejoint", {}))
                ET.SubElement(body, "joint", free)
                yield from (*tree.X_WT.p, *tree.X_WT.q)
            yield from self._fill(body, tree, tree.root, X_LB.inverse())

    def _body(self, parent: ET.Element, name: str, X_PB: Pose, native: Mapping[str, Any]) -> ET.Element:
        own = {key: native[key] for key in ("gravcomp", "mocap", "user") if key in native}
        pose = with_exact_values(exact_pose(X_PB), native)
        return ET.SubElement(parent, "body", {"name": name} | pose | attribute_texts(own))

    def _fill(self, body: ET.Element, tree: Tree, link: Link, X_BL: Pose, is_world: bool = False) -> Iterator[float]:
        """Add the content of a link to its body, followed by the bodies below it."""
        item = tree.owner
        native = item.native.links.get(link.name, {})
        if link.gravity_compensation and "gravcomp" not in native:
            body.set("gravcomp", exact(link.gravity_compensation))
        if not is_world and not native.get("massless"):
            ET.SubElement(body, "inertial", inertial_attributes(link, X_BL, native))
        for attributes in self._geoms(item, link, X_BL):
            ET.SubElement(body, "geom", attributes)
        for site in item.sites:
            if site.link == link.name:
                add_site(body, f"{item.name}.{site.name}", site, X_BL)
        for mounted in self.scene.mounted:
            if mounted.carrier == item.name and (mounted.link or item.root.name) == link.name:
                ET.SubElement(body, "camera", camera_attributes(mounted.camera, X_BL))
        for child in dict.fromkeys(joint.child for joint in tree.joints if joint.parent == link.name):
            yield from self._child(body, tree, item.joints_above[child], X_BL)

    def _child(self, parent: ET.Element, tree: Tree, above: Sequence[Joint], X_PL: Pose) -> Iterator[float]:
        """Add the body below a link, including its joints and those of the links that are merged into it."""
        item, chain = tree.owner, [*above]
        while (below := _passed_on(item, chain[-1])) is not None:
            chain += item.joints_above[below.child]
        link = next(k for k in item.links if k.name == chain[-1].child)
        native = item.native.links.get(link.name, {})
        refs = [item.native.joints.get(j.name, {}).get("ref", 0.0) for j in chain]
        steps = [j.X_PC @ joint_transform(j, ref) for j, ref in zip(chain, refs, strict=True)]
        frames = [steps[0]]  # the poses of the links in the frame of the first parent, in the reference configuration
        for step in steps[1:]:
            frames.append(frames[-1] @ step)
        X_LB = _body_frame(native)
        X_LpB = frames[-1] @ X_LB
        body = self._body(parent, item.qualified(link.name), X_PL @ X_LpB, native)
        for j, frame in zip(chain, frames, strict=True):
            if j.type is not JointType.FIXED:
                ET.SubElement(body, "joint", _joint_attributes(item, j, X_LpB.inverse() @ frame))
                yield from j.motion.q if j.type is JointType.BALL else (j.position,)
        yield from self._fill(body, tree, link, X_LB.inverse())

    # -- geoms ---------------------------------------------------------------------------------------------------------

    def _geoms(self, item: SceneObject, link: Link, X_BL: Pose) -> Iterator[dict[str, str]]:
        """Yield the attributes of one geom for each part, or of one geom for each piece of a part in several pieces."""
        colliders = {c.name: c for c in link.colliders}
        for visual in link.visuals:
            collider = colliders.pop(visual.name, None)
            if collider is None and isinstance(visual.geometry, Mesh) and f"{visual.name}_1" not in colliders:
                collider = colliders.pop(f"{visual.name}_0", None)  # MuJoCo uses the hull of the visual mesh
            yield self._geom(item, link, visual, collider, X_BL)
        for collider in colliders.values():
            whole = item.native.meshes.get((link.name, collider.name))
            if whole is not None and isinstance(collider.geometry, Mesh):
                collider = replace(collider, geometry=whole)
            yield self._geom(item, link, None, collider, X_BL)

    def _geom(
        self, item: SceneObject, link: Link, visual: Visual | None, collider: Collider | None, X_BL: Pose
    ) -> dict[str, str]:
        shown = visual or collider
        assert shown is not None
        native = item.native.parts.get((link.name, shown.name))
        if native is None and collider is not None:  # a piece of a part
            native = item.native.parts.get((link.name, collider.name.rpartition("_")[0]))
        native = native or {}
        name = f"{item.qualified(link.name)}.{shown.name}"
        is_textured = (
            collider is not None and isinstance(shown.geometry, Mesh) and not isinstance(collider.geometry, Mesh)
        )
        shape = collider if is_textured and collider is not None else shown  # a textured primitive is shown as a mesh
        out = {"name": name} | self._shape(shape, native, name, X_BL, collider is not None)
        if visual is not None:
            texture = visual.geometry.texture if isinstance(visual.geometry, Mesh) else None
            if texture is not None and isinstance(visual.geometry, Mesh) and has_texture(visual.geometry):
                out["material"] = self.assets.material(texture, visual.rgba, name)
            else:
                out["rgba"] = exacts(visual.rgba)
        else:
            out |= {"group": "3", "rgba": "0.9 0.5 0.2 0.5"}
        if collider is None:
            out |= {"contype": "0", "conaffinity": "0"}
        else:
            out |= _surface(collider, native)
        out = with_exact_values(out, native)
        return out | attribute_texts(native, "type", "size", "friction", "mesh_inertia", "hfield", "top", "exact")

    def _shape(
        self, part: Visual | Collider, native: Mapping[str, Any], name: str, X_BL: Pose, collides: bool
    ) -> dict[str, str]:
        """Return the type, size and pose of a geom. A native plane is at the top of its box."""
        X_BG, geometry = X_BL @ part.X_LG, part.geometry
        if native.get("type") == "plane" and "size" in native and isinstance(geometry, Box):
            top = Pose.of([0.0, 0.0, geometry.size[2] / 2])
            return {"type": "plane", "size": attribute_text(native["size"])} | exact_pose(X_BG @ top)
        if native.get("type") == "hfield" and isinstance(geometry, Box):
            origin = Pose.of([0.0, 0.0, geometry.size[2] / 2 - float(native.get("top", 0.0))])
            return {"type": "hfield", "hfield": str(native.get("hfield"))} | exact_pose(X_BG @ origin)
        if "type" in native and "size" in native:
            return {"type": str(native["type"]), "size": attribute_text(native["size"])} | exact_pose(X_BG)
        match geometry:
            case Box(size=size):
                shape = {"type": "box", "size": exacts(size / 2)}
            case Sphere(radius=radius):
                shape = {"type": "sphere", "size": exact(radius)}
            case Cylinder(radius=radius, height=height):
                shape = {"type": "cylinder", "size": exacts([radius, height / 2])}
            case Capsule(radius=radius, height=height):
                shape = {"type": "capsule", "size": exacts([radius, height / 2])}
            case Mesh():
                convex = collides and isinstance(part, Collider)
                mesh = self.assets.mesh(geometry, name, convex, str(native.get("mesh_inertia", "")))
                shape = {"type": "mesh", "mesh": mesh}
        return shape | exact_pose(X_BG)

    # -- what refers to bodies -----------------------------------------------------------------------------------------

    def _exclusions(self) -> None:
        """Add the pairs that the document excludes; MuJoCo itself excludes bodies that are connected by a joint."""
        own = [(o.qualified(a), o.qualified(b)) for o in self.scene.objects for a, b in o.no_contact]
        names = {body.get("name") for body in self.world.iter("body")}
        for a, b in (*own, *self.scene.no_contact):
            pair = {"body1": a if a in names else "world", "body2": b if b in names else "world"}
            if pair["body1"] != pair["body2"]:
                parent = self.root.find("contact")
                ET.SubElement(ET.SubElement(self.root, "contact") if parent is None else parent, "exclude", pair)

    def _mimics(self) -> None:
        for item in self.scene.objects:
            for joint in (joint for joint in item.joints if joint.mimic is not None):
                assert joint.mimic is not None
                name, leader = f"{item.name}.{joint.name}", f"{item.name}.{joint.mimic.joint}"
                native = item.native.joints
                zero, lead = (native.get(n, {}).get("ref", 0.0) for n in (joint.name, joint.mimic.joint))
                # MuJoCo applies the polynomial to deviations from the reference positions.
                offset = joint.mimic.offset - zero + joint.mimic.multiplier * lead
                ratio = {"polycoef": exacts([offset, joint.mimic.multiplier, 0, 0, 0])}
                parent = self.root.find("equality")
                parent = ET.SubElement(self.root, "equality") if parent is None else parent
                own = attribute_texts(native.get(joint.name, {}).get("equality", {}))
                ET.SubElement(parent, "joint", {"name": name, "joint1": name, "joint2": leader} | ratio | own)

    def _drives(self) -> list[float]:
        """Add an actuator for each drive that the document specifies itself, and return their targets."""
        ctrl, parent = [], ET.Element("actuator")
        for item in self.scene.objects:
            for joint in item.joints:
                drive, native = joint.drive, item.native.joints.get(joint.name, {})
                if drive is None or drive.actuator or native.get("drive") == "spring":
                    continue
                name = f"{item.name}.{joint.name}"
                gains = {"gainprm": exact(drive.stiffness), "biasprm": exacts([0, -drive.stiffness, -drive.damping])}
                limit = drive.force_limit
                forces = {} if limit is None else {"forcerange": exacts([-limit, limit])}
                ET.SubElement(parent, "general", {"name": name, "joint": name, "biastype": "affine"} | gains | forces)
                ctrl.append(drive.target)
        if ctrl:
            self.root.append(parent)
        return ctrl


# Attributes that refer to elements, by the tag of these elements.
_REFERENCES = {
    **dict.fromkeys(("joint", "joint1", "joint2", "jointinparent"), "joint"),
    **dict.fromkeys(("body", "body1", "body2", "subtree1", "subtree2"), "body"),
    **dict.fromkeys(("site", "site1", "site2", "sidesite", "refsite", "cranksite", "slidersite"), "site"),
    **dict.fromkeys(("geom", "geom1", "geom2"), "geom"),
    **dict.fromkeys(("tendon", "tendon1", "tendon2"), "tendon"),
    "camera": "camera",
}


def check_references(root: ET.Element) -> None:
    """Raise :class:`InvalidSceneError` if an element refers to another one that does not exist."""
    names: dict[str, set[str]] = {"body": {"world"}}
    for tag in ("body", "joint", "geom", "site", "camera"):
        names.setdefault(tag, set()).update(e.get("name", "") for e in root.findall(f"./worldbody//{tag}"))
    names["tendon"] = {e.get("name", "") for e in root.findall("./tendon/*")}
    for section in ("contact", "tendon", "equality", "actuator", "sensor"):
        for element in root.findall(f"./{section}/*"):
            what = f"`{element.get('name') or element.tag}` of `native.mjcf.{section}`"
            for each in element.iter():
                for key, tag in _REFERENCES.items():
                    if (name := each.get(key)) is not None and name not in names[tag]:
                        known = ", ".join(f"`{n}`" for n in sorted(names[tag])[:8]) or "none"
                        raise InvalidSceneError(
                            f"{what} refers to the {tag} `{name}`, which does not exist; there are {known}"
                        )


def _body_frame(native: Mapping[str, Any]) -> Pose:
    """Return the pose of MuJoCo's body frame in the frame of its link."""
    if "pos" not in native and "quat" not in native:
        return IDENTITY
    return Pose.of(native.get("pos", (0.0, 0.0, 0.0)), native.get("quat", (1.0, 0.0, 0.0, 0.0)))


def _passed_on(item: SceneObject, joint: Joint) -> Joint | None:
    """Return the only joint below a link that is merged into the next body, or None if the link is a body."""
    if not item.native.links.get(joint.child, {}).get("merge") or joint.type is JointType.FIXED:
        return None
    link = next(k for k in item.links if k.name == joint.child)
    below = [j for j in item.joints if j.parent == joint.child]
    is_empty = not (link.visuals or link.colliders or any(site.link == link.name for site in item.sites))
    return (
        below[0]
        if is_empty and len({j.child for j in below}) == 1 and below[0].type not in (JointType.FIXED, JointType.FREE)
        else None
    )


def _surface(collider: Collider, native: Mapping[str, Any]) -> dict[str, str]:
    """Return the friction of a geom. Its sliding friction is the collider's, unless its contacts do not slide."""
    spinning, rolling = collider.torsional_friction, collider.rolling_friction
    friction = [collider.friction, spinning or _RESISTANCE[0], rolling or _RESISTANCE[1]]
    if "friction" in native:
        friction = [native["friction"][0] if native.get("condim") == 1 else collider.friction, *native["friction"][1:]]
    out = {"friction": exacts(friction)}
    if spinning or rolling:
        out["condim"] = "6" if rolling else "4"
    if collider.restitution > 0:
        out["solref"] = exacts(rules.solref(collider.restitution))
    return out


def _joint_attributes(item: SceneObject, joint: Joint, X_BJ: Pose) -> dict[str, str]:
    """Return the attributes of a joint whose frame has the pose ``X_BJ`` in its body."""
    native = item.native.joints.get(joint.name, {})
    out = {"name": f"{item.name}.{joint.name}", "type": JOINT_TYPES[joint.type]}
    if (position := exacts(X_BJ.p)) != "0 0 0":
        out["pos"] = position
    if joint.has_axis:
        out["axis"] = exacts(X_BJ.rotation @ joint.axis)
    if joint.limits is not None and joint.type is not JointType.CONTINUOUS:
        out["range"] = exacts(joint.limits)
    if joint.effort is not None:
        out["actuatorfrcrange"] = exacts([-joint.effort, joint.effort])
    values = [("damping", joint.damping), ("frictionloss", joint.friction), ("armature", joint.armature)]
    if native.get("drive") == "spring" and joint.drive is not None:
        values += [("stiffness", joint.drive.stiffness), ("springref", joint.drive.target)]
    out |= {key: exact(value) for key, value in values if value}
    if native.get("limited") is False:
        out.pop("range", None)
    return with_exact_values(out, native) | attribute_texts(native, "drive", "equality", "exact")
