"""Findings of a reconstruction: what a person should look at before relying on the scene."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.pages import titles
from simfoundry.spec.diagnostics import nearest

# Group of the codes of these findings; see `simfoundry/spec/check/pages.py`.
GROUP = "SF6"

# An object that was seen and is not in the scene.
LEFT_OUT = "SF601"

# A statement of a person, in the capture or in an override, that was not followed.
NOT_FOLLOWED = "SF602"

# An object that settled elsewhere than it was seen.
MOVED = "SF603"

# An edit of the scene that a new reconstruction contradicts.
CONFLICTING_EDIT = "SF604"

# A frame whose depth or pose contradicts the others.
UNUSED_FRAME = "SF605"

# An object that is held in place, as none of its solids comes to rest.
HELD = "SF620"

# An object whose solid explains little of what was seen of it.
UNSURE = "SF621"

# A surface that could be the support as well as the one that was chosen.
SUPPORT_DOUBT = "SF622"

# A hole in the depth on the support, as glass leaves.
HOLE = "SF623"

# An object at the border of the image.
BORDER = "SF624"

# Something that stands on the support and belongs to no object.
UNEXPLAINED = "SF625"

# A color image that does not match the depth.
OFFSET = "SF626"

# A depth image with more noise than common cameras have.
NOISY = "SF627"

# A model that is configured and did not answer, so that the offline method was used.
MODEL_FAILED = "SF640"

# An object that a model sees where nothing was found.
NOT_FOUND = "SF641"

# Fewer tasks than requested.
FEW_TASKS = "SF642"

# A depth image in which edges are smeared or appear twice.
REPEATED = "SF629"

# A unit of depth, or intrinsics of a camera, that are probably wrong.
IMPLAUSIBLE = "SF628"

# An image that consists of parts which do not belong together, or that is rolled.
PARTS = "SF630"

# An object of parts that may be several objects, because something hides what is between them.
JOINED = "SF631"

# An object that may be several.
MERGED = "SF632"


@dataclass(frozen=True)
class CaptureFinding:
    """A doubt about a reconstructed scene.

    Attributes:
        code: Code of the kind of finding, with a page in ``simfoundry/spec/check/findings``.
        message: What is doubtful, as a sentence without its place.
        hint: What a person can do about it.
        objects: Names of the objects in the scene that it concerns.
        outline: Pixels (column, row) around the place in the image that it concerns; a single pixel marks a point.
    """

    code: str
    message: str
    hint: str = ""
    objects: tuple[str, ...] = ()
    outline: tuple[tuple[int, int], ...] = ()

    @property
    def place(self) -> str:
        """The objects or the pixels that the finding concerns, or an empty string for the entire scene."""
        if self.objects or not self.outline:
            return ", ".join(self.objects)
        columns, rows = zip(*self.outline, strict=True)
        start, end = f"{min(columns)}, {min(rows)}", f"{max(columns)}, {max(rows)}"
        return f"pixel [{start}]" if start == end else f"pixels [{start}] to [{end}]"

    def text(self) -> str:
        """Return the finding as it is printed: place, code, message and hint."""
        head = f"{self.place}: {self.code}" if self.place else self.code
        return f"{head} {self.message}" + (f"\n  hint: {self.hint}" if self.hint else "")

    def to_json(self, accepted: Collection[str] = ()) -> dict[str, Any]:
        """Return the finding as plain data for JSON, with a flag that tells if its code is in ``accepted``."""
        return {
            "code": self.code,
            "message": self.message,
            "hint": self.hint,
            "objects": list(self.objects),
            "outline": [list(pixel) for pixel in self.outline],
            "place": self.place,
            "accepted": self.code in accepted,
        }


def ordered_findings(findings: Iterable[CaptureFinding]) -> tuple[CaptureFinding, ...]:
    """Return the findings sorted by code and place, without duplicates."""
    return tuple(sorted(set(findings), key=lambda f: (f.code, f.objects, f.outline, f.message, f.hint)))


def accepted_codes(codes: Iterable[str]) -> tuple[str, ...]:
    """Return the codes of findings that a person accepts, in upper case.

    Raises:
        SimfoundryError: A code does not exist or does not belong to a reconstruction. Errors cannot be accepted.
    """
    known = [code for code in titles() if code.startswith(GROUP)]
    out = []
    for code in codes:
        if code.upper() not in known:
            raise SimfoundryError(f"`{code}` is not a finding of a reconstruction; {nearest(code.upper(), known)}")
        out.append(code.upper())
    return tuple(sorted(set(out)))
