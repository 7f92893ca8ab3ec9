"""Read builds with one engine, in a process of its own: ``python -m simfoundry.verify.reader READBACK``.

READBACK is the ``readback.py`` of a target. Each job is a line of JSON on standard input, ``{"build": FOLDER, "loader":
FILE, "run": null | {"seconds": s, "every": s}}``; each result is a line of JSON on standard output, ``{"facts": …,
"moments": […]}`` or ``{"error": …}``. Output of the engine goes to standard error. ``--probe`` prints, as a line of
JSON, the given packages that this interpreter can import, with versions.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from simfoundry.runtime.plugins import import_file
from simfoundry.verify.readback import Session


def main(arguments: list[str]) -> int:
    """Answer every job; return 0 unless the arguments are wrong."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # engines print to standard output, which carries the answers
    if arguments[:1] == ["--probe"]:
        print(json.dumps(probe(arguments[1:])), file=answers, flush=True)
        return 0
    readback = import_file(Path(arguments[0]))
    for line in sys.stdin:
        print(json.dumps(answer(readback, json.loads(line))), file=answers, flush=True)
    return 0


def probe(packages: list[str]) -> dict[str, str]:
    """Return the versions of the given ``module:distribution`` entries found here, without importing any."""
    found = {}
    for entry in packages:
        module, _, distribution = entry.partition(":")
        try:
            if importlib.util.find_spec(module) is None:
                continue
            found[entry] = importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            found[entry] = "unknown"
        except (ImportError, ValueError):
            continue
    return found


def answer(readback: ModuleType, job: dict[str, Any]) -> dict[str, Any]:
    """Return an engine's read-back of a build, or the samples of a run."""
    try:
        build = Path(job["build"])
        session: Session = readback.open_build(build, import_file(Path(job["loader"]), build / "load.py"))
    except Exception as error:  # any error of the engine is the answer
        return {"error": f"{type(error).__name__}: {error}"}
    try:
        moments = [] if job["run"] is None else run(session, job["run"]["seconds"], job["run"]["every"])
        return {"facts": None if moments else session.read().to_json(), "moments": moments}
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}"}
    finally:
        session.close()


def run(session: Session, seconds: float, every: float) -> list[dict[str, Any]]:
    """Return samples at the start and then about every ``every`` seconds, at whole time steps."""
    steps, stride = round(seconds / session.timestep), max(1, round(every / session.timestep))
    moments = [session.moment(0.0).to_json()]
    for k in range(1, steps + 1):
        session.step()
        if k % stride == 0 or k == steps:
            moments.append(session.moment(k * session.timestep).to_json())
    return moments


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
