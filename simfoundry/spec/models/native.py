"""Data that only one format knows, which documents keep beside their own keys and write back into that format."""

import functools
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field

from simfoundry.spec.models.base import Model, consistent, fault

# Maximum number of values of one `native`, which is enough for hundreds of keyframes of a humanoid.
MAX_VALUES = 200_000

# Maximum length of a text [characters]; the longest public one, of a custom text, has 200.
MAX_TEXT = 1000

# Texts that are safe in every attribute: printable, without the characters that XML escapes.
_TEXT = re.compile(r"[^\x00-\x1f<>&\"\x7f]*\Z")

Attributes = dict[str, Any]


@functools.cache
def mjcf_names() -> dict[str, Any]:
    """Return the table of the attributes that `native.mjcf` may contain."""
    from simfoundry.spec.yaml.text import read  # only documents with native data need the table

    data: dict[str, Any] = read(Path(__file__).with_name("native.yaml")).data
    return data


class NativeData(Model):
    """Data for single formats, by format. It is written into that format unchanged, and no other format reads it."""

    LEVEL: ClassVar[str] = ""

    mjcf: Attributes = Field(
        {},
        description="Attributes of MJCF by name, which MuJoCo's reference describes, except for those of files, plug-"
        "ins and default classes.",
    )

    @consistent
    def _known(self) -> None:
        if sum(1 for _ in _values(self.mjcf)) > MAX_VALUES:
            raise fault("sf107", f"`native` has more than {MAX_VALUES} values", "mjcf")
        self.check(mjcf_names())

    def check(self, names: dict[str, Any]) -> None:
        """Raise a fault if the data contains an unknown attribute or an invalid value."""
        check_attributes(self.mjcf, names[self.LEVEL], names, self.LEVEL)


class LinkNative(NativeData):
    """MJCF attributes of a link's body that the language has no keys for."""

    LEVEL = "link"


class JointNative(NativeData):
    """MJCF attributes of a joint that the language has no keys for."""

    LEVEL = "joint"


class PartNative(NativeData):
    """MJCF attributes of a part's geom that the language has no keys for."""

    LEVEL = "part"


class ObjectNative(NativeData):
    """MJCF attributes of the geom of an object with an inline shape."""

    LEVEL = "object"


class SiteNative(NativeData):
    """MJCF attributes of a site that the language has no keys for."""

    LEVEL = "site"


class ActuatorNative(NativeData):
    """MJCF attributes of an actuator that the language has no keys for."""

    LEVEL = "actuator"


class SensorNative(NativeData):
    """MJCF attributes of a sensor that the language has no keys for."""

    LEVEL = "sensor"


class SceneNative(NativeData):
    """MJCF elements and settings of a scene. Elements refer to others by their names in the compiled file."""

    def check(self, names: dict[str, Any]) -> None:
        """Raise a fault if the data contains an unknown section, element or attribute, or an invalid value."""
        for section, value in self.mjcf.items():
            if section in names["settings"]:
                if not isinstance(value, dict):
                    raise fault("sf107", f"`{section}` must be a mapping of attributes", "mjcf")
                check_attributes(value, names["settings"][section], names, section)
            elif section in names["sections"]:
                for element in value if isinstance(value, list | tuple) else [None]:
                    _check_element(element, section, names)
            else:
                known = ", ".join(f"`{n}`" for n in (*names["settings"], *names["sections"]))
                raise fault("sf107", f"`native.mjcf` has no section `{section}`; there are {known}", "mjcf")


def _check_element(element: Any, section: str, names: dict[str, Any]) -> None:
    """Raise a fault unless an element of a section is a mapping from its tag to its attributes."""
    if not isinstance(element, dict) or len(element) != 1 or not isinstance(next(iter(element.values())), dict):
        example = "`- fixed: {name: pull, path: […]}`"
        raise fault("sf107", f"`{section}` must be a list of elements with their attributes, such as {example}", "mjcf")
    ((tag, attributes),) = element.items()
    tags = names["sections"][section]
    allowed = tags.get("element" if section == "sensor" and tag in names["sensors"] else tag)
    if allowed is None:
        listed = ", ".join(f"`{n}`" for n in (names["sensors"] if section == "sensor" else tags))
        raise fault("sf107", f"`{section}` has no element `{tag}`; there are {listed}", "mjcf")
    path = attributes.get("path")
    if path is not None and tag in names["paths"]:
        for step in path if isinstance(path, list | tuple) else [None]:
            inner, values = next(iter(step.items())) if isinstance(step, dict) and len(step) == 1 else ("", None)
            if inner not in names["paths"][tag] or not isinstance(values, dict):
                listed = ", ".join(f"`{n}`" for n in names["paths"][tag])
                raise fault("sf107", f"each step of the `path` of `{tag}` must be one of {listed}", "mjcf")
            check_attributes(values, names["paths"][tag][inner], names, inner)
        attributes = {key: value for key, value in attributes.items() if key != "path"}
    check_attributes(attributes, allowed, names, tag)


def check_attributes(given: Attributes, allowed: Iterable[str], names: dict[str, Any], what: str) -> None:
    """Raise a fault if an attribute is unknown, or if a value is not a number, a text, or a list of these."""
    known = list(allowed)
    for key, value in given.items():
        if key not in known:
            raise fault("sf107", f"`{key}` is not an attribute of `{what}`; there are {', '.join(known)}", "mjcf")
        if isinstance(value, dict) and key in ("inertial", "freejoint", "equality", "exact"):
            check_attributes(value, names[key], names, key)
            continue
        for each in value if isinstance(value, list | tuple) else [value]:
            if isinstance(each, str) and len(each) <= MAX_TEXT and _TEXT.match(each):
                continue
            if not isinstance(each, int | float) or not math.isfinite(each):
                message = f"`{key}` must be a finite number, a plain text, `true`, `false`, or a list of these"
                raise fault("sf107", message, "mjcf")


def _values(data: Any) -> Iterable[Any]:
    if isinstance(data, dict | list | tuple):
        for value in data.values() if isinstance(data, dict) else data:
            yield from _values(value)
    else:
        yield data
