"""Checks shared by all document kinds, including a check for plausible densities."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.spec.check.validate import MAX_FINDINGS
from simfoundry.spec.diagnostics import Diagnostic, Severity, nearest, similar_fixes
from simfoundry.spec.files import TEXTURE_SUFFIXES, FileError, Loaded, reachable
from simfoundry.spec.models.base import WORLD, BodySpec, Material, quantity_value
from simfoundry.spec.models.shapes import (
    WALLS,
    BoxShape,
    CapsuleShape,
    CompoundShape,
    ConeShape,
    CylinderShape,
    EllipsoidShape,
    LatheShape,
    OpenBoxShape,
    PrismShape,
    Shape,
    SphereShape,
)
from simfoundry.spec.yaml.text import Document, Mark

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import PartSpec
    from simfoundry.spec.models.shapes import CompoundPart

Path_ = tuple[str | int, ...]
# Function that reads and checks a document of one of the given kinds; it returns None for other kinds.
Use = Callable[[Path, tuple[str, ...]], Loaded | None]


class Checker:
    """A collector of all findings in a document except type errors.

    If ``whole`` is False, the spec contains only the valid members. The names of invalid members still count as
    defined.
    """

    def __init__(self, loaded: Loaded, whole: bool, use: Use) -> None:
        assert loaded.document is not None
        self.document: Document = loaded.document
        self.loaded, self.whole, self._use = loaded, whole, use
        self.findings: list[Diagnostic] = []
        self._counts: Counter[Severity] = Counter()
        self._faults: dict[tuple[str, tuple[str, ...]], FileError | None] = {}  # by reference and suffixes

    def warn(self, code: str, path: Path_, message: str, hint: str = "", mark: Mark | None = None) -> None:
        """Add a warning."""
        self.add(code, path, message, hint, Severity.WARNING, mark)

    def add(
        self,
        code: str,
        path: Path_,
        message: str,
        hint: str = "",
        severity: Severity = Severity.ERROR,
        mark: Mark | None = None,
        of_key: bool = False,
    ) -> None:
        """Add an error, or a finding of another severity."""
        self._counts[severity] += 1
        if self._counts[severity] <= MAX_FINDINGS:  # counted per severity, so that warnings do not hide errors
            self.findings.append(self.document.finding(code, path, message, hint, severity, of_key, mark))

    def names(self, section: str) -> dict[str, Any]:
        """Return the names defined in a section of the text, including the names of invalid members."""
        return self.document.section(section)

    def name(self, name: str, choices: Collection[str], path: Path_, what: str, index: int = 0) -> bool:
        """Check that ``name`` is one of the choices.

        The name is the last key of ``path``, or it stands at ``index`` in the string there.
        """
        if name in choices:
            return True
        if self._counts[Severity.ERROR] < MAX_FINDINGS:
            hint, fixes = nearest(name, choices) or "none are defined", similar_fixes(name, choices)
            of_key = path[-1:] == (name,)
            group = self.loaded.reuse.groups.get(name) if self.loaded.reuse is not None else None
            if group is not None and group.copies:
                message, hint = f"`{name}` is repeated", f"name one of its copies, such as `{group.copies[0].name}`"
                self.add("SF201", path, message, hint, mark=Mark(name, index), of_key=of_key)
                return False
            if what == "material" and not fixes:
                hint += "; define new materials under `materials`"
            self.add("SF201", path, f"no {what} is called `{name}`", hint, mark=Mark(name, index, fixes), of_key=of_key)
        return False

    def reserved(self, path: Path_, what: str) -> None:
        """Report the use of the name that output formats reserve for the static world."""
        message = f"a {what} cannot be called `{WORLD}`: MuJoCo and URDF readers use this name for the static world"
        self.add("SF213", path, message.replace("a object", "an object"), f"rename it, for example to `{WORLD}_{what}`")

    def file(self, reference: str | None, path: Path_, suffixes: tuple[str, ...]) -> bool:
        """Check that ``reference``, if given, is a file in the project or in a package and has one of the suffixes."""
        if reference is None:
            return True
        key = (reference, suffixes)
        if key not in self._faults:
            self._faults[key] = self._file_fault(reference, suffixes)
        if (wrong := self._faults[key]) is not None:
            self.add(wrong.code, path, str(wrong), wrong.hint, mark=wrong.mark)
        return wrong is None

    def _file_fault(self, reference: str, suffixes: tuple[str, ...]) -> FileError | None:
        try:
            reachable(reference, self.loaded.path, self.loaded.root, suffixes)
        except FileError as wrong:
            return wrong
        return None

    def use(self, reference: str, path: Path_, kinds: tuple[str, ...], suffixes: tuple[str, ...]) -> Loaded | None:
        """Return the document at ``reference``.

        If the kind of the document is not in ``kinds``, report a finding and return None.
        """
        if not self.file(reference, path, suffixes):
            return None
        target = str(self.loaded.file(reference))
        if target not in self.loaded.uses:
            used = self._use(self.loaded.shown(reference), kinds)
            if used is None:  # a document of another kind, possibly this document itself
                hint = f"it must start with {' or '.join(f'`simfoundry: {kind}`' for kind in kinds)}"
                self.add("SF006", path, f"`{reference}` is a different kind of document", hint)
                return None
            self.loaded.uses[target] = used
        return self.loaded.uses[target]

    def material(self, body: BodySpec | PartSpec | CompoundPart, path: Path_) -> None:
        """Check that the material of a body or part is defined."""
        if body.material is not None:
            self.name(body.material, self.names("materials"), (*path, "material"), "material")

    def mass(self, body: BodySpec, made_of: list[str | None], materials: Mapping[str, Material], path: Path_) -> None:
        """Check that a body has a mass or a density, or that the materials of all its parts have a density."""
        given = body.model_fields_set
        if given & {"mass", "density"} or ("material" in given and body.material is None):
            return  # a missing value is reported separately
        if any(name is None or (name in materials and materials[name].density is None) for name in made_of):
            hint = "give `mass`, `density`, or a `material` with a density"
            self.add("SF108", path, f"`{path[-1]}` has no mass", hint)

    def materials(self, materials: Mapping[str, Material]) -> None:
        """Check that the densities and frictions of materials are plausible, and that their textures exist."""
        from simfoundry.spec.check.plausible import check_friction

        for name, material in materials.items():
            check_friction(self, material, ("materials", name))
            self.file(material.texture, ("materials", name, "texture"), TEXTURE_SUFFIXES)
            if material.density is not None:
                self.plausible(name, material.density, ("materials", name, "density"))

    def density(self, body: BodySpec, path: Path_, solid: float | None) -> None:
        """Check that a body's density is plausible.

        By default, the density is the body's mass divided by its ``solid`` volume [m^3].
        """
        given, mass = quantity_value(body.density), quantity_value(body.mass)
        if given is not None:
            self.plausible(str(path[-1]), given, (*path, "density"))
        elif mass is not None and solid:
            self.plausible(str(path[-1]), mass / solid, (*path, "mass"))

    def plausible(self, name: str, density: float, path: Path_) -> None:
        """Check that a density [kg/m^3] is realistic."""
        hint = implausible(density)
        if hint:
            self.warn("SF402", path, f"`{name}` has a density of {density:.4g} kg/m^3", hint)

    def unused(self, materials: Mapping[str, Material], used: Collection[str | None]) -> None:
        """Warn about each unused material."""
        for name in materials if self.whole else ():
            if name not in used:
                path, message = ("materials", name), f"the `{name}` material is not used"
                self.add("SF401", path, message, "remove it", Severity.WARNING, of_key=True)


def piece_clash(parts: Mapping[str, Shape | None]) -> tuple[str, str] | None:
    """Return two parts of a body whose pieces have the same name, or None if there are none.

    The walls of an open box `a` are called `a_floor` and so on, and the convex parts of a lathe or prism `a` are called
    `a_0`, `a_1` and so on.
    """
    for name, shape in parts.items():
        if not isinstance(shape, OpenBoxShape | LatheShape | PrismShape):
            continue
        pattern = "|".join(WALLS) if isinstance(shape, OpenBoxShape) else "[0-9]+"
        for other in parts:
            if re.fullmatch(f"{name}_({pattern})", other):
                return name, other
    return None


# Range of plausible densities [kg/m^3], from foam to osmium; the volume of a hollow object includes its cavity.
LIGHTEST, HEAVIEST = 5.0, 23_000.0


def implausible(density: float) -> str:
    """Return a hint if a density [kg/m^3] is implausible, or an empty string if it is plausible."""
    if LIGHTEST <= density <= HEAVIEST:
        return ""
    return f"densities range from {LIGHTEST:g} to {HEAVIEST:g} kg/m^3; are all masses in kg and all lengths in m?"


def volume(shape: Shape) -> float:
    """Return the volume [m^3] of a primitive, or infinity if the computation overflows."""
    try:
        value = _volume(shape)
    except OverflowError:
        return math.inf
    return value if math.isfinite(value) else math.inf


def _volume(shape: Shape) -> float:
    match shape:
        case BoxShape():
            return math.prod(shape.box)
        case SphereShape():
            return 4 / 3 * math.pi * shape.sphere**3
        case CylinderShape():
            return math.pi * shape.cylinder.radius**2 * shape.cylinder.height
        case CapsuleShape():
            r, h = shape.capsule.radius, shape.capsule.height
            return math.pi * r**2 * (h + 4 / 3 * r)
        case EllipsoidShape():
            return 4 / 3 * math.pi * math.prod(shape.ellipsoid)
        case ConeShape():
            return math.pi / 3 * shape.cone.radius**2 * shape.cone.height
        case OpenBoxShape(open_box=b):
            x, y, z = b.size
            return x * y * z - (x - 2 * b.wall) * (y - 2 * b.wall) * (z - b.wall)
        case CompoundShape():
            return sum(_volume(part.shape) for part in shape.compound.values())
        case LatheShape():
            rings = shape.lathe.profile
            thirds = ((a[0] ** 2 + a[0] * b[0] + b[0] ** 2) * (a[1] - b[1]) for a, b in pairwise(rings))
            return abs(math.pi / 3 * sum(thirds))  # frusta; inner ones are subtracted from outer ones
    corners = shape.prism.outline
    doubled = sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(corners, (*corners[1:], corners[0]), strict=True))
    return abs(doubled) / 2 * shape.prism.height
