"""Generate variants of an object from numbered candidates, which may come from different sources.

Candidate k depends only on the twin, the axis, the seed and k. The candidates are examined in order. The first
``count`` candidates that pass all checks and differ from all previous variants become variants, so identical calls
produce identical variants.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from simfoundry.assets import mass
from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import merged, read_parts, weld
from simfoundry.assets.mesh_summary import axes_of
from simfoundry.cousins.objects.appearance import priors
from simfoundry.cousins.objects.checks import Needs, ObjectBaseline, faults
from simfoundry.cousins.objects.components import parts_of
from simfoundry.cousins.objects.geometry import is_ball
from simfoundry.cousins.objects.item import ObjectAsset, lay, lowered
from simfoundry.cousins.objects.procedural import Draft, draft, rng_of
from simfoundry.cousins.objects.retrieval import Likeness, likeness
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.model import SceneObject
from simfoundry.scene.robot_files import companions
from simfoundry.spec.check.checker import volume
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.asset import AssetSpec, LinkSpec
from simfoundry.spec.models.base import Estimate, Material, quantity_value
from simfoundry.spec.models.cousins import ObjectVariants
from simfoundry.spec.models.origin import Origin
from simfoundry.spec.yaml.write import to_data, to_yaml

# Maximum number of candidates for each requested variant.
MOST_TRIES = 25

# Maximum number of characters in a document's note.
NOTE = 200

# Callback that receives the numbers of accepted variants and examined candidates.
Progress = Callable[[int, int], None]


class Origins(Protocol):
    """A source of candidates."""

    def __call__(self, item: ObjectAsset, axis: ObjectVariants, seed: int, k: int) -> Draft | Reason:
        """Return candidate ``k``, or the reason why it could not be generated.

        The result is deterministic.
        """


@dataclass(frozen=True, eq=False)
class Variant:
    """An accepted candidate.

    Attributes:
        name: Unique name, derived from the object's name and a hash of the content.
        k: Candidate number.
        source: Name of the source.
        spec: Complete asset document.
        files: Contents of the files that the document refers to, keyed by name.
        changed: Human-readable list of changes.
        item: The lowered object.
        likeness: Descriptor of the object.
        distance: Distance to the most similar object, which is either the twin or another variant, in units of the
            thresholds for distinct objects.
    """

    name: str
    k: int
    source: str
    spec: AssetSpec
    files: Mapping[str, bytes]
    changed: tuple[str, ...]
    item: SceneObject
    likeness: Likeness
    distance: float

    @property
    def file(self) -> str:
        """File name of the variant's document."""
        return f"{self.name}.asset.yaml"

    def to_json(self) -> dict[str, Any]:
        """Return the variant as plain data for manifests."""
        data = {"asset": self.file, "candidate": self.k, "source": self.source, "changed": list(self.changed)}
        return data | {"distance": round(self.distance, 3)}


@dataclass(frozen=True, eq=False)
class Refused:
    """A rejected candidate with the reason for its rejection."""

    k: int
    source: str
    changed: tuple[str, ...]
    reason: Reason

    def to_json(self) -> dict[str, Any]:
        """Return the rejected candidate as plain data for manifests."""
        data = {"candidate": self.k, "source": self.source, "changed": list(self.changed)}
        return data | {"reasons": [self.reason.to_json()]}


@dataclass(frozen=True, eq=False)
class Variants:
    """Accepted and rejected variants of an object.

    ``lacks`` describes the requirements that the twin itself does not meet and that were therefore not checked.
    """

    accepted: tuple[Variant, ...]
    refused: tuple[Refused, ...]
    lacks: tuple[str, ...] = field(default=())

    @property
    def reasons(self) -> dict[str, int]:
        """The number of rejections for each reason, in order of decreasing frequency."""
        counts = Counter(one.reason.code for one in self.refused)
        return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))

    def to_json(self) -> dict[str, Any]:
        """Return the variants as plain data for manifests."""
        accepted, refused = ([one.to_json() for one in some] for some in (self.accepted, self.refused))
        return {"accepted": accepted, "refused": refused, "reasons": self.reasons, "lacks": list(self.lacks)}


def procedural(item: ObjectAsset, axis: ObjectVariants, seed: int, k: int) -> Draft | Reason:
    """Generate a candidate by applying rules."""
    try:
        made = draft(item, axis.changes, axis.components, rng_of(seed, item.name, k))
    except MeshError as error:
        return Reason("mesh", str(error))
    if not made.changed:
        return Reason("rules", f"no rule that changes {' and '.join(axis.changes)} applies to its parts")
    return made


def variants(
    item: ObjectAsset,
    axis: ObjectVariants,
    needs: Needs | None = None,
    seed: int = 0,
    sources: Mapping[str, Origins] | None = None,
    cache: Cache | None = None,
    progress: Progress | None = None,
) -> Variants:
    """Return the first ``axis.count`` distinct variants of an object that pass all checks.

    Fewer variants are returned if the search fails after :data:`MOST_TRIES` candidates per requested variant.

    Args:
        item: The twin's object.
        axis: Number, sources and kinds of variants.
        needs: Requirements that the variants must meet.
        seed: Seed for the random number generator.
        sources: Sources by name, in addition to rules, which are always available.
        cache: Cache for lowering.
        progress: Callback that is called after each examined candidate.

    Raises:
        SpecError: The twin itself is invalid.
        KeyError: A source that the axis uses is missing.
    """
    known: dict[str, Origins] = {"procedural": procedural, **(sources or {})}
    chosen = [(name, known[name]) for name in axis.sources]
    needs = needs or Needs()
    accepted: list[Variant] = []
    refused: list[Refused] = []
    with TemporaryDirectory(prefix="simfoundry-variants-") as scratch:
        folder = Path(scratch)
        lay(item.files, folder)
        base = lowered(_checked(item.spec, item), folder, item.name, cache)
        twin, first = ObjectBaseline.of(base, needs), likeness(base)
        # Rule-based variants must differ in shape or size. Library entries and balls may also differ only in color,
        # because library entries cannot be changed and balls have only one shape.
        form = "geometry" in axis.changes and not axis.components and not is_ball(item.spec)
        for k in range(MOST_TRIES * axis.count):
            if len(accepted) == axis.count:
                break
            name, origin = chosen[k % len(chosen)]
            made = origin(item, axis, seed, k)
            if isinstance(made, Reason):
                refused.append(Refused(k, name, (), made))
                continue
            others = [first, *(v.likeness for v in accepted)]
            try:
                found = _variant(item, made, k, name, seed, folder, cache)
                result = _distinct(found, others, form and name == "procedural")
            except SpecError as error:
                result = Reason("document", f"{error.diagnostics[0].code} {error.diagnostics[0].message}")
            except MeshError as error:
                result = Reason("mesh", str(error))
            if isinstance(result, Variant):  # the most expensive checks come last
                result = next(faults(result.item, twin, item.category), result)
            if isinstance(result, Variant):
                accepted.append(result)
            else:
                refused.append(Refused(k, name, made.changed, result))
            if progress is not None:
                progress(len(accepted), k + 1)
    return Variants(tuple(accepted), tuple(refused), twin.lacks)


def write(variant: Variant, folder: Path) -> Path:
    """Write a variant's document and its meshes to a folder.

    File names depend on the content, so an existing file with the same name has the same content.

    Returns:
        The path of the document.
    """
    for name, data in variant.files.items():
        write_atomically(folder / name, data)
    path = folder / variant.file
    write_atomically(path, to_yaml(variant.spec).encode())
    return path


def _variant(
    item: ObjectAsset, made: Draft, k: int, source: str, seed: int, folder: Path, cache: Cache | None
) -> Variant:
    """Complete a draft by adding masses and a name, and lower it.

    Raises:
        SpecError: The resulting document is invalid.
        MeshError: A mesh is invalid.
    """
    for name, data in made.files.items():
        write_atomically(folder / name, data)
    lay(made.kept, folder)
    used = {name: folder / name for name in (*made.files, *made.kept)}
    volumes, before = _volumes(made.spec, used), _volumes(item.spec, item.files)
    spec = _named(weighed(made.spec, item.spec, volumes, before), item, made, k, source, seed)
    thing = lowered(spec, folder, item.name, cache)
    files = dict(made.files)
    named = {part.mesh for part in parts_of(spec).values()} | {m.texture for m in spec.materials.values()}
    for name in made.kept.keys() & named:
        path = made.kept[name]
        files |= {name: path.read_bytes()}
        files |= {Path(name).with_name(o.name).as_posix(): o.read_bytes() for o in companions(path)}
    return Variant(spec.name, k, source, spec, files, made.changed, thing, likeness(thing), 0.0)


def _distinct(variant: Variant, others: list[Likeness], form: bool) -> Variant | Reason:
    """Return the variant along with its distance to the most similar other object.

    If the variant is too similar to another object, the reason is returned instead. If ``form`` is true, objects that
    differ only in color are considered too similar.
    """
    away = attrgetter("form" if form else "distance")
    nearest = min((variant.likeness.apart(other) for other in others), key=away)
    if away(nearest) >= 1:
        return replace(variant, distance=nearest.distance)
    numbers = {"size": nearest.size, "shape": nearest.shape, "color": nearest.color}
    return Reason("alike", f"it is too similar to another variant or the twin: {nearest}", numbers)


def _named(spec: AssetSpec, item: ObjectAsset, made: Draft, k: int, source: str, seed: int) -> AssetSpec:
    """Return the document with a name derived from its content and with a note about its origin."""
    plain = _checked(spec, item).model_copy(update={"name": "variant", "description": None, "origin": None})
    content = json.dumps(to_data(plain), ensure_ascii=False, sort_keys=True)
    name = f"{item.name[:50]}_{hashlib.sha256(content.encode()).hexdigest()[:8]}"
    head = f"{source} variant {k} of {item.source}, seed {seed}: "
    words = "; ".join(made.changed)
    note = head + (words if len(head + words) <= NOTE else f"{words[: NOTE - len(head) - 1]}…")
    return plain.model_copy(update={"name": name, "origin": Origin(note=note[:NOTE], models=made.models)})


def _checked(spec: AssetSpec, item: ObjectAsset) -> AssetSpec:
    """Return the document with the item's category added and unused materials removed."""
    used = {p.material for p in parts_of(spec).values()} | {link.material for link in spec.links.values()}
    materials = {name: material for name, material in spec.materials.items() if name in used}
    return spec.model_copy(update={"category": item.category, "materials": materials})


def _volumes(spec: AssetSpec, files: Mapping[str, Path]) -> dict[str, float]:
    """Return the volume enclosed by each mesh file of an asset, keyed by file name.

    Each volume is in the cube of the file's length unit.
    """
    names = {p.mesh for p in parts_of(spec).values() if p.mesh is not None}
    return {name: abs(mass.mesh(*weld(*merged(read_parts(files[name])))).volume) for name in names}


# Relative uncertainty of the density of a material that is not in the tables.
DOUBT = 0.15

# Sources of estimated masses, written to the documents.
BY = "volume and density"
GIVEN = "the twin's mass, by volume"


def weighed(spec: AssetSpec, twin: AssetSpec, volumes: Mapping[str, float], before: Mapping[str, float]) -> AssetSpec:
    """Return the asset with an estimated mass for each link.

    If the twin specifies a link's mass, that mass is scaled in proportion to the link's volume. The twin's measured
    inertias no longer apply and are removed.

    Args:
        spec: The variant's asset.
        twin: The twin's asset.
        volumes: Volumes of the variant's mesh files, keyed by name, in the cube of each file's unit.
        before: Volumes of the twin's mesh files, keyed by name, in the same units.
    """
    links = {}
    for name, link in spec.links.items():
        own = twin.links.get(name)
        given = quantity_value(own.mass) if own is not None else None
        if link.density is not None:  # the density specified for the link still applies
            links[name] = link.model_copy(update={"inertial": None})
            continue
        if own is not None and given is not None:
            value, source = given * (_mass(link, spec, volumes, 0) / _mass(own, twin, before, 0)), GIVEN
            low, high = value * (1 - DOUBT), value * (1 + DOUBT)
        else:
            (value, low, high), source = (_mass(link, spec, volumes, side) for side in (0, -1, 1)), BY
        estimate = Estimate(value=_short(value), range=(_short(low), _short(high)), source=source)
        links[name] = link.model_copy(update={"mass": estimate, "inertial": None})
    return spec.model_copy(update={"links": links})


def _mass(link: LinkSpec, spec: AssetSpec, volumes: Mapping[str, float], side: int) -> float:
    """Return the mass of a link [kg].

    ``side`` selects the lowest (-1), nominal (0) or highest (1) density of the link's materials.
    """
    total = 0.0
    for part in link.parts.values():
        if part.use != "visual":
            own = (
                volume(part.shape)
                if part.shape is not None
                else volumes[part.mesh or ""] * math.prod(axes_of(part.scale))
            )
            total += own * _density(part.material or link.material, spec.materials, side)
    return total


def _density(name: str | None, materials: Mapping[str, Material], side: int) -> float:
    density = (materials[name].density if name is not None else None) or 1000.0
    if name is not None and name in priors().materials and side:
        low, high = priors().materials[name].density
        return min(low, density) if side < 0 else max(high, density)
    return density * (1 + side * DOUBT)


def _short(value: float) -> float:
    """Round a number to three significant digits."""
    return float(f"{max(value, 1e-6):.3g}")
