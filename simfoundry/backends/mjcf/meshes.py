"""The assets of an MJCF file: meshes, textures and materials, each stored once and named after its first user."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import numbers
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.meshfile import obj_bytes


class Assets:
    """The ``<asset>`` element under construction, and the files that it refers to, by file name."""

    def __init__(self, element: ET.Element) -> None:
        self.files: dict[str, bytes] = {}
        self._element = element
        self._counts: dict[str, int] = {}
        self._names: dict[object, str] = {}
        self._taken: set[str] = set()

    def mesh(self, mesh: Mesh, wish: str, collides: bool) -> str:
        """Return the name of the asset for ``mesh``; a new asset is named after ``wish``."""
        key = (mesh.digest, collides)
        if key not in self._names:
            name = self._names[key] = self._new_name(wish, numbered=collides)
            file = self._names.get((mesh.digest, not collides), name)
            # Visual meshes may be open or flat; for those, MuJoCo can compute the mass only from the surface. It needs
            # neither.
            inertia = "convex" if collides else "shell"
            ET.SubElement(self._element, "mesh", name=name, file=f"{file}.obj", inertia=inertia)
            self.files.setdefault(f"{file}.obj", obj_bytes(mesh))
        return self._names[key]

    def material(self, png: bytes, rgba: Array, wish: str) -> str:
        """Return the name of the material with a texture multiplied by a color."""
        tint = numbers(rgba)
        if (png, tint) not in self._names:
            if png not in self._names:
                texture = self._names[png] = self._new_name(f"{wish}_texture")
                ET.SubElement(self._element, "texture", name=texture, type="2d", file=f"{texture}.png")
                self.files[f"{texture}.png"] = png
            name = self._names[png, tint] = self._new_name(f"{wish}_material")
            ET.SubElement(self._element, "material", name=name, texture=self._names[png], rgba=tint)
        return self._names[png, tint]

    def _new_name(self, wish: str, numbered: bool = False) -> str:
        """Return ``wish`` as a file name, with a number appended if it is taken or if ``numbered`` is set."""
        plain = wish.replace(".", "_").replace(":", "_").strip("_")
        while True:
            k = self._counts[plain] = self._counts.get(plain, -1) + 1
            name = f"{plain}_{k}" if k or numbered else plain
            if name not in self._taken:
                self._taken.add(name)
                return name
