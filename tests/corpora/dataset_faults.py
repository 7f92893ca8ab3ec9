"""Read damaged datasets: ``python -m tests.corpora.dataset_faults [COUNT] [SEED]``.

Files of a dataset are damaged at random: bytes changed, ends cut off, blocks of zeros, and other values in JSON. Every
attempt to read it must end with one sentence, or with data of the right shapes. Prints how often the damage was found.
"""

from __future__ import annotations

import json
import random
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.data.dataset.formats import FORMATS, dataset_format
from simfoundry.errors import SimfoundryError
from tests.data.synthetic import LENGTHS, build, episode

ODD_VALUES: tuple[Any, ...] = (None, -1, 0, 1e308, float("nan"), "", "x", "../..", [], {}, [[]], 2**63, True, "{0}")


def main(count: int = 200, seed: int = 0) -> int:
    """Damage each format ``count`` times, and print the outcomes; returns the exit code."""
    draws, crashes = random.Random(seed), 0
    with tempfile.TemporaryDirectory(prefix="simfoundry-faults-") as temporary:
        for name in FORMATS.built_in:
            for manifest in (True, False):
                pristine = build(name, Path(temporary) / f"{name}-{manifest}", manifest=manifest)
                outcomes = Counter(outcome_of(name, pristine, draws) for _ in range(count))
                crashes += sum(number for text, number in outcomes.items() if text.startswith("crash"))
                shown = ", ".join(f"{number} {text}" for text, number in sorted(outcomes.items()))
                print(f"{name}{'' if manifest else ' without simfoundry.json'}: {shown}", flush=True)
    return int(crashes > 0)


def outcome_of(name: str, pristine: Path, draws: random.Random) -> str:
    """Damage a copy of a dataset, read all of it, and return what happened."""
    folder = pristine.with_name("damaged")
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(pristine, folder)
    damaged = damage(draws.choice([path for path in sorted(folder.rglob("*")) if path.is_file()]), draws)
    try:
        return "unchanged" if is_unchanged(name, folder) else "changed unnoticed"
    except SimfoundryError as error:
        return "refused" if "\n" not in str(error) and len(str(error)) < 1000 else f"crash: long message {error}"
    except Exception as error:
        return f"crash {type(error).__name__}: {str(error)[:100]} ({damaged})"


def damage(path: Path, draws: random.Random) -> str:
    """Damage a file, and return how."""
    data = bytearray(path.read_bytes())
    start = draws.randrange(len(data))
    kind = draws.choice(["bytes", "end", "zeros", *(["json"] * 5 if path.suffix in (".json", ".jsonl") else [])])
    if kind == "bytes":
        for _ in range(draws.choice([1, 10])):
            data[draws.randrange(len(data))] = draws.randrange(256)
    elif kind == "end":
        del data[start:]
    elif kind == "zeros":
        data[start : start + 64] = bytes(len(data[start : start + 64]))
    else:
        lines = data.decode().splitlines() if path.suffix == ".jsonl" else [data.decode()]
        chosen = draws.randrange(len(lines))
        lines[chosen] = json.dumps(changed(json.loads(lines[chosen]), draws))
        data = bytearray("\n".join(lines).encode())
    path.write_bytes(bytes(data))
    return f"{kind} in {path.name}"


def changed(value: Any, draws: random.Random) -> Any:
    """Return JSON data in which one value, at any depth, is another one or missing."""
    if isinstance(value, dict) and value and draws.random() < 0.9:
        key = draws.choice(sorted(value))
        if draws.random() < 0.1:
            return {name: one for name, one in value.items() if name != key}
        return {**value, key: changed(value[key], draws)}
    if isinstance(value, list) and value and draws.random() < 0.8:
        k = draws.randrange(len(value))
        return [*value[:k], changed(value[k], draws), *value[k + 1 :]]
    return draws.choice(ODD_VALUES)


def is_unchanged(name: str, folder: Path) -> bool:
    """Read a dataset, and return True if its actions and the number of its images are the original ones."""
    stored = dataset_format(name).read(folder)
    _ = stored.statistics
    same = len(stored) == len(LENGTHS)
    for k in range(len(stored)):
        found = stored.episode(k)
        wanted = episode(min(k, len(LENGTHS) - 1)).arrays["action"]
        same &= len(list(found.frames())) == len(wanted)
        values = [one for key, one in found.arrays.items() if key in ("action", "actions")]
        same &= len(values) == 1 and values[0].shape == wanted.shape and bool(np.all(values[0] == wanted))
        if any(len(one) != found.header.length for one in found.arrays.values()):
            raise AssertionError("arrays of different lengths")
    return same


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
