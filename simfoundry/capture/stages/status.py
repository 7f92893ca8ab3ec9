"""The state of the stages in an output folder: what a new run would reuse, and what it would run again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from simfoundry.capture.stages.runner import StageRunner
from simfoundry.capture.stages.stage import STAGES
from simfoundry.errors import SimfoundryError

# File in the folder of stages that tells what the last run reconstructed.
SOURCE = "source.json"

State = Literal["cached", "stale", "overridden"]


@dataclass(frozen=True)
class StageStatus:
    """The state of a stage, or of one object in it.

    ``object`` is the name of the object, or its number if it has none yet, and empty for a stage that does not run for
    each object. ``state`` is ``stale`` if a new run would run the stage again, because its inputs or its code changed,
    and ``overridden`` if the result contains statements of a person.
    """

    stage: str
    object: str
    state: State

    def to_json(self) -> dict[str, Any]:
        """Return the state as plain data for JSON."""
        return {"stage": self.stage, "object": self.object, "state": self.state}


def listed_states(stages: StageRunner, names: Mapping[str, str], complete: bool) -> list[StageStatus]:
    """Return the states of all stages in order.

    Args:
        stages: The runner, which examined.
        names: Names of objects by their labels.
        complete: False if an early stage was stale, so that later ones, which were not reached, are stale too.
    """
    out = []
    for stage in STAGES:
        labels = [label for name, label in stages.states if name == stage.name]
        if stage.per_object:
            labels = sorted(labels, key=lambda label: (not label.isdigit(), len(label), label))
        for label in labels or ([] if complete and (stage.per_object or stage.is_optional) else [""]):
            state: State = "cached" if stages.states.get((stage.name, label)) == "cached" else "stale"
            if state == "cached" and (stage.name, label) in stages.overridden:
                state = "overridden"
            out.append(StageStatus(stage.name, names.get(label, label), state))
    return out


def write_source(folder: Path, capture: Path, frame: str, cad: Path | None = None) -> None:
    """Note in the folder of stages which frame of which capture it belongs to, and the CAD library of the command."""
    data = {"capture": str(capture.resolve()), "frame": frame}
    data |= {} if cad is None else {"cad": str(cad.resolve())}
    (folder / SOURCE).write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def read_source(folder: Path) -> tuple[Path, str, Path | None]:
    """Return the capture document and the frame of a folder of stages, and the CAD library of the command, if any.

    Raises:
        SimfoundryError: The folder does not tell.
    """
    try:
        data = json.loads((folder / SOURCE).read_bytes())
        return Path(data["capture"]), str(data["frame"]), Path(data["cad"]) if "cad" in data else None
    except (OSError, ValueError, KeyError, TypeError):
        raise SimfoundryError(
            f"{folder.parent} is not the output of a capture; specify the folder that `simfoundry capture` wrote"
        ) from None
