"""Variants that replace their twins: generated once per recipe, stored in a folder, and chosen for each cousin."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.assets.cache import Cache, key_of
from simfoundry.cousins.objects.checks import Needs, needs_of
from simfoundry.cousins.objects.generation import SourceSetup, opened
from simfoundry.cousins.objects.item import ObjectAsset, item_of
from simfoundry.cousins.objects.retrieval import contents
from simfoundry.cousins.objects.variants import Origins, Progress, Variants, variants, write
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.lower import lower
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.cousins import ObjectAxis, ObjectVariants
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.write import to_yaml

VERSION = "variants/3"
"""Format version; incremented when the same twin, axis and seed would give other variants."""


def prepare(
    axis: ObjectAxis,
    scene: Loaded,
    tasks: Sequence[TaskSpec],
    seed: int,
    folder: Path,
    sources: Callable[[], Mapping[str, Origins]] | None = None,
    cache: Cache | None = None,
    progress: Progress | None = None,
    library: Path | None = None,
) -> dict[str, dict[str, Any]]:
    """Generate and write the variants of every object of an axis; variants already in the folder are reused.

    ``sources`` opens the sources other than rules, and is called only if something must be generated; ``library`` is
    the folder that one of them reads.

    Return the record of each object, which is also written beside the documents as ``NAME.variants.json``: the names of
    the ``accepted``, the ``refused`` with reasons, and what the twin itself ``lacks``.
    """
    assert isinstance(scene.spec, SceneSpec)
    lowered, records = None, {}
    origins: Mapping[str, Origins] | None = None
    for name, wanted in axis.objects.items():
        item = item_of(scene, name)
        lowered = lowered or lower(scene, cache)
        needs = needs_of(name, scene.spec, lowered, tasks)
        key = _key(item, wanted, needs, seed, axis, library)
        path = folder / f"{name}.variants.json"
        record = _read(path, key, folder)
        if record is None:
            origins = origins if origins is not None else sources() if sources is not None else {}
            made = variants(item, wanted, needs, seed, origins, cache, progress)
            for variant in made.accepted:
                write(variant, folder)
            record = {"key": key, **record_of(made)}
            write_atomically(path, (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode())
        records[name] = record
    return records


def made_for(
    axis: ObjectAxis, scene: Loaded, tasks: Sequence[TaskSpec], seed: int, folder: Path, given: SourceSetup
) -> dict[str, tuple[Path, ...]]:
    """Return the documents of each object's variants, generated if they do not exist yet.

    Raises :class:`ImpossibleError` for an object without variants (with the results of its candidates) and for a source
    that is not set up, and :class:`~simfoundry.errors.SimfoundryError` for models that do not answer.
    """
    cache = Cache.default()
    records = prepare(
        axis, scene, tasks, seed, folder, lambda: opened(axis, given, cache), cache, library=given.library
    )
    for name, record in records.items():
        if not record["accepted"]:
            tried = len(record["refused"])
            why = "; ".join(f"{count} times {code}" for code, count in record["reasons"].items())
            example = record["refused"][0]["reasons"][0]["text"] if tried else "there was no candidate"
            text = f"`{name}` has no variant among {tried} candidates: {why}; the first: {example}"
            raise ImpossibleError((Reason("variants", text, {"candidates": float(tried)}),))
    return {name: tuple(folder / one["asset"] for one in record["accepted"]) for name, record in records.items()}


@dataclass(frozen=True)
class VariantCount:
    """Number of variants of an object that were requested (``asked``) and ``made``, and of ``candidates`` examined.

    ``reasons`` counts each reason for rejection, ``examples`` has the text of the first of each.
    """

    name: str
    asked: int
    made: int
    candidates: int
    reasons: Mapping[str, int]
    examples: Mapping[str, str]

    @property
    def is_short(self) -> bool:
        """Return whether fewer variants were made than requested."""
        return self.made < self.asked

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping for manifests."""
        return {"asked": self.asked, "made": self.made, "candidates": self.candidates, "reasons": dict(self.reasons)}

    def __str__(self) -> str:
        text = f"variants of `{self.name}`: {self.made} of {self.asked} made from {self.candidates} candidates"
        if not self.reasons:
            return text
        rest = "; ".join(f"{count} refused: {code}" for code, count in self.reasons.items())
        code = next(iter(self.reasons))
        return f"{text}; {rest} (such as: {self.examples[code]})" if self.is_short else f"{text}; {rest}"


def counts(axis: ObjectAxis | None, folder: Path) -> tuple[VariantCount, ...]:
    """Return the counts of each object of an axis, from the records in the folder of its variants."""
    found = []
    for name, wanted in axis.objects.items() if axis is not None else ():
        record = json.loads((folder / f"{name}.variants.json").read_bytes())
        examples: dict[str, str] = {}
        for reason in (reason for one in record["refused"] for reason in one["reasons"]):
            examples.setdefault(reason["code"], reason["text"])
        made, refused = len(record["accepted"]), len(record["refused"])
        found.append(VariantCount(name, wanted.count, made, made + refused, record["reasons"], examples))
    return tuple(found)


def record_of(made: Variants) -> dict[str, Any]:
    """Return the manifest entry for the variants of one object."""
    accepted = [
        {
            "asset": v.file,
            "candidate": v.k,
            "source": v.source,
            "changed": list(v.changed),
            "distance": round(v.distance, 3),
        }
        for v in made.accepted
    ]
    refused = [r.to_json() for r in made.refused]
    return {"accepted": accepted, "refused": refused, "reasons": made.reasons, "lacks": list(made.lacks)}


def _key(
    item: ObjectAsset, wanted: ObjectVariants, needs: Needs, seed: int, axis: ObjectAxis, library: Path | None
) -> str:
    """Return the cache key of an object's variants.

    Models enter by their names in the recipe, because their answers differ from call to call.
    """
    meshes = [path.read_bytes() for _, path in sorted(item.files.items())]
    calls = json.dumps([[str(c) for c in needs.rests], list(needs.joints), needs.opening])
    of = [axis.models.model_dump_json()] if "model" in wanted.sources else []
    of += [json.dumps(contents(library))] if "library" in wanted.sources and library is not None else []
    said = (item.name, item.category, to_yaml(item.spec), wanted.model_dump_json(), calls, str(seed), *of)
    return key_of(VERSION, *said, *meshes)


def _read(path: Path, key: str, folder: Path) -> dict[str, Any] | None:
    """Read the record of variants generated earlier with the same key, if all of their files still exist."""
    try:
        record = json.loads(path.read_bytes())
        whole = record["key"] == key and all((folder / one["asset"]).is_file() for one in record["accepted"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return record if whole else None
