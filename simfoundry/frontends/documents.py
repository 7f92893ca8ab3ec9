"""Convert drafts to asset and scene documents, together with their mesh files."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

from simfoundry.frontends.asset_documents import BuiltDocuments, asset_spec, inline_data, placement_data
from simfoundry.frontends.document_data import (
    Data,
    color_data,
    document_text,
    exactly,
    pose_data,
    rounded,
    without_empty,
)
from simfoundry.frontends.draft import BodyDraft, CompiledName, LinkPath, ModelDraft
from simfoundry.frontends.meshes import FileShelf
from simfoundry.frontends.names import NameTable, plain_name
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import WORLD
from simfoundry.spec.models.scene import SceneSpec


def build_asset(draft: ModelDraft, name: str, base: Path, root: Path | None) -> BuiltDocuments:
    """Build NAME.asset.yaml for the ``base`` folder from a draft that contains one body.

    Mesh files below ``root`` are referenced in place instead of being copied.
    """
    built = BuiltDocuments()
    shelf = FileShelf(base, f"{name}_files", root, built.files)
    tidy = rounded if draft.native is None else exactly
    spec = asset_spec(draft.bodies[0], plain_name(name), shelf, built, tidy)
    built.documents[f"{name}.asset.yaml"] = document_text(spec, tidy)
    return built


def build_scene(draft: ModelDraft, name: str, base: Path, root: Path | None) -> BuiltDocuments:
    """Build NAME.scene.yaml for the ``base`` folder, along with an asset document for each body that needs one.

    Mesh files below ``root`` are referenced in place instead of being copied.
    """
    return _SceneBuilder(draft, f"{name}_files", base, root).build(name)


class _SceneBuilder:
    """A builder that converts a draft to a scene.

    ``objects`` maps body names to object names, and ``assets`` maps object names to asset documents.
    """

    def __init__(self, draft: ModelDraft, folder: str, base: Path, root: Path | None) -> None:
        self.draft, self.folder, self.built = draft, folder, BuiltDocuments()
        self.tidy = rounded if draft.native is None else exactly
        self.shelf = FileShelf(base / folder, ".", root)
        self.names = NameTable()
        self.assets: dict[str, AssetSpec] = {}
        self.objects: dict[str, str] = {}
        self.bodies = {body.name: body for body in draft.bodies}

    def build(self, name: str) -> BuiltDocuments:
        draft, built = self.draft, self.built
        data: Data = {"simfoundry": "scene/1", "name": plain_name(name, "scene"), "objects": {}}
        for body in draft.bodies:
            self.objects[body.name] = called = self.names.name(body.name)
            data["objects"][called] = self.object_data(body, called)
        built.names |= self.names.renamed
        if draft.gravity is not None:
            data["gravity"] = draft.gravity
        data["robots"] = {
            self.names.name(r.name): {"model": r.model, "pose": pose_data(r.X_WB), **r.changed} for r in draft.robots
        }
        data["cameras"], data["lights"] = self.cameras(), self.lights()
        data["no_contact"], data["relations"] = self.no_contact(), tuple(draft.relations)
        if draft.background is not None:
            data["background"] = {"mesh": f"{self.folder}/{self.shelf.place(draft.background)}"}
        data["options"] = draft.options
        if draft.native is not None:
            data["native"] = {"mjcf": self.native(draft.native)}
        spec = SceneSpec.model_validate(without_empty(self.tidy(data)))
        built.documents[f"{name}.scene.yaml"] = document_text(spec, self.tidy)
        built.documents |= {
            f"{self.folder}/{n}.asset.yaml": document_text(a, self.tidy) for n, a in self.assets.items()
        }
        built.files = {f"{self.folder}/{path.removeprefix('./')}": data for path, data in self.shelf.files.items()}
        return built

    def object_data(self, body: BodyDraft, called: str) -> Data:
        """Return the data of an object, using an inline shape if possible and an asset document otherwise."""
        if (inline := inline_data(body)) is not None:
            ((link, part),) = [(link, part) for link in body.links.values() for part in link.parts]
            self.built.compiled["body", body.name, link.name] = WORLD if link.native.get("merge") else called
            self.built.compiled["geom", body.name, part] = f"{called}.shape"
            return inline
        asset = self.assets[called] = asset_spec(body, called, self.shelf, self.built, self.tidy)
        data: Data = {"asset": f"{self.folder}/{called}.asset.yaml", **placement_data(body)}
        states = {
            name: pose_data(joint.motion) if joint.type in ("ball", "free") else float(joint.position)
            for name, joint in zip(asset.single_joints, chain(*body.joint_groups), strict=True)
            if joint.mimic is None
        }
        return data | without_empty({"joints": {name: state for name, state in states.items() if state}})

    def link_path(self, body: str, link: str) -> str:
        """Return the ``object.link`` path of a link, or only the object's name if the object has an inline shape."""
        called = self.objects[body]
        if called not in self.assets:
            return called
        return f"{called}.{list(self.assets[called].links)[self.bodies[body].link_order.index(link)]}"

    def no_contact(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of links that do not collide.

        If all links of two objects are excluded, the two objects are listed as a single pair instead.
        """
        pairs: dict[tuple[str, str], list[tuple[LinkPath, LinkPath]]] = {}
        for one, other in self.draft.no_contact:
            pairs.setdefault((one[0], other[0]), []).append((one, other))
        out: list[tuple[str, str]] = []
        for (a, b), ends in pairs.items():
            if len(set(ends)) == len(self.bodies[a].links) * len(self.bodies[b].links):
                out.append((self.objects[a], self.objects[b]))
            else:
                out += [(self.link_path(*one), self.link_path(*other)) for one, other in ends]
        return tuple(out)

    def native(self, value: Any) -> Any:
        """Return native data in which references are replaced by the names in compiled files."""
        if isinstance(value, CompiledName):
            return self.built.compiled[value.kind, value.owner, value.element]
        if isinstance(value, dict):
            return {key: self.native(item) for key, item in value.items()}
        return tuple(map(self.native, value)) if isinstance(value, list | tuple) else value

    def cameras(self) -> Data:
        names, out = NameTable("camera"), {}
        for camera in self.draft.cameras:
            keys = ("size", "fx", "fy", "cx", "cy")
            data: Data = {key: value for key in keys if (value := getattr(camera, key)) is not None}
            data["pose"] = {"xyz": tuple(camera.X_WC.p.tolist()), "quat_wxyz": tuple(camera.X_WC.q.tolist())}
            if camera.mount is not None:
                body, link = camera.mount
                if body not in self.objects:  # a robot, whose frame names are not changed
                    data["mount"] = f"{body}.{link}" if link else body
                else:
                    is_root = link == self.bodies[body].root
                    data["mount"] = self.objects[body] if is_root else self.link_path(body, link)
            out[names.name(camera.name)] = data
            self.built.compiled["camera", "", camera.name] = list(out)[-1]
        return out

    def lights(self) -> Data:
        names, out = NameTable("light"), {}
        for light in self.draft.lights:
            data = {"type": light.type, "intensity": round(light.intensity, 4), "color": color_data((*light.color, 1))}
            if light.type != "dome":
                place = "direction" if light.type == "distant" else "xyz"
                data[place] = getattr(light, place)
            if light.panorama is not None:
                data["texture"] = f"{self.folder}/{self.shelf.place_file(*light.panorama)}"
            out[names.name(light.name)] = data
        return out
