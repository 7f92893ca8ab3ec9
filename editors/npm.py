"""Install the packages of a `package-lock.json` beside it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

NO_NETWORK = re.compile(r"ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ECONNRESET|ETIMEDOUT|ENETUNREACH|network|offline", re.I)

# Seconds for 165 MB of packages on a slow line; a person who waits longer looks for the fault in the line.
PATIENCE = 600


class NoPackagesError(Exception):
    """Raised if the packages cannot be had on this machine: npm is missing, or there is no network."""


class BrokenPackagesError(Exception):
    """Raised if npm refuses the packages. The message is what npm says."""


def install(folder: Path, aside: Path) -> Path:
    """Install what ``package-lock.json`` in a folder says, and return ``node_modules``. Does nothing if it is there.

    Args:
        folder: Folder with ``package.json`` and ``package-lock.json``.
        aside: Folder on the same disk for the installation, which then moves in one step: several processes may be at
            it, and none sees half of it.
    """
    modules, lock = folder / "node_modules", folder / "package-lock.json"
    installed = modules / ".installed"
    if installed.is_file() and installed.read_bytes() == lock.read_bytes():
        return modules
    if not shutil.which("node") or not shutil.which("npm"):
        raise NoPackagesError("node and npm are needed, and they are not installed")
    place = aside / f"npm-{os.getpid()}"
    place.mkdir(parents=True, exist_ok=True)
    try:
        for name in ("package.json", "package-lock.json"):
            shutil.copy(folder / name, place / name)
        call = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
        done = subprocess.run(call, cwd=place, capture_output=True, text=True, timeout=PATIENCE, check=False)
        if done.returncode:
            if NO_NETWORK.search(done.stderr):
                raise NoPackagesError("npm cannot install the packages, because there is no network")
            raise BrokenPackagesError(f"npm cannot install the packages:\n{done.stderr}")
        shutil.copy(lock, place / "node_modules" / ".installed")
        shutil.rmtree(modules, ignore_errors=True)
        try:
            (place / "node_modules").rename(modules)
        except OSError:  # another process was faster
            if not installed.is_file():
                raise
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return modules
