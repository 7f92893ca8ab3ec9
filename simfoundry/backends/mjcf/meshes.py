"""The assets of an MJCF file: meshes, textures and materials, each once however often it is used."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import numbers
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.meshfile import obj_bytes, texture_name


class Assets:
    """The ``<asset>`` element as it fills, and the files that it names by file name."""

    def __init__(self, element: ET.Element) -> None:
        self.files: dict[str, bytes] = {}
        self._element = element
        self._names: set[str] = set()

    def mesh(self, mesh: Mesh, collides: bool) -> str:
        """Name of the mesh asset that holds ``mesh``."""
        digest = mesh.digest
        # Seen meshes may be open or flat, of which MuJoCo can weigh only the surface; it needs no inertia of either.
        name, inertia = (f"collider_{digest}", "convex") if collides else (f"visual_{digest}", "shell")
        if self._is_new(name):
            file = f"{digest}.obj"
            ET.SubElement(self._element, "mesh", name=name, file=file, inertia=inertia)
            if file not in self.files:
                self.files[file] = obj_bytes(mesh)
        return name

    def material(self, png: bytes, rgba: Array) -> str:
        """Name of the material that shows a texture multiplied by a colour."""
        file = texture_name(png)
        texture = f"texture_{file.removesuffix('.png')}"
        if self._is_new(texture):
            ET.SubElement(self._element, "texture", name=texture, type="2d", file=file)
            self.files[file] = png
        tint = numbers(rgba)
        name = f"material_{file.removesuffix('.png')}_{tint.replace(' ', '_')}"
        if self._is_new(name):
            ET.SubElement(self._element, "material", name=name, texture=texture, rgba=tint)
        return name

    def _is_new(self, name: str) -> bool:
        new = name not in self._names
        self._names.add(name)
        return new
