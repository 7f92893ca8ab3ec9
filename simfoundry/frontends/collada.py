"""COLLADA meshes (.dae) in: triangles and polygons with materials, placed by their scene, in metres with z up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, texture_png
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.xmltree import Element, read_xml
from simfoundry.geometry.frames import Array

Vec3 = tuple[float, float, float]

UP = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z_UP": np.eye(3),
}
"""Rotation of a file's axes into axes with z up."""

MAX_INSTANCES = 10_000


def read_collada(path: Path, scale: Vec3) -> tuple[MeshPart, ...]:
    """The geometries of a COLLADA file; ``scale`` comes after the file's own unit and up axis.

    Raises :class:`MeshError`.
    """
    try:
        root = read_xml(path)
        parts = list(_Collada(path, root).parts())
    except ImportRefusedError as error:
        raise MeshError("SF301", f"{path.name} cannot be read as a mesh: {error.reason}", "export it again") from None
    if not parts:
        raise MeshError("SF301", f"{path.name} has no triangles", "export the surface, not only points or curves")
    factor = np.array(scale)
    flip = float(np.prod(factor)) < 0
    faces = [np.ascontiguousarray(p.faces[:, ::-1]) if flip else p.faces for p in parts]
    return tuple(MeshPart(p.vertices * factor, f, p.uv, p.texture, p.rgba) for p, f in zip(parts, faces, strict=True))


@dataclass(frozen=True)
class _Corner:
    """Where an input of a primitive finds its values: its source, and its offset in the index list."""

    source: str
    offset: int


class _Collada:
    """One file; elements are found by their ids."""

    def __init__(self, path: Path, root: Element) -> None:
        self.path, self.root, self.count = path, root, 0
        self.by_id = {e.attributes["id"]: e for e in root.walk() if "id" in e.attributes}

    def parts(self) -> Iterator[MeshPart]:
        """The geometries as the visual scene places them; all of them as they are where there is no scene."""
        to_metres = np.eye(4)
        asset = self.root.first("asset")
        unit = asset.first("unit") if asset is not None else None
        up = asset.first("up_axis") if asset is not None else None
        meter = 1.0 if unit is None else unit.number("meter", 1.0)
        axis = up.text if up is not None else "Y_UP"
        to_metres[:3, :3] = UP.get(axis.strip(), np.eye(3)) * meter
        scenes = [e for e in self.root.walk() if e.tag == "visual_scene"]
        if not scenes:
            for geometry in [e for e in self.root.walk() if e.tag == "geometry"]:
                yield from self.geometry(geometry, to_metres, {})
            return
        for node in scenes[0].all("node"):
            yield from self.node(node, to_metres, 0)

    def node(self, node: Element, X_WN: Array, depth: int) -> Iterator[MeshPart]:
        """The geometries of a node and of those below it."""
        self.count += 1
        if depth > 50 or self.count > MAX_INSTANCES:
            raise node.refused("its nodes nest too deep, or too often")
        for child in node.children:
            X_WN = X_WN @ _transform(child)
        for child in node.children:
            target = self.by_id.get((child.get("url") or "").lstrip("#"))
            if child.tag == "node":
                yield from self.node(child, X_WN, depth + 1)
            elif child.tag == "instance_node" and target is not None:
                yield from self.node(target, X_WN, depth + 1)
            elif child.tag == "instance_geometry" and target is not None:
                yield from self.geometry(target, X_WN, self.bound(child))

    def bound(self, instance: Element) -> dict[str, str]:
        """Which material each symbol of a geometry stands for."""
        pairs = (e for e in instance.walk() if e.tag == "instance_material")
        return {e.get("symbol") or "": (e.get("target") or "").lstrip("#") for e in pairs}

    def geometry(self, geometry: Element, X_WN: Array, materials: dict[str, str]) -> Iterator[MeshPart]:
        """Each primitive of a geometry."""
        mesh = geometry.first("mesh")
        for primitive in mesh.children if mesh is not None else ():
            if primitive.tag in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
                part = self.primitive(primitive, X_WN, materials)
                if part is not None:
                    yield part

    def primitive(self, primitive: Element, X_WN: Array, materials: dict[str, str]) -> MeshPart | None:
        """The triangles of a primitive; polygons are cut into fans."""
        inputs = {e.get("semantic") or "": _Corner((e.get("source") or "").lstrip("#"), int(e.number("offset", 0)))
                  for e in primitive.all("input")}  # fmt: skip
        vertex = inputs.get("VERTEX")
        if vertex is None:
            raise primitive.refused(f"`<{primitive.tag}>` has no VERTEX input")
        stride = 1 + max(int(e.number("offset", 0)) for e in primitive.all("input"))
        rows = [np.array([int(w) for w in p.text.split()], dtype=np.int64) for p in primitive.all("p")]
        triangles = np.concatenate([np.zeros((0, 3, stride), np.int64), *self.triangles(primitive, rows, stride)])
        if not len(triangles):
            return None
        points = self.values(self.positions(vertex.source, primitive), primitive)[:, :3]
        corners = triangles[:, :, vertex.offset]
        uv_input = inputs.get("TEXCOORD")
        uv = None
        if uv_input is not None:
            coordinates = self.values(self.by_id.get(uv_input.source), primitive)[:, :2]
            chosen = triangles[:, :, uv_input.offset].reshape(-1)
            if chosen.min() >= 0 and chosen.max() < len(coordinates):
                uv = coordinates[chosen]
        if corners.min() < 0 or corners.max() >= len(points):
            raise primitive.refused("it has triangles whose corners do not exist")
        if uv is not None:
            vertices, faces = points[corners.reshape(-1)], np.arange(corners.size).reshape(-1, 3)
        else:
            used, inverse = np.unique(corners, return_inverse=True)
            vertices, faces = points[used], inverse.reshape(-1, 3)
        vertices = vertices @ X_WN[:3, :3].T + X_WN[:3, 3]
        if np.linalg.det(X_WN[:3, :3]) < 0:
            faces = faces[:, ::-1]
        texture, rgba = self.look(materials.get(primitive.get("material") or "", primitive.get("material") or ""))
        return MeshPart(
            vertices, np.ascontiguousarray(faces, dtype=np.int32), uv, texture if uv is not None else None, rgba
        )

    def triangles(self, primitive: Element, rows: list[np.ndarray], stride: int) -> Iterator[Array]:
        """Index triples, shape (n, 3, stride), of the index lists of a primitive."""
        for row in rows:
            if len(row) % stride:
                raise primitive.refused("its index list is cut short")
            corners = row.reshape(-1, stride)
            if primitive.tag == "triangles":
                yield corners[: len(corners) // 3 * 3].reshape(-1, 3, stride)
                continue
            counts = [len(corners)]
            listed = primitive.first("vcount")
            if primitive.tag == "polylist" and listed is not None:
                counts = [int(w) for w in listed.text.split()]
            start = 0
            for count in counts:
                polygon, start = corners[start : start + count], start + count
                if len(polygon) < 3:
                    continue
                k = np.arange(1, len(polygon) - 1)
                if primitive.tag == "tristrips":
                    even = (k - 1) % 2 == 0
                    a, b = np.where(even, k - 1, k), np.where(even, k, k - 1)
                else:
                    a, b = np.zeros_like(k), k
                yield np.stack([polygon[a], polygon[b], polygon[k + 1]], axis=1)

    def positions(self, vertices: str, at: Element) -> Element | None:
        element = self.by_id.get(vertices)
        for entry in element.all("input") if element is not None else ():
            if entry.get("semantic") == "POSITION":
                return self.by_id.get((entry.get("source") or "").lstrip("#"))
        raise at.refused("its vertices have no positions")

    def values(self, source: Element | None, at: Element) -> Array:
        """The numbers of a source, one row for each of its entries."""
        array = source.first("float_array") if source is not None else None
        if source is None or array is None:
            raise at.refused("it names values that do not exist")
        accessor = next((e for e in source.walk() if e.tag == "accessor"), None)
        stride = int(accessor.number("stride", 1)) if accessor is not None else 3
        try:
            numbers = np.array([float(w) for w in array.text.split()])
        except ValueError:
            raise array.refused("its values are no numbers") from None
        return numbers[: len(numbers) // stride * stride].reshape(-1, max(1, stride))

    def look(self, material: str) -> tuple[bytes | None, tuple[float, float, float, float] | None]:
        """Texture and colour of a material."""
        element = self.by_id.get(material)
        instance = element.first("instance_effect") if element is not None else None
        effect = self.by_id.get((instance.get("url") or "").lstrip("#")) if instance is not None else None
        diffuse = next((e for e in effect.walk() if e.tag == "diffuse"), None) if effect is not None else None
        if diffuse is None:
            return None, None
        color = diffuse.first("color")
        if color is not None:
            words = [float(w) for w in color.text.split()][:4]
            r, g, b, a = (min(max(v, 0.0), 1.0) for v in [*words, 1.0, 1.0, 1.0, 1.0][:4])
            return None, (r, g, b, a if len(words) > 3 and a > 0 else 1.0)
        return self.texture(diffuse, effect), None

    def texture(self, diffuse: Element, effect: Element | None) -> bytes | None:
        """The PNG of a texture beside the file; None where it is not there."""
        from PIL import Image

        name = next((e.get("texture") or "" for e in diffuse.all("texture")), "")
        samplers = {e.get("sid"): e for e in effect.walk() if e.tag == "newparam"} if effect is not None else {}
        for _ in range(2):
            sampler = samplers.get(name)
            inner = [e for e in sampler.walk() if e.tag in ("source", "init_from")] if sampler is not None else []
            name = inner[0].text.strip() if inner else name
        image = self.by_id.get(name)
        source = next((e for e in image.walk() if e.tag == "init_from"), None) if image is not None else None
        file = self.path.parent / Path(source.text.strip()).name if source is not None else None
        if file is None or not file.is_file():
            return None
        try:
            with Image.open(file) as picture:
                return texture_png(file.name, picture.convert("RGB"))
        except OSError:  # no picture that can be read
            return None


def _transform(element: Element) -> Array:
    """The matrix of one step of a node's transform; the identity for what is none."""
    out = np.eye(4)
    if element.tag not in ("matrix", "translate", "rotate", "scale"):
        return out
    try:
        values = [float(w) for w in element.text.split()]
    except ValueError:
        raise element.refused(f"`<{element.tag}>` holds no numbers") from None
    if len(values) != {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}[element.tag]:
        raise element.refused(f"`<{element.tag}>` has {len(values)} numbers")
    match element.tag:
        case "matrix":
            return np.array(values).reshape(4, 4)
        case "translate":
            out[:3, 3] = values
        case "scale":
            out[:3, :3] = np.diag(values)
        case "rotate":
            axis = np.array(values[:3])
            length = float(np.linalg.norm(axis))
            if length > 0:
                from simfoundry.geometry.frames import matrix_from_quat

                half = math.radians(values[3]) / 2
                out[:3, :3] = matrix_from_quat(np.array([math.cos(half), *(axis / length * math.sin(half))]))
    return out
