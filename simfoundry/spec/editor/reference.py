"""``docs/reference.md``: every key of every document, written from the models, with an example of each kind."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.yaml.write import number

Schema = dict[str, Any]

INTRODUCTION = """\
# Reference

<!-- Written by `make schemas` from simfoundry/spec; edit the models, not this page. -->

A document is a YAML 1.2 file whose first key names its kind. Lengths are in metres, masses in kilograms, times in
seconds; an angle carries its unit in its key. A *name* is lower-case letters, digits and `_`, starts with a letter and
has at most 64 characters. Unknown keys and keys written twice are errors. In the tables, `[number] × 3` is a list of
three numbers and *name → number* a mapping from names. Frames, orders and the meaning of friction are in
[conventions.md](conventions.md).
"""

EXAMPLES = {
    "scene/1": """\
simfoundry: scene/1
name: breakfast
viewpoint: arm

materials:
  wood: {density: 700, friction: 0.5}
  ceramic: {density: 2400, friction: 0.35, restitution: 0.05, color: [0.9, 0.9, 0.85]}

objects:
  table:
    fixed: true
    shape: {box: [1.2, 0.7, 0.04]}
    material: wood
    pose: {xyz: [0.45, 0, -0.02]}
  cup:
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    material: ceramic
    mass: {value: 0.31, range: [0.25, 0.4], source: category_table}
    pose: {xyz: [0.4, 0.1, 0.05]}
  saucer:
    shape: {cylinder: {radius: 0.07, height: 0.012}}
    material: ceramic
    place: {on: table, left_of: cup, gap: 0.05}
  cabinet:
    asset: drawer_cabinet.asset.yaml
    joints: {drawer_slide: 0.05}
    pose: {xyz: [0.6, -0.15, 0.1], yaw_deg: 180}

robots:
  arm: {model: franka_robotiq, joints: home}

cameras:
  front: {size: [1280, 720], fx: 900, fy: 900, pose: {xyz: [1.4, 0, 0.6], look_at: [0.45, 0, 0]}}

lights:
  sky: {type: dome, intensity: 0.6}

relations:
  - OnTop(cup, table)
""",
    "task/1": """\
simfoundry: task/1
name: cup_on_saucer
scene: breakfast.scene.yaml
instruction: Put the cup on the saucer.
goal:
  all:
    - OnTop(cup, saucer)
    - Released(cup)
subtasks:
  pick_up_cup: {goal: Grasped(cup)}
  cup_on_saucer: {goal: OnTop(cup, saucer)}
reset:
  objects:
    cup: {x: [0.35, 0.45], y: [0, 0.15], yaw_deg: [-180, 180]}
horizon: 450
""",
    "asset/1": """\
simfoundry: asset/1
name: drawer_cabinet
category: cabinet

materials:
  board: {density: 650, friction: 0.4}

links:
  body:
    material: board
    parts:
      left: {shape: {box: [0.3, 0.02, 0.2]}, pose: {xyz: [0, 0.11, 0]}}
      right: {shape: {box: [0.3, 0.02, 0.2]}, pose: {xyz: [0, -0.11, 0]}}
      top: {shape: {box: [0.3, 0.24, 0.02]}, pose: {xyz: [0, 0, 0.11]}}
  drawer:
    material: board
    parts:
      tray: {shape: {box: [0.26, 0.18, 0.06]}}

joints:
  drawer_slide:
    type: prismatic
    parent: body
    child: drawer
    axis: [1, 0, 0]
    limits: [0, 0.2]
    damping: 2
""",
    "capture/1": """\
simfoundry: capture/1
name: desk

frames:
  first:
    color: color.png
    depth: {image: depth.png, scale: 0.001}
    camera: {fx: 615.3, fy: 615.1, cx: 319.5, cy: 239.5}
    masks: {image: masks.png, names: {mug: 1, stapler: 2}}
""",
    "cousins/1": """\
simfoundry: cousins/1
name: breakfasts
twin: cup_on_saucer.task.yaml
count: 50
seed: 7
scene:
  anchor: saucer
  objects:
    cup: [LeftOf, RightOf, InFrontOf, Behind]
distractors: {count: [1, 3], mass: {max: 0.5}}
""",
    "policy/1": """\
simfoundry: policy/1
name: pi05_droid_jointpos
protocol: openpi
address: localhost:8000
action_space: joint_position
horizon: 8
cameras:
  observation/exterior_image_1_left: {camera: exterior_left, size: [224, 224], render: [448, 252]}
  observation/wrist_image_left: {camera: wrist, size: [224, 224], render: [448, 252]}
gripper: {open: 0, closed: 1, threshold: 0.5}
""",
}

_PATTERNS = {
    "^[a-z][a-z0-9_]*$": "name",
    r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)?$": "name or name.part",
    "^SF[0-9]{3}$": "code",
    "^[A-Za-z_][A-Za-z0-9_./-]*$": "joint",
    "^[A-Za-z0-9_][A-Za-z0-9_./-]*$": "key",
    "^[A-Z_][A-Z0-9_]*$": "environment variable",
}
"""What the texts of a pattern are called."""


def reference() -> str:
    """The text of the page."""
    schemas = {kind: model_of(kind).model_json_schema() for kind in KINDS}
    uses = [set(schema["$defs"]) for schema in schemas.values()]
    shared = {name for name in set().union(*uses) if sum(name in names for names in uses) > 1}
    lines = [INTRODUCTION]
    parts: dict[str, Schema] = {}
    for kind, schema in schemas.items():
        lines += [f"## {kind}\n", f"{schema['description']}\n", "```yaml", EXAMPLES[kind].rstrip(), "```\n"]
        lines += _table(schema)
        lines += _sections({n: d for n, d in schema["$defs"].items() if n not in shared})
        parts |= {n: d for n, d in schema["$defs"].items() if n in shared}
    lines += ["## Shared by all kinds\n", *_sections(parts)]
    return "\n".join(lines).rstrip() + "\n"


def _sections(parts: dict[str, Schema]) -> Iterator[str]:
    """A heading and a table of each part, by title; the shapes, of one key each, share theirs."""
    by_title: dict[str, list[Schema]] = {}
    for name, part in parts.items():
        by_title.setdefault(_title(name), []).append(part)
    for title, alike in sorted(by_title.items()):
        yield f"### {title}\n"
        yield f"{alike[0]['description'] if len(alike) == 1 else 'One of these keys.'}\n"
        merged = {n: {"description": p["description"], **f} for p in alike for n, f in p["properties"].items()}
        yield from _table(alike[0] if len(alike) == 1 else {"properties": merged})


def _table(model: Schema) -> Iterator[str]:
    yield "| key | type | meaning | default |"
    yield "|---|---|---|---|"
    required = model.get("required", ())
    for key, field in model["properties"].items():
        default = "**required**" if key in required else _default(field.get("default"))
        meaning = field.get("description", "")
        yield f"| `{key}` | {_type(field)} | {_cell(meaning)} | {default} |"
    yield ""


def _title(name: str) -> str:
    """``CameraSpec`` is shown as ``Camera``, ``DepthImage`` as ``Depth image``, every shape as ``Shape``."""
    if name.endswith("Shape"):
        return "Shape"
    words = re.findall(r"[A-Z][a-z]+", name.removesuffix("Spec"))
    return " ".join(words).capitalize()


def _type(field: Schema) -> str:
    """What a value may be, in words, with links to the tables of mappings."""
    match field:
        case {"anyOf": options} | {"oneOf": options}:
            return " or ".join(dict.fromkeys(_type(o) for o in options if o.get("type") != "null"))
        case {"$ref": target}:
            title = _title(target.rpartition("/")[2])
            return f"[{title.lower()}](#{title.lower().replace(' ', '-')})"
        case {"const": value}:
            return f"`{value}`"
        case {"enum": values}:
            return ", ".join(f"`{v}`" for v in values)
        case {"prefixItems": items}:
            return _fixed_list([_type(i) for i in items])
        case {"items": item}:
            return f"list of {_type(item)}{_length(field)}"
        case {"patternProperties": patterns}:
            pattern, value = next(iter(patterns.items()))
            return f"{_PATTERNS[pattern]} → {_type(value)}"
        case {"pattern": pattern}:
            return _PATTERNS[pattern]
        case {"type": "object", "additionalProperties": dict(value)}:
            return f"text → {_type(value)}"
        case {"type": "string"}:
            return "text"
        case {"type": "boolean"}:
            return "`true`, `false`"
        case {"type": kind}:
            return f"{kind}{_range(field)}"
        case {"title": _}:
            return "anything"
    raise ValueError(f"no words for {field}")


def _fixed_list(kinds: list[str]) -> str:
    return f"[{kinds[0]}] × {len(kinds)}" if len(set(kinds)) == 1 else f"[{', '.join(kinds)}]"


def _length(field: Schema) -> str:
    low, high = field.get("minItems"), field.get("maxItems")
    bounds = [f"at least {low}"] * (low is not None) + [f"at most {high}"] * (high is not None)
    return f" ({', '.join(bounds)})" if bounds else ""


def _range(field: Schema) -> str:
    """The bounds of a number: `` > 0``, `` 0 to 1``, or nothing."""
    match field:
        case {"minimum": low, "maximum": high}:
            return f" {low} to {high}"
        case {"exclusiveMinimum": low}:
            return f" > {low}"
        case {"minimum": low}:
            return f" ≥ {low}"
    return ""


def _default(value: Any) -> str:
    match value:
        case None:
            return "–"
        case dict() | list() if not value:
            return "empty"
        case dict():
            return ", ".join(f"`{k}: {_literal(v)}`" for k, v in value.items() if v is not None)
    return f"`{_literal(value)}`"


def _literal(value: Any) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case float() | int():
            return number(value)
        case list() | tuple():
            return f"[{', '.join(_literal(v) for v in value)}]"
    return str(value)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
