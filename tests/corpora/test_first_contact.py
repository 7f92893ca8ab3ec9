"""What the first-contact proof runs is in the README, and what it installs is in the package: without installing it."""

from __future__ import annotations

import tomllib

from simfoundry.capture.demo import own_capture
from simfoundry.cli.main import COMMANDS
from simfoundry.runtime.extras import EXTRAS
from tests.conftest import PACKAGE, REPOSITORY
from tests.corpora.first_contact import blocks


def test_the_readme_shows_a_newcomer_every_command_that_the_proof_promises() -> None:
    install, walk = blocks()
    assert install == [
        "pip wheel --no-deps --wheel-dir dist .",
        'pip install "$(ls dist/simfoundry-*.whl)[expert]"',
    ]
    assert set(EXTRAS["expert"].packages) == {"mink", "qpsolvers", "daqp"}
    words = [line.split() for line in walk]
    assert all(program == "simfoundry" and command in COMMANDS for program, command, *_ in words)
    assert {"demo", "new", "check", "compile", "cousins", "eval"} <= {command for _, command, *_ in words}
    assert any("-p expert" in line for line in walk)


def test_what_the_demo_and_the_cousins_need_goes_into_the_wheel() -> None:
    wheel = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    included = wheel["force-include"]
    assert {"specs/captures", "specs/assets", "targets"} <= set(included)
    assert all(place == f"simfoundry/shipped/{source}" for source, place in included.items())
    assert all((REPOSITORY / source).is_dir() for source in included)
    assert (own_capture() / "capture.yaml").is_file()
    assert (PACKAGE / "robots" / "demo_arm.xml").is_file()  # whatever the package holds goes along
