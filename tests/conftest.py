"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import simfoundry

REPOSITORY = Path(__file__).resolve().parent.parent

PACKAGE = Path(simfoundry.__file__).resolve().parent
"""The package under test: that of the checkout, or the one that a wheel installed."""

of_the_checkout = pytest.mark.skipif(PACKAGE.parent != REPOSITORY, reason="it is about the checkout, not about a wheel")
"""For tests that read the sources where they lie."""

# No test fetches a robot, waits for a network or depends on what a machine has fetched before: those that need
# a robot's model name its files.
os.environ["MENAGERIE_ROOT"] = str(REPOSITORY / "tests" / "no_robots")
os.environ.pop("SIMFOUNDRY_ROBOTS", None)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does
os.environ["SIMFOUNDRY_PROGRESS"] = "never"  # a slow machine would print lines that a fast one does not

# The default run is the same everywhere and each time; `make proofs` searches at random, and longer. Slow examples are
# no failure: the machines that run this are shared.
settings.register_profile(
    "default", derandomize=True, deadline=None, max_examples=30, suppress_health_check=list(HealthCheck)
)
settings.register_profile("random", deadline=None, max_examples=500, suppress_health_check=list(HealthCheck))
settings.load_profile("default")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-goldens", action="store_true", help="write golden files anew instead of comparing")


@pytest.fixture
def update_goldens(request: pytest.FixtureRequest) -> bool:
    """Whether golden files are to be written anew."""
    return bool(request.config.getoption("--update-goldens"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Captures, meshes and robots that are not part of the project; skips where they are absent."""
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the development data in {folder}")
    return folder
