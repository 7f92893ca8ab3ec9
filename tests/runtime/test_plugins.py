"""Extensions that installed packages bring."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.plugins import PluginError, Registry, UnknownExtensionError
from tests.foreign_package import write_package

BACKENDS = Registry[float]("simfoundry.backends", {"pi": "math:pi", "gone": "simfoundry.no_such_module:X"}, float)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the import path, whose packages are forgotten after the test."""
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]


def test_a_package_adds_to_what_is_built_in(site: Path) -> None:
    """Built-in names stand first, in their order."""
    write_package(site, "a-b", {"simfoundry.backends": {"tau": "a_b:N.TAU"}}, {"a_b.py": "class N:\n    TAU = 6.28\n"})
    assert BACKENDS.names() == ["pi", "gone", "tau"]
    assert "tau" in BACKENDS and "taus" not in BACKENDS
    assert 3.141 < BACKENDS.load("pi") < 3.142
    assert BACKENDS.load("tau") == 6.28
    plugin = BACKENDS.plugin("tau")
    assert plugin is not None and plugin.distribution == "a-b 0.1"


def test_an_unknown_name_says_which_exist(site: Path) -> None:
    """Those of plug-ins too."""
    write_package(site, "ab", {"simfoundry.backends": {"tau": "ab:X"}}, {})
    with pytest.raises(UnknownExtensionError, match=r"no backend is called `ta`; available: `pi`, `gone`, `tau`$"):
        BACKENDS.load("ta")


@pytest.mark.parametrize(
    ("value", "text", "cause"),
    [
        ("ab:X", "import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("ab:X", "def (", "SyntaxError: invalid syntax"),
        ("ab:X", 'raise OSError("no\\n license")', "OSError: no license"),
        ("ab:X", "", "AttributeError: module 'ab' has no attribute 'X'"),
        ("ab:X", "X = 'text'", "`ab:X` is a str, not a float"),
    ],
)
def test_a_broken_plug_in_is_a_sentence(site: Path, value: str, text: str, cause: str) -> None:
    """It names the package, whatever the module does when it is imported."""
    write_package(site, "ab", {"simfoundry.backends": {"tau": value}}, {"ab.py": text})
    with pytest.raises(PluginError) as caught:
        BACKENDS.load("tau")
    message = str(caught.value)
    assert message.startswith("the `tau` backend from the package ab 0.1 cannot be loaded: ")
    assert cause in message and "\n" not in message
    assert message.endswith("(entry point `tau = ab:X` in the `simfoundry.backends` group)")


def test_two_packages_with_one_name_are_told_apart(site: Path) -> None:
    """Neither is used: which one came first would decide by chance."""
    for name in ("one", "two"):
        write_package(site, name, {"simfoundry.backends": {"tau": f"{name}:X"}}, {f"{name}.py": "X = 1.0"})
    assert "tau" in BACKENDS.names()
    with pytest.raises(
        SimfoundryError, match=r"from the package (one|two) 0.1 .* the package (one|two) 0.1 provides an extension"
    ):
        BACKENDS.load("tau")


def test_a_plug_in_does_not_replace_what_is_built_in(site: Path) -> None:
    """A document means the same wherever it is read."""
    write_package(site, "ab", {"simfoundry.backends": {"pi": "ab:X"}}, {"ab.py": "X = 3.0"})
    assert BACKENDS.load("pi") > 3.1
    assert BACKENDS.plugin("pi") is None
    assert BACKENDS.names() == ["pi", "gone"]


def test_the_folder_of_a_plug_in(site: Path) -> None:
    """Robots and targets are files rather than objects."""
    entries = {"simfoundry.targets": {"sim": "ab.sim", "mod": "ab.mod", "gone": "no.sim"}}
    write_package(site, "ab", entries, {"ab/__init__.py": "", "ab/sim/profile.yaml": "", "ab/mod.py": ""})
    targets = Registry[object]("simfoundry.targets", {})
    assert [targets.plugin(name) is not None for name in ("sim", "mod", "gone", "other")] == [True, True, True, False]
    found = {name: targets.plugin(name) for name in ("sim", "mod", "gone")}
    assert found["sim"] is not None and found["sim"].folder() == site / "ab" / "sim"
    for name, cause in (("mod", "`ab.mod` is not a package"), ("gone", "No module named 'no'")):
        plugin = found[name]
        assert plugin is not None
        with pytest.raises(PluginError, match=cause):
            plugin.folder()


def test_built_in_names_search_no_packages() -> None:
    """Reading the metadata of every installed package would cost each start 20 ms."""
    code = (
        "import sys; from simfoundry.runtime.plugins import Registry; "
        "r = Registry('simfoundry.backends', {'pi': 'math:pi'}); assert 'pi' in r; r.load('pi'); "
        "assert 'importlib.metadata' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
