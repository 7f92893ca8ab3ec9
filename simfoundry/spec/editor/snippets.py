"""What editors offer beside what the models say: a first value for each key, and what the words of a choice mean."""

from __future__ import annotations

from typing import Any

from simfoundry.spec.models.predicate import PREDICATES, built_in_predicates
from simfoundry.spec.models.robot_file import find_robot, robot_names


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


CHOICES = {
    ("auto", "hull", "decompose", "none"): (
        "One hull where the mesh is nearly convex, convex parts where it is not (the default).",
        "One convex hull.",
        "Convex parts.",
        "No contact at all.",
    ),
    ("exact", "hull"): (
        "The volume of the mesh itself, which must be closed (the default).",
        "The volume of its convex hull.",
    ),
    (False, True): ("It can move (the default).", "It is welded to the world."),
    ("distant", "point", "dome"): (
        "Parallel rays along `direction`, as from the sun.",
        "A bulb at `xyz`.",
        "Light from everywhere, as from a cloudy sky.",
    ),
    ("both", "visual", "collision"): (
        "It is seen, touches and weighs (the default).",
        "It is only seen.",
        "It touches and weighs, and is not seen.",
    ),
    ("lower", "upper"): (
        "It is closed at its lower limit.",
        "It is closed at its upper limit.",
    ),
    ("fixed", "revolute", "prismatic", "continuous", "ball", "free"): (
        "It does not move.",
        "It turns about `axis` within `limits_deg`, as a door.",
        "It slides along `axis` within `limits` [m], as a drawer.",
        "It turns about `axis` without limits, as a wheel.",
        "It turns about every axis, as a shoulder.",
        "Nothing holds it: it lies in or on the parent, as a lid.",
    ),
    ("LeftOf", "RightOf", "InFrontOf", "Behind", "OnTop", "Inside", "NextTo"): tuple(
        _sentence(PREDICATES.load(name).meaning)
        for name in ("LeftOf", "RightOf", "InFrontOf", "Behind", "OnTop", "Inside", "NextTo")
    ),
    ("procedural", "library", "model"): (
        "Made by rules from the object itself.",
        "Taken from a library of meshes.",
        "Made by an image model and a mesh model.",
    ),
    ("mujoco", "pybullet"): (
        "In which it is tried out (the default).",
        "It lasts there for two seconds, too; PyBullet must be installed.",
    ),
    ("geometry", "topology", "appearance"): (
        "Proportions and curves.",
        "Which parts it has, and how many.",
        "Colour and material.",
    ),
    ("joint_position", "joint_velocity"): (
        "Where the joints shall be [rad or m].",
        "How fast the joints shall move.",
    ),
    ("joints", "gripper", "joints_gripper", "hand"): (
        "Positions of the arm's joints, in order [rad or m].",
        "The gripper, in the numbers of `gripper`.",
        "Joints and gripper of each robot in turn, as in an action.",
        "Position of the hand in the base [m], and roll, pitch, yaw [rad].",
    ),
    ("affordances", "model"): (
        "Every task that the objects afford, counted out (the default).",
        "Tasks that a vision-language model proposes.",
    ),
}
"""What each word of a choice means, in the order of the words."""

NAMES = {
    r"^[a-z][a-z0-9_]*$": ("name", "a name starts with a lower-case letter, then lower-case letters, digits and `_`"),
    r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)?$": ("name", "a name as `cabinet`, or one of its links as `cabinet.drawer`"),
    "^SF[0-9]{3}$": ("SF402", "the code of a warning, as `SF402`"),
    "^[A-Za-z_][A-Za-z0-9_./-]*$": ("joint", "the name of a joint, as the robot's own model has it"),
    "^[A-Za-z0-9_][A-Za-z0-9_./-]*$": ("key", "a key of the policy's own, as `observation/wrist_image_left`"),
    "^[A-Z_][A-Z0-9_]*$": ("VARIABLE", "the name of an environment variable in capitals, never a key itself"),
}
"""What to call a text of a pattern where a key of that pattern is offered, and what to say where one does not match."""

OBJECT = {"shape": "{box: [${2:0.1}, ${3:0.1}, ${4:0.1}]}", "mass": "${5:0.3}", "place": "{on: ${6:table}}"}
CAMERA = {
    "size": "[${2:640}, ${3:480}]",
    "fx": "${4:600}",
    "fy": "${4:600}",
    "pose": "{xyz: [${5:1.2}, ${6:0}, ${7:0.6}], look_at: [${8:0.45}, ${9:0}, ${10:0}]}",
}
LINK = {"mass": "${2:1}", "parts": {"${3:body}": "{shape: {box: [${4:0.1}, ${5:0.1}, ${6:0.1}]}}"}}
JOINT = {
    "type": "prismatic",
    "parent": "${2:body}",
    "child": "${3:drawer}",
    "axis": "[${4:1}, 0, 0]",
    "limits": "[0, ${5:0.3}]",
}
SHOT = {
    "color": "${2:color.png}",
    "depth": "{image: ${3:depth.png}, scale: ${4:0.001}}",
    "camera": "{fx: ${5:600}, fy: ${5:600}, cx: ${6:319.5}, cy: ${7:239.5}}",
}

VIEW = "{camera: ${2:wrist}, size: [${3:224}, ${4:224}], render: [${5:448}, ${6:252}]}"

Body = str | list[Any] | dict[str, Any]
"""A first value with holes to fill in, as ``${1:0.5}``: a text as it is written, or what is written over lines."""

CUP = (
    "[[0, 0], [${1:0.04}, 0], [${1:0.04}, ${2:0.1}], [${3:0.035}, ${2:0.1}], [${3:0.035}, ${4:0.005}], [0, ${4:0.005}]]"
)
"""The profile of a cup: out along its foot, up its wall, over its rim and down inside."""

FIRST: dict[str, Body] = {
    "api_key": "${1:OPENPI_API_KEY}",
    "address": "${1:localhost:8000}",
    "asset": "${1:mug.glb}",
    "background": "{mesh: ${1:room.glb}}",
    "Masks.background": "[${1:0}]",
    "behind": "${1:name}",
    "box": "[${1:0.1}, ${2:0.1}, ${3:0.1}]",
    "source": "${1:me}",
    "camera": "{fx: ${1:600}, fy: ${2:600}, cx: ${3:319.5}, cy: ${4:239.5}}",
    "cameras": {"${1:front}": CAMERA},
    "CameraView.camera": "${1:wrist}",
    "PolicySpec.cameras": {"${1:observation/wrist_image_left}": VIEW},
    "CameraView.render": "[${1:448}, ${2:252}]",
    "CameraView.size": "[${1:224}, ${2:224}]",
    "PolicySpec.state": {"${1:observation/joint_position}": "${2:joints}"},
    "PolicySpec.gripper": "{open: ${1:0}, closed: ${2:1}, threshold: ${3:0.5}}",
    "PolicySpec.horizon": "${1:8}",
    "velocity_unit": "${1:3}",
    "capture": "${1:name}",
    "capsule": "{radius: ${1:0.02}, height: ${2:0.1}}",
    "categories": "[${1:mug}]",
    "category": "${1:mug}",
    "child": "${1:drawer}",
    "Shot.color": "${1:color.png}",
    "color": "[${1:0.8}, ${2:0.8}, ${3:0.8}]",
    "components": "[${1:handle}]",
    "confidence": "${1:0.9}",
    "cx": "${1:319.5}",
    "cy": "${1:239.5}",
    "cylinder": "{radius: ${1:0.04}, height: ${2:0.1}}",
    "deg": "${1:30}",
    "density": "${1:700}",
    "DistractorAxis.density": "{min: ${1:100}, max: ${2:3000}}",
    "depth": "{image: ${1:depth.png}, scale: ${2:0.001}}",
    "description": "${1:What it is, for people.}",
    "distractors": "{count: [${1:1}, ${2:4}]}",
    "extends": "${1:twin.scene.yaml}",
    "fit_error": "${1:0.002}",
    "frames": {"${1:first}": SHOT},
    "friction": "${1:0.5}",
    "fx": "${1:600}",
    "fy": "${1:600}",
    "height": "${1:0.1}",
    "image": "${1:depth.png}",
    "Masks.image": "${1:masks.png}",
    "in_front_of": "${1:name}",
    "inertia": "[${1:0.001}, ${2:0.001}, ${3:0.001}, 0, 0, 0]",
    "inertial": "{inertia: [${1:0.001}, ${2:0.001}, ${3:0.001}, 0, 0, 0]}",
    "inside": "${1:bowl}",
    "instruction": "${1:Put the cup on the plate.}",
    "RobotSpec.joints": "${1:home}",
    "JointSpec.axis": "[${1:0}, ${2:0}, ${3:1}]",
    "AssetSpec.joints": {"${1:slide}": JOINT},
    "joints": "{${1:drawer}: ${2:0}}",
    "Start.joints": "{${1:cabinet}: {${2:drawer}: ${3:0}}}",
    "lathe": f"{{profile: {CUP}}}",
    "min": "${1:0.1}",
    "labels": "[${1:mug}]",
    "left_of": "${1:name}",
    "library": "${1:assets}",
    "lights": {"${1:sky}": "{type: ${2:dome}}"},
    "limits": "[${1:0}, ${2:0.3}]",
    "limits_deg": "[${1:0}, ${2:90}]",
    "links": {"${1:body}": LINK},
    "look_at": "[${1:0.45}, ${2:0}, ${3:0}]",
    "DistractorAxis.mass": "{min: ${1:0.05}, max: ${2:1}}",
    "mass": "${1:0.3}",
    "masks": "{image: ${1:masks.png}, names: {${2:mug}: ${3:1}}}",
    "material": "${1:wood}",
    "materials": {"${1:wood}": "{density: ${2:700}, friction: ${3:0.5}}"},
    "mesh": "${1:mesh.glb}",
    "mjcf": "${1:robot.xml}",
    "max": "${1:1}",
    "mount": "${1:arm.hand}",
    "name": "${1:name}",
    "names": "{${1:mug}: ${2:1}}",
    "note": "${1:What was assumed.}",
    "object": "{objects: {${1:cup}: {}}}",
    "objects": {"${1:cup}": OBJECT},
    "SceneAxis.objects": "{${1:cup}: [${2:LeftOf}, ${3:RightOf}]}",
    "ObjectAxis.objects": "{${1:cup}: {}}",
    "Reset.objects": {"${1:cup}": "{x: [${2:0.35}, ${3:0.55}], y: [${4:-0.2}, ${5:0.2}]}"},
    "TaskAxis.objects": "[${1:cup}]",
    "on": "${1:table}",
    "opening": "${1:0.08}",
    "origin": "{capture: ${1:name}}",
    "outline": "[[${1:-0.1}, ${2:-0.1}], [${3:0.1}, ${4:-0.1}], [${5:0}, ${6:0.1}]]",
    "parent": "${1:body}",
    "parts": {"${1:body}": "{shape: {box: [${2:0.1}, ${3:0.1}, ${4:0.1}]}}"},
    "place": "{on: ${1:table}, xy: [${2:0.45}, ${3:0}]}",
    "Start.place": "{${1:cup}: {on: ${2:plate}}}",
    "pose": "{xyz: [${1:0}, ${2:0}, ${3:0}]}",
    "CameraSpec.pose": "{xyz: [${1:1.2}, ${2:0}, ${3:0.6}], look_at: [${4:0.45}, ${5:0}, ${6:0}]}",
    "Start.pose": "{${1:cup}: {xyz: [${2:0.4}, ${3:0}, ${4:0.05}]}}",
    "prism": "{outline: [[${1:-0.1}, ${2:-0.1}], [${3:0.1}, ${4:-0.1}], [${5:0}, ${6:0.1}]], height: ${7:0.02}}",
    "profile": CUP,
    "quat_wxyz": "[${1:1}, ${2:0}, ${3:0}, ${4:0}]",
    "radius": "${1:0.04}",
    "range": "[${1:0.2}, ${2:0.4}]",
    "reach": "${1:0.8}",
    "relations": ["${1:OnTop(cup, table)}"],
    "reset": {"objects": {"${1:cup}": "{x: [${2:0.35}, ${3:0.55}], y: [${4:-0.2}, ${5:0.2}]}"}},
    "restitution": "${1:0.1}",
    "right_of": "${1:name}",
    "robots": {"${1:arm}": "{model: ${2:demo_arm}}"},
    "TaskSpec.robots": "[${1:arm}]",
    "TaskSpec.scene": "${1:desk.scene.yaml}",
    "scene": "{anchor: ${1:plate}, objects: {${2:cup}: [${3:LeftOf}, ${4:RightOf}]}}",
    "shape": "{box: [${1:0.1}, ${2:0.1}, ${3:0.1}]}",
    "size": "[${1:640}, ${2:480}]",
    "sphere": "${1:0.03}",
    "splat": "${1:room.ply}",
    "start": "{place: {${1:cup}: {on: ${2:plate}}}}",
    "subtasks": {"${1:pick_up_cup}": "{goal: ${2:Grasped(cup)}}"},
    "task": "{count: ${1:10}}",
    "truth": "${1:truth.scene.yaml}",
    "twin": "${1:desk.scene.yaml}",
    "urdf": "${1:robot.urdf}",
    "variant": "${1:tall}",
    "variants": {"${1:red}": "{color: [${2:0.8}, ${3:0.1}, ${4:0.1}]}"},
    "usd": "${1:robot.usd}",
    "value": "${1:0.3}",
    "viewpoint": "${1:arm}",
    "visual": "${1:mug.glb}",
    "volume": "{min: ${1:0.0001}, max: ${2:0.002}}",
    "exclude_categories": "[${1:knife}]",
    "x": "[${1:0.35}, ${2:0.55}]",
    "xy": "[${1:0.45}, ${2:0}]",
    "local_xy": "[${1:0}, ${2:0}]",
    "xyz": "[${1:0}, ${2:0}, ${3:0}]",
    "y": "[${1:-0.2}, ${2:0.2}]",
    "yaw_deg": "${1:30}",
    "rpy_deg": "[${1:0}, ${2:0}, ${3:30}]",
    "all": "[${1:OnTop(cup, plate)}]",
    "any": "[${1:OnTop(cup, plate)}]",
    "allow": "{${1:SF402}: ${2:why}}",
}
"""A first value for a key, by ``Model.key`` or ``key``; a key with a default starts with that.

Without one, an editor offers what the value itself offers: predicates for a goal, the known robots for a model.
"""

MEMBERS: dict[str, Body] = {
    "Material": "{density: ${1:700}, friction: ${2:0.5}}",
    "RobotSpec": "{model: ${1:demo_arm}, pose: {xyz: [${2:0}, ${3:0}, ${4:0}]}}",
    "LightSpec": "{type: ${1:dome}}",
    "PartSpec": "{shape: {box: [${1:0.1}, ${2:0.1}, ${3:0.1}]}}",
    "ResetRegion": "{x: [${1:0.35}, ${2:0.55}], y: [${3:-0.2}, ${4:0.2}]}",
    "Subtask": "{goal: ${1:Grasped(cup)}}",
    "Place": "{on: ${1:table}}",
    "PoseSpec": "{xyz: [${1:0}, ${2:0}, ${3:0}]}",
    "ObjectVariants": "{count: ${1:9}}",
    "ObjectSpec": OBJECT,
    "VariantSpec": "{color: [${1:0.8}, ${2:0.1}, ${3:0.1}]}",
    "CameraSpec": CAMERA,
    "JointSpec": JOINT,
    "LinkSpec": LINK,
    "Shot": SHOT,
    "CameraView": VIEW.replace("${2:", "${1:"),
}
"""A first value for a member of a mapping by name, by its model."""

WORDS = {
    "CylinderShape.cylinder": "Radius and height [m].",
    "CapsuleShape.capsule": "Radius, and height without the caps [m].",
    "PrismShape.prism": "Outline in xy, and height along z [m].",
    "LatheShape.lathe": "A cup, a bowl, a plate, a bottle: corners of half its cut as (radius, height) [m].",
    "Shot.depth": "The depth picture that belongs to it.",
}
"""What is said of keys of which their model says nothing."""

CONDITIONS = {
    "all": "{all: [$1]}",
    "any": "{any: [$1]}",
}


def predicates() -> list[dict[str, str]]:
    """A snippet for each predicate."""
    words = {"thing": "object", "body": "object", "joint": "object.joint", "robot": "robot"}
    out = []
    for name, predicate in built_in_predicates().items():
        kinds = predicate.parameters[: len(predicate.parameters) - predicate.optional]
        arguments = [words.get(kind, "xyz"[k - 1]) for k, kind in enumerate(kinds)]
        holes = ", ".join(f"${{{k}:{word}}}" for k, word in enumerate(arguments, 1))
        meaning = _sentence(predicate.meaning)
        out.append({"label": f"{name}({', '.join(arguments)})", "description": meaning, "body": f"{name}({holes})"})
    return out


def robots() -> list[dict[str, str]]:
    """A snippet for each robot that is known by name."""
    return [
        {
            "label": name,
            "description": f"Reaches {robot.reach:g} m from its base; its fingers open {robot.opening * 1000:g} mm.",
            "body": name,
        }
        for name in robot_names()
        if (robot := find_robot(name)) is not None
    ]
