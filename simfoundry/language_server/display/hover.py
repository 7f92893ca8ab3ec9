"""Hovers: the meanings of keys, and the computed properties of objects and other named members."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.display.links import existing_file
from simfoundry.language_server.display.markdown import escaped
from simfoundry.lint.draft import DraftScene
from simfoundry.spec.check.pages import page
from simfoundry.spec.compose.parameters import PARAMETER, ParameterError, evaluate, is_expression
from simfoundry.spec.editor.keys import key_meaning
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import kind_of
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.predicate import PREDICATES, Predicate, canonical
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.models.types import REFERENCES, file_patterns
from simfoundry.spec.yaml.write import number

Path_ = tuple[str | int, ...]

# A name, or the name of a part after that of its object, with the parameter's mark.
_NAME = re.compile(r"\$?[A-Za-z][A-Za-z0-9_]*(?:\.[a-z][a-z0-9_]*)?")
_CALL = re.compile(r"(?<!\w)([A-Za-z]\w*)\s*\(([^()]*)\)")
_NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_CODE = re.compile(r"SF[0-9]{3}\Z")

# Sections whose members are named by the keys below them, in any kind of document: a start lists objects, for example.
_NAMED_BY_KEY = {"pose": "objects", "place": "objects", "joints": "joints"}


@dataclass(frozen=True)
class HoverText:
    """The description of a range of the text.

    Attributes:
        text: The description, as Markdown.
        start: The start of the range, a character offset.
        end: The end of the range, exclusive.
        object: The name of the object to show a picture of, or an empty string.
    """

    text: str
    start: int
    end: int
    object: str = ""


@dataclass(frozen=True)
class Token:
    """The word under the pointer, and where it is in the document.

    Attributes:
        path: Keys and indices from the top of the document to the value or key.
        is_key: True if the word is a key.
        word: The word, which may name a part of an object.
        value: The whole value that the word is in, or the key.
        start: The start of the word, a character offset.
        end: The end of the word, exclusive.
        at: The offset of the pointer.
        from_: The start of the whole value.
    """

    path: Path_
    is_key: bool
    word: str
    value: str
    start: int
    end: int
    at: int
    from_: int


@dataclass(frozen=True)
class HoverContext:
    """The documents that answer a question.

    Attributes:
        analysis: The analysis of the text.
        draft: The lowered scene, which may be that of an older text, or None.
        lowered: The document from which the scene was lowered, or None.
    """

    analysis: Analysis
    draft: DraftScene | None = None
    lowered: Loaded | None = None

    @property
    def scene(self) -> Loaded | None:
        """Return the scene document whose names the document uses, which may be the document itself."""
        return scene_document(self.lowered) if self.lowered is not None else None


def scene_document(loaded: Loaded) -> Loaded | None:
    """Return the scene that a document is, or that it is about, or None if it has none."""
    spec = loaded.spec
    if isinstance(spec, SceneSpec):
        return loaded
    reference = spec.scene if isinstance(spec, TaskSpec) else getattr(spec, "twin", None)
    used = loaded.used(reference) if isinstance(reference, str) else None
    return scene_document(used) if used is not None and used is not loaded else None


def hover_at(context: HoverContext, offset: int) -> HoverText | None:
    """Return what is shown for a place in a text that could be parsed, or None if there is nothing to say."""
    token = token_at(context.analysis, offset)
    kind = kind_of(context.analysis.source)[0] if context.analysis.source is not None else None
    if token is None or kind is None:
        return None
    for text, owner in _answers(context, token, kind):
        if text:
            return HoverText(text, token.start, token.end, owner)
    return None


def token_at(analysis: Analysis, offset: int) -> Token | None:
    """Return the word at a place of a text that could be parsed, or None if there is no key or value."""
    text, steps = analysis.lines.text, analysis.spans.path_to(offset)
    if not steps:
        return None
    path, span = tuple(key for key, _ in steps), steps[-1][1]
    if span.key >= 0 and span.key <= offset <= span.key_end:
        return Token(path, True, str(path[-1]), str(path[-1]), span.key, span.key_end, offset, span.key)
    if span.members or not span.start <= offset <= span.end:
        return None
    value = text[span.start : span.end]
    words = [*_NAME.finditer(value), *_NUMBER.finditer(value)]
    found = next((w for w in words if w.start() <= offset - span.start <= w.end()), None)
    start, end = found.span() if found is not None else (0, len(value))
    word = value[start:end]
    return Token(path, False, word, value, span.start + start, span.start + end, offset, span.start)


Answer = tuple[str | None, str]


def _answers(context: HoverContext, token: Token, kind: str) -> Iterator[Answer]:
    """Yield possible answers, the most specific one first, each with the name of an object to show."""
    yield from _named_by_key(context, token, kind) if token.is_key else _named_by_value(context, token, kind)
    meaning = key_text(kind, token.path)
    if meaning and not token.is_key and (converted := _converted(token)):
        meaning = f"{converted}\n\n{meaning}"
    yield meaning, ""


def key_text(kind: str, path: Path_) -> str | None:
    """Return the meaning of the last key of a path as Markdown, or None if it is not a key of the language.

    For an item in a list, this is the meaning of the list.
    """
    while path and isinstance(path[-1], int):
        path = path[:-1]
    found = key_meaning(kind, path)
    if found is None:
        return None
    default = f"default: {found.default}" if found.default else ""
    facts = [found.type if found.type != found.key else "", "required" if found.required else default]
    return f"**{found.key}** · {' · '.join(filter(None, facts))}\n\n{found.text}"


# -- keys --------------------------------------------------------------------------------------------------------------


def _named_by_key(context: HoverContext, token: Token, kind: str) -> Iterator[Answer]:
    path, name = token.path, token.word
    section = path[-2] if len(path) > 1 else ""
    if section == "allow" and _CODE.match(name):
        yield _code_text(name), ""
    elif "allow" in path[:1] and len(path) == 3:
        yield from _named(context, name, ("objects",))
    elif section == "parameters" and path[0] == "parameters":
        yield _parameter_text(context, name), ""
    elif section == "joints" and len(path) > 2 and path[-3] != "start":
        yield from _joint(context, str(path[-3]), name)
    elif isinstance(section, str) and key_meaning(kind, path) is None:  # a name that the author chose
        yield from _named(context, name, (_NAMED_BY_KEY.get(section, section),))


def _code_text(code: str) -> str | None:
    try:
        found = page(code)
    except (OSError, KeyError, ValueError, LookupError):
        return None
    lead = found.body.strip().split("\n\n")[0]
    return f"**{found.code}** · {found.title}\n\n{lead}"


# -- values ------------------------------------------------------------------------------------------------------------


def _named_by_value(context: HoverContext, token: Token, kind: str) -> Iterator[Answer]:
    field = next((key for key in reversed(token.path) if isinstance(key, str)), "")
    if "$" in token.value and field not in ("name", "description"):
        yield _expression_text(context, token), ""
    if call := next((c for c in _CALL.finditer(token.value) if c.start() <= token.at - token.from_ <= c.end()), None):
        yield from _in_call(context, token, call)
    if any(_fits(pattern, token.path) for pattern in file_patterns(model_of(kind))):
        yield _file_text(context, token.value.strip("'\"")), ""
    if field in REFERENCES:
        owner = str(token.path[1]) if len(token.path) > 2 and token.path[0] == "objects" else ""
        if field == "repeat" or token.word:
            yield from _named(context, token.word, REFERENCES[field], owner)


def _fits(pattern: tuple[str, ...], path: Path_) -> bool:
    return len(pattern) == len(path) and all(p in ("*", k) for p, k in zip(pattern, path, strict=True))


def _in_call(context: HoverContext, token: Token, call: re.Match[str]) -> Iterator[Answer]:
    """Yield the meaning of a predicate, with its value in the initial state, or of one of its arguments."""
    name, arguments = canonical(call[1], tuple(part.strip() for part in call[2].split(",")))
    if name not in PREDICATES:
        return
    predicate = PREDICATES.load(name)
    if token.at - token.from_ <= call.end(1):
        yield predicate_text(context, predicate, call[1], call[0]), ""
        return
    k = call[2][: token.start - token.from_ - call.start(2)].count(",")
    given = tuple(part.strip() for part in call[2].split(","))
    k = arguments.index(given[k]) if given != arguments and k < len(given) and given[k] in arguments else k
    kinds = predicate.parameters
    sections = {"joint": ("joints", "objects"), "robot": ("robots",), "body": ("objects", "robots")}
    yield from _named(context, token.word, sections.get(kinds[k], ("objects",)) if k < len(kinds) else ())


def predicate_text(context: HoverContext, predicate: Predicate, written: str, call: str) -> str:
    """Describe a predicate and, if its scene is known, its value at the start."""
    from simfoundry.predicates.judging.docs_table import signature

    lines = [f"**{signature(predicate)}** · predicate", predicate.meaning]
    lines.append(f"True if {predicate.definition}. Margin in {predicate.unit}.")
    if written != predicate.name:
        lines.append(f"`{written}` is another name of `{predicate.name}`.")
    if context.draft is not None and (told := value_at_start(context.draft, call)):
        lines.append(told)
    return "\n\n".join(lines)


def value_at_start(draft: DraftScene, call: str) -> str:
    """Return the value of a predicate at the start with its margin, or an empty string if it cannot be judged."""
    from simfoundry.lint.draft import StartJudge
    from simfoundry.spec.models.predicate import ExpressionError

    judge = StartJudge(draft)
    try:
        value = judge.value(call)
        if value is None:
            return "At the start: not certain, because the meshes have not been decomposed."
        why, margin = judge.explanation(call), judge.margin(call)
    except ExpressionError:
        return ""
    shown = f", margin {margin:+.4g}" if margin is not None else ""
    return f"At the start: **{str(value).lower()}**{shown}" + (f" ({why})" if why else "")


def _file_text(context: HoverContext, reference: str) -> str | None:
    from simfoundry.language_server.display.describe import file_text

    analysis = context.analysis
    path = existing_file(reference, analysis)
    if path is None:
        return None
    return file_text(reference, path, analysis.loaded.uses.get(str(path)))


def _parameter_text(context: HoverContext, name: str) -> str | None:
    value = context.analysis.loaded.parameters.get(name)
    return f"**${name}** = {number(value)} · parameter" if isinstance(value, int | float) else None


def _expression_text(context: HoverContext, token: Token) -> str | None:
    values: dict[str, Any] = context.analysis.loaded.parameters
    expression = token.value.strip("'\"")
    if not is_expression(expression):
        return None
    try:
        total = evaluate(expression, {k: v for k, v in values.items() if isinstance(v, int | float)})
    except ParameterError:
        return None
    used = dict.fromkeys(PARAMETER.findall(expression))
    parts = ", ".join(f"${name} = {number(values[name])}" for name in used if name in values)
    return f"**{escaped(expression)}** = {number(total)}" + (
        f"\n\n{parts}" if expression != f"${next(iter(used), '')}" else ""
    )


def _converted(token: Token) -> str:
    """Return a number in the other unit of angles, if its key shows that it is an angle."""
    field = next((key for key in reversed(token.path) if isinstance(key, str)), "")
    if not _NUMBER.fullmatch(token.word) or not (field.endswith("_deg") or field == "deg"):
        return ""
    return f"{token.word}° = {math.radians(float(token.word)):.4g} rad"


# -- names -------------------------------------------------------------------------------------------------------------


def _named(context: HoverContext, name: str, sections: tuple[str, ...], owner: str = "") -> Iterator[Answer]:
    """Yield what is known about a name, which is looked up in the given sections."""
    from simfoundry.language_server.display import describe

    draft, scene = context.draft, context.scene
    spec, base, part = context.analysis.loaded.spec, *name.partition(".")[::2]
    for section in sections:
        match section:
            case "objects" if draft is not None and scene is not None:
                found = base if base in draft.scene.by_name else _first_copy(scene, base)
                if found in draft.scene.by_name:
                    if part:
                        yield describe.link_text(scene, draft, found, part), found
                        yield from _joint(context, found, part)
                    yield describe.object_text(scene, draft, found) + _copies(scene, base, found), found
            case "joints" if part:
                yield from _joint(context, base, part)
            case "joints":
                yield from _joint(context, owner, name)
            case "links" if isinstance(spec, AssetSpec):
                yield _asset_link(context, name), ""
            case "materials":
                owner_spec = spec if isinstance(spec, AssetSpec) else scene.spec if scene is not None else spec
                material = getattr(owner_spec, "materials", {}).get(name)
                if material is not None:
                    yield describe.material_text(name, material, draft), ""
            case "cameras" if draft is not None:
                yield describe.camera_text(name, draft), ""
            case "frames" if draft is not None and name in draft.spec.frames:
                yield _frame(draft, name), ""
            case "robots" if scene is not None and isinstance(scene.spec, SceneSpec) and base in scene.spec.robots:
                robot = scene.spec.robots[base]
                model = robot.model if isinstance(robot.model, str) else "own files"
                yield f"**{base}** · robot · `{model}`", ""


def _first_copy(scene: Loaded, name: str) -> str:
    """Return the first copy of a repeated object."""
    group = scene.reuse.groups.get(name) if scene.reuse is not None else None
    return group.copies[0].name if group is not None and group.copies else name


def _copies(scene: Loaded, name: str, found: str) -> str:
    """Say of how many copies a description shows the first one."""
    if name == found or scene.reuse is None:
        return ""
    return f"\n\nThe first of {len(scene.reuse.groups[name].copies)} copies, `{found}`."


def _frame(draft: DraftScene, name: str) -> str | None:
    from simfoundry.language_server.display.describe import frame_text
    from simfoundry.scene.carriers import PlaceError
    from simfoundry.scene.frames import FrameTree

    try:
        return frame_text(name, FrameTree(draft.spec).pose(name, draft.scene.by_name))
    except PlaceError as error:
        return f"**{name}** · frame\n\n{error.message}"


def _joint(context: HoverContext, owner: str, name: str) -> Iterator[Answer]:
    """Yield the description of a joint of an object, or of the asset that the document describes."""
    from simfoundry.language_server.display.describe import joint_text

    spec, draft = context.analysis.loaded.spec, context.draft
    if isinstance(spec, AssetSpec):
        from simfoundry.scene.objects import lower_joints

        found = next((joint for joint in lower_joints(spec, {}) if joint.name == name), None)
        if found is not None:
            yield joint_text("", found), ""
    elif draft is not None and owner in draft.scene.by_name:
        found = next((joint for joint in draft.scene.by_name[owner].joints if joint.name == name), None)
        if found is not None:
            yield joint_text(owner, found), owner


def _asset_link(context: HoverContext, name: str) -> str | None:
    from simfoundry.language_server.display.describe import asset_link_text
    from simfoundry.lint.draft import pictured_asset
    from simfoundry.spec.diagnostics import SpecError

    try:
        scene = pictured_asset(context.analysis.loaded)
    except SpecError:
        return None
    return asset_link_text(context.analysis.loaded, scene.objects[0], name)
