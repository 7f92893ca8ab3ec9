"""Run the checks that go beyond types for each kind of document, and apply ``allow``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from simfoundry.spec.check.checker import Checker, Use
from simfoundry.spec.check.plausible import check_intrinsics, check_values
from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.files import PICTURE_SUFFIXES, Loaded
from simfoundry.spec.models.base import DocumentSpec
from simfoundry.spec.yaml.text import Document

if TYPE_CHECKING:
    from simfoundry.spec.models.capture import CaptureSpec
    from simfoundry.spec.models.policy import CameraView, PolicySpec


_MODULES = {**{kind: kind for kind in ("scene", "asset", "task", "dataset")}, "cousins": "task"}
_MODULES |= dict.fromkeys(("capture", "policy"), "documents")
"""The module that checks each document kind.

Each module is imported on first use, so that checking a scene loads only scene models.
"""


def check(loaded: Loaded, sound: DocumentSpec | None, whole: bool, use: Use) -> list[Diagnostic]:
    """Run the checks that go beyond types.

    ``sound`` is the typed spec of the document or, if ``whole`` is False, only its valid part. Documents that it uses
    are read with ``use`` and added to ``loaded.uses``.
    """
    if sound is None:
        return []
    c = Checker(loaded, whole, use)
    kind = str(getattr(sound, "simfoundry")).partition("/")[0]  # noqa: B009
    getattr(import_module(f"{__package__}.{_MODULES[kind]}"), f"check_{kind}")(c, sound)
    check_values(c)
    _conflicts(c, sound)
    return c.findings


def _conflicts(c: Checker, spec: DocumentSpec) -> None:
    for path, conflict in spec.conflicts.items():
        message = f"`{path}` is an open conflict: ours {_shown(conflict.ours)}, theirs {_shown(conflict.theirs)}"
        c.add("SF209", ("conflicts", path), message, f"enter the correct value at `{path}`, then remove this entry")


def _shown(value: object) -> str:
    import json

    text = json.dumps(value, ensure_ascii=False)
    return "nothing" if value is None else f"`{text[:60]}{'…' if len(text) > 60 else ''}`"


def check_capture(c: Checker, spec: CaptureSpec) -> None:
    """Check a capture."""
    for name, shot in spec.frames.items():
        path = ("frames", name)
        check_intrinsics(c, shot.camera, (*path, "camera"))
        c.file(shot.color, (*path, "color"), PICTURE_SUFFIXES)
        c.file(shot.depth.image if shot.depth is not None else None, (*path, "depth", "image"), PICTURE_SUFFIXES)
        c.file(shot.stereo.right if shot.stereo is not None else None, (*path, "stereo", "right"), PICTURE_SUFFIXES)
        c.file(shot.masks.image if shot.masks is not None else None, (*path, "masks", "image"), PICTURE_SUFFIXES)
    c.file(spec.truth, ("truth",), (".yaml",))


def check_policy(c: Checker, spec: PolicySpec) -> None:
    """Check a policy."""
    check_views(c, spec.cameras, "the policy")


def check_views(c: Checker, views: Mapping[str, CameraView], who: str) -> None:
    """Check that no image is rendered smaller than it is used by ``who``."""
    for key, view in views.items():
        if view.render is not None and (view.render[0] < view.size[0] and view.render[1] < view.size[1]):
            path = ("cameras", key, "render")
            message = f"`{key}` is rendered smaller than {who} expects, so it would be upscaled"
            c.add("SF104", path, message, f"make at least one side of `render` as long as in `size`: {list(view.size)}")


Allow = Mapping[str, str | dict[str, str]]


def sift(findings: Iterable[Diagnostic], allow: Allow) -> tuple[list[Diagnostic], list[Diagnostic]]:
    """Split findings into those that are reported and the warnings that ``allow`` silences."""
    kept, silenced = list[Diagnostic](), list[Diagnostic]()
    for d in findings:
        (silenced if d.severity is Severity.WARNING and _silences(allow.get(d.code), d) else kept).append(d)
    return kept, silenced


def unused(document: Document, allow: Allow, silenced: Iterable[Diagnostic]) -> Iterator[Diagnostic]:
    """Yield a warning for each unused entry in ``allow``. Call this function after all lints have run."""
    heard = list(silenced)
    for code, entry in allow.items():
        of_code = [d for d in heard if d.code == code]
        names = list(entry) if isinstance(entry, dict) else [""]
        for name in names:
            if any(not name or _is_about(d, name) for d in of_code):
                continue
            path = ("allow", code, name) if name else ("allow", code)
            message = f"{code} does not occur" + (f" for `{name}`" if name else "")
            yield document.finding("SF403", path, message, "remove the line", Severity.WARNING, of_key=True)


def _silences(entry: str | dict[str, str] | None, d: Diagnostic) -> bool:
    return isinstance(entry, str) or (entry is not None and any(_is_about(d, name) for name in entry))


def _is_about(d: Diagnostic, name: str) -> bool:
    return name == d.path or name in d.path.split(".") or name in d.about
