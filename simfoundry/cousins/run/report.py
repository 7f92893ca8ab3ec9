"""``manifest.json``: the request of a run, every cousin, and every rejected candidate with its reasons and numbers.

It is streamed line by line, so it may exceed the memory, and contains no times, paths or numbers of processes: equal
runs give equal bytes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.run.log import Reader
from simfoundry.cousins.run.run import MANIFEST, Ledger, RunPlan
from simfoundry.errors import OutputError
from simfoundry.runtime.files import writing_atomically

if TYPE_CHECKING:
    from simfoundry.scene.model import Camera, Scene
    from simfoundry.spec.models.scene import SceneSpec

VERSION = "cousins-run/1"
FILE = MANIFEST


def summary(plan: RunPlan, ledger: Ledger) -> dict[str, Any]:
    """Statistics of a run and of its variants; ``end`` is complete, hopeless or exhausted."""
    return {
        "simfoundry": VERSION,
        **plan.about,
        "end": str(ledger.end),
        "asked": plan.wanted,
        "examined": ledger.examined,
        "accepted": len(ledger.accepted),
        "acceptance_rate": round(ledger.rate, 4),
        "reasons": dict(sorted(ledger.totals.items(), key=lambda pair: (-pair[1], pair[0]))),
        "unchecked": list(ledger.unchecked),
        "variants": {count.name: count.to_json() for count in plan.variants},
    }


def write_manifest(plan: RunPlan, ledger: Ledger) -> Path:
    """Write the manifest beside the cousins."""
    path = plan.out / FILE
    with Reader() as reader, writing_atomically(path) as stream:
        head = json.dumps(summary(plan, ledger), indent=1, ensure_ascii=False)
        stream.write(head.removesuffix("\n}").encode())
        for key, accepted in (("cousins", True), ("rejected", False)):
            entries = (_entry(reader.candidate(p)) for p in ledger.counted() if p.accepted is accepted)
            _write_list(stream, key, entries)
        stream.write(b"\n}\n")
    return path


def _write_list(stream: IO[bytes], key: str, entries: Iterator[dict[str, Any]]) -> None:
    stream.write(f',\n "{key}": ['.encode())
    for k, entry in enumerate(entries):
        text = json.dumps(entry, ensure_ascii=False)
        stream.write(f"{',' if k else ''}\n  {text}".encode())
    stream.write(b"\n ]")


def _entry(candidate: Candidate) -> dict[str, Any]:
    if not candidate.accepted:
        return {"index": candidate.index, "reasons": [reason.to_json() for reason in candidate.reasons]}
    entry: dict[str, Any] = {"index": candidate.index, "files": candidate.files(), "asked": list(candidate.asked)}
    return entry | ({"goal": candidate.goal} if candidate.goal else {})


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a folder of cousins; raises :class:`OutputError` if there is none."""
    path = folder / FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["simfoundry"] == VERSION:
            return dict(data)
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise OutputError(f"{path} is not a manifest of cousins")


def told(ledger: Ledger, top: int = 3) -> str:
    """Summarize the progress of a run: ``412 of 1000, 69 % accepted; no_room 120, out_of_reach 43``."""
    text = f"{len(ledger.accepted)} of {ledger.wanted}"
    if ledger.examined:
        text += f", {ledger.rate:.0%} accepted"
    if ledger.totals:
        text += "; " + ", ".join(f"{code} {count}" for code, count in ledger.totals.most_common(top))
    return text


def examples(ledger: Ledger) -> dict[str, str]:
    """Return an example of each reason, most frequent first: the sentence for the first candidate that it rejected."""
    found: dict[str, str] = {}
    with Reader() as reader:
        for place in ledger.counted():
            if place.accepted or len(found) == len(ledger.totals):
                continue
            for reason in reader.candidate(place).reasons:
                found.setdefault(reason.code, reason.text)
    return {code: found[code] for code, _ in ledger.totals.most_common() if code in found}


WIDTH = 384
"""Image size [px]."""


def draw(file: Path) -> bytes | None:
    """Render a PNG of a scene from its viewpoint, or its first camera; None if it has no camera."""
    from simfoundry.assets.cache import Cache
    from simfoundry.render.montage import png_bytes
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.worlds.render import render

    loaded = load_scene(file)
    assert isinstance(loaded.spec, SceneSpec)
    scene = lower(loaded, Cache.default())
    camera = view(scene, loaded.spec)
    return None if camera is None else png_bytes(render(scene, camera))


def view(scene: Scene, spec: SceneSpec) -> Camera | None:
    """Return the viewpoint's camera, or the first, with a small image; None without cameras."""
    cameras = {camera.name: camera for camera in scene.cameras}
    camera = cameras.get(spec.viewpoint or "") or next(iter(cameras.values()), None)
    if camera is None:
        return None
    scale = WIDTH / camera.width
    height = max(1, round(camera.height * scale))
    cx, cy = scale * (camera.cx + 0.5) - 0.5, scale * (camera.cy + 0.5) - 0.5
    return replace(camera, width=WIDTH, height=height, fx=camera.fx * scale, fy=camera.fy * scale, cx=cx, cy=cy)
