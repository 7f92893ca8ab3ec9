"""Read arbitrary USD stages with UsdPhysics, and convert them to SI units with z up."""

from __future__ import annotations

import math
import posixpath
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from simfoundry.frontends.draft import DEFAULTS, BodyDraft, ImportOptions, JointDraft, LinkDraft, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.files import FileSearch
from simfoundry.frontends.mass_repair import repair_masses
from simfoundry.frontends.names import free_name
from simfoundry.frontends.usd.compiled.stage import error_text
from simfoundry.frontends.usd.compiled.stage_frame import Y_TO_Z
from simfoundry.frontends.usd.geoms import UsdGprims, is_collider
from simfoundry.frontends.usd.physics import UsdBody, UsdJoint, add_mass, read_joint
from simfoundry.frontends.usd.views import Mounts, add_cameras, add_lights
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix

# Path that represents the world, for use where a body path is expected.
WORLD = ""

# Prim types that have no content of their own or are read together with other prims.
_EXPECTED = (
    "Xform", "Scope", "Material", "Shader", "PhysicsScene", "GeomSubset", "NodeGraph", "PhysicsCollisionGroup", "",
)  # fmt: skip

# Joint positions [m or rad] below this are treated as rounding errors and set to zero.
AT_ZERO = 1e-5


def read_usd(path: Path, options: ImportOptions = DEFAULTS) -> ModelDraft:
    """Read the scene in a USD file.

    Raises:
        ImportRefusedError: If the file cannot be imported.
    """
    from pxr import Tf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdShade, UsdUtils

    pxr = SimpleNamespace(Usd=Usd, UsdGeom=UsdGeom, UsdLux=UsdLux, UsdPhysics=UsdPhysics, UsdShade=UsdShade)
    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # captures warnings that OpenUSD would print
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reasons = [line.partition(" : '")[2] for line in error_text(error).splitlines() if " : '" in line]
        reason = " ".join(reasons[0].split()) if reasons else "the file could not be opened"
        raise ImportRefusedError(path, f"OpenUSD rejects the file: {reason[:200]}") from None
    _check_layers(path, stage)
    draft = _UsdReader(path, pxr, stage, options.density).read()
    quiet.TakeUncoalescedDiagnostics()
    return draft


def _check_layers(path: Path, stage: Any) -> None:
    """Raise an error if the stage uses layers outside the folders of the file."""
    root = FileSearch(path).root.resolve()
    for layer in stage.GetUsedLayers(includeClipLayers=True):
        place = layer.realPath
        if place and not Path(place.partition("[")[0]).resolve().is_relative_to(root):
            raise ImportRefusedError(path, f"the stage includes {place}, which is outside {root}")


class _UsdReader:
    """A converter from a stage to a draft."""

    def __init__(self, path: Path, pxr: Any, stage: Any, density: float | None) -> None:
        self.path, self.pxr, self.stage = path, pxr, stage
        usd, physics = pxr.UsdGeom, pxr.UsdPhysics
        self.to_m = float(usd.GetStageMetersPerUnit(stage)) or 1.0
        to_kg = float(physics.GetStageKilogramsPerUnit(stage)) or 1.0
        default = stage.GetDefaultPrim()
        self.draft = ModelDraft(default.GetName() if default else path.stem, "USD", density=density)
        self.W = np.eye(4)
        self.W[:3, :3] = self.to_m * (Y_TO_Z if usd.GetStageUpAxis(stage) == "Y" else np.eye(3))
        self.transforms = usd.XformCache()
        self.geoms = UsdGprims(pxr, self.draft, to_kg, self.to_m)
        self.bodies: dict[str, UsdBody] = {}
        self.left: Counter[str] = Counter()
        self.mounts: Mounts = {}

    def read(self) -> ModelDraft:
        prims = list(self.pxr.Usd.PrimRange.Stage(self.stage, self.pxr.Usd.TraverseInstanceProxies()))
        self.gravity(prims)
        for prim in prims:
            api = self.pxr.UsdPhysics.RigidBodyAPI
            if prim.HasAPI(api) and api(prim).GetRigidBodyEnabledAttr().Get() is not False:
                path = str(prim.GetPath())
                self.bodies[path] = UsdBody(prim, *self.frame(prim), LinkDraft(path))
        statics: dict[str, list[Any]] = {}
        for prim in prims:
            if prim.IsA(self.pxr.UsdGeom.Gprim):
                if (owner := self.owner(prim)) is not None:
                    self.add_part(owner, prim)
                else:
                    statics.setdefault(self.group(prim), []).append(prim)
            elif not self.known(prim):
                self.left[prim.GetTypeName()] += 1
        self.static_objects(statics)
        self.trees(list(self.joints(prims)))
        for body in self.bodies.values():
            add_mass(body, self.colliders(body), self.geoms)
        add_cameras(self.draft, self.pxr, prims, self.matrix, self.mounts)
        add_lights(self.draft, self.pxr, prims, self.matrix)
        for kind, count in sorted(self.left.items()):
            self.draft.inexpressible(f"prims of type {kind}", f"{count}")
        missing = [" ".join(str(e).split()) for e in self.stage.GetCompositionErrors()]
        if not self.draft.bodies:
            reason = f": {missing[0][:200]}" if missing else ""
            raise ImportRefusedError(self.path, f"the stage has no geometry{reason}")
        for error in missing:
            self.draft.dropped("referenced layer", "OpenUSD could not compose it", error[:200])
        repair_masses(self.draft, str(self.path))
        return self.draft

    def gravity(self, prims: list[Any]) -> None:
        scene = next((p for p in prims if p.IsA(self.pxr.UsdPhysics.Scene)), None)
        if scene is None:
            return
        api = self.pxr.UsdPhysics.Scene(scene)
        size, direction = api.GetGravityMagnitudeAttr().Get(), api.GetGravityDirectionAttr().Get()
        if size is None or not math.isfinite(size) or size < 0:
            return
        vector = np.array(direction if direction is not None else (0, 0, 0), dtype=np.float64)
        length = float(np.linalg.norm(vector))
        down = self.W[:3, :3] @ (vector / length) / self.to_m if length > 0 else np.array([0.0, 0.0, -1.0])
        self.draft.gravity = tuple((np.round(down * float(size) * self.to_m, 6) + 0.0).tolist())

    def known(self, prim: Any) -> bool:
        """Return True for a prim that has no content of its own or that is read together with another prim."""
        usd, lux = self.pxr.UsdGeom, self.pxr.UsdLux
        kinds = (usd.Camera, self.pxr.UsdPhysics.Joint, lux.BoundableLightBase, lux.NonboundableLightBase)
        return prim.GetTypeName() in _EXPECTED or any(prim.IsA(kind) for kind in kinds)

    def matrix(self, prim: Any) -> Array:
        """Return the transform from a prim's frame and units to the world frame, which is in meters with z up.

        Returns:
            Transformation matrix, shape (4, 4).
        """
        X_SP = np.array(self.transforms.GetLocalToWorldTransform(prim), dtype=np.float64).T
        if not np.isfinite(X_SP).all():
            raise ImportRefusedError(self.path, f"the transform of `{prim.GetPath()}` has non-finite numbers")
        return np.asarray(self.W @ X_SP)

    def frame(self, prim: Any) -> tuple[Pose, Array]:
        """Return a prim's pose in the world, without mirroring, and its scale [m per unit]."""
        X_WP = self.matrix(prim)
        scales = np.linalg.norm(X_WP[:3, :3], axis=0)
        scales = np.where(scales > 0, scales, 1.0)
        u, _, v = np.linalg.svd(X_WP[:3, :3] / scales)
        rotation = u @ v
        if np.linalg.det(rotation) < 0:
            rotation, scales = rotation @ np.diag([1.0, 1.0, -1.0]), scales * (1, 1, -1)
        return Pose.of(X_WP[:3, 3], quat_from_matrix(rotation)), scales

    def owner(self, prim: Any) -> UsdBody | None:
        """Return the nearest rigid body at or above a prim, or None if there is none."""
        while prim and str(prim.GetPath()) not in self.bodies:
            prim = prim.GetParent()
        return self.bodies[str(prim.GetPath())] if prim else None

    def add_part(self, body: UsdBody, prim: Any) -> None:
        if self.geoms.use(prim) == "none":
            return
        part = self.geoms.part(prim, np.asarray(body.X_WB.inverse().matrix @ self.matrix(prim)))
        if part is None:
            return
        body.link.parts.append(part)
        if is_collider(self.pxr, prim) and prim.HasAPI(self.pxr.UsdPhysics.MeshCollisionAPI):
            how = self.pxr.UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get()
            if how == "convexDecomposition":
                body.link.collision = "decompose"
            elif how not in (None, "none", "convexHull"):
                self.draft.changed(f"collider `{prim.GetPath()}`", "the mesh collides as its convex hull", str(how))

    def group(self, prim: Any) -> str:
        """Return the path of the prim that represents the object to which a static gprim belongs.

        This prim is the nearest parent Xform, or the gprim itself if it is directly below the default prim.
        """
        parent = prim.GetParent()
        is_top = parent.IsPseudoRoot() or parent == self.stage.GetDefaultPrim() or parent.GetTypeName() == "Scope"
        return str((prim if is_top else parent).GetPath())

    def static_objects(self, statics: dict[str, list[Any]]) -> None:
        """Add fixed objects for all gprims that do not belong to a rigid body."""
        for path, prims in statics.items():
            prim = self.stage.GetPrimAtPath(path)
            body = UsdBody(prim, *self.frame(prim), LinkDraft("base"))
            for gprim in prims:
                self.add_part(body, gprim)
            if body.link.parts:
                name = self.draft.free_name(prim.GetName())
                self.draft.bodies.append(BodyDraft(name, "base", {"base": body.link}, fixed=True, X_WO=body.X_WB))

    def joints(self, prims: list[Any]) -> Iterator[UsdJoint]:
        schema = self.pxr.UsdPhysics.Joint
        for prim in prims:
            if prim.IsA(schema) and schema(prim).GetJointEnabledAttr().Get() is not False:
                yield read_joint(prim, self.end, self.geoms)

    def end(self, targets: list[Any]) -> tuple[str, Pose, Array]:
        """Return the body (or the world) at one end of a joint, with the target's pose in that body and its scale."""
        prim = self.stage.GetPrimAtPath(targets[0]) if targets else None
        if not prim:
            return WORLD, Pose.of(), np.full(3, self.to_m)
        body = self.owner(prim)
        X_WP, scale = self.frame(prim)
        if body is None:
            return WORLD, X_WP, scale
        if body.prim == prim:
            return str(prim.GetPath()), Pose.of(), scale
        return str(body.prim.GetPath()), body.X_WB.inverse() @ X_WP, scale

    def trees(self, joints: list[UsdJoint]) -> None:
        """Combine bodies connected by joints into objects, and record joints that close a loop as dropped."""
        left = dict(self.bodies)
        at: dict[str, list[UsdJoint]] = {}
        for joint in joints:
            for end in {joint.parent, joint.child}:
                at.setdefault(end, []).append(joint)
        used: set[int] = set()
        root_api = self.pxr.UsdPhysics.ArticulationRootAPI
        grounded = [j.child if j.parent == WORLD else j.parent for j in at.get(WORLD, ())]
        for root in [p for p in grounded if p] + [p for p in left if self.bodies[p].prim.HasAPI(root_api)] + list(left):
            if root in left:
                self.tree(root, left, at, used)
        for joint in joints:
            if id(joint) not in used:
                self.draft.dropped(
                    f"joint `{joint.path}`", "the joint closes a kinematic loop, but only trees are supported"
                )

    def tree(self, root: str, left: dict[str, UsdBody], at: dict[str, list[UsdJoint]], used: set[int]) -> None:
        """Add an object consisting of a root body and all of its descendants."""
        body = self.bodies[root]
        draft = BodyDraft("", root, {root: body.link}, X_WO=body.X_WB)
        self.draft.bodies.append(draft)
        ground = next((j for j in at.get(root, ()) if WORLD in (j.parent, j.child)), None)
        if ground is not None:
            used.add(id(ground))
            if ground.draft.type == "fixed":
                draft.fixed = True
            else:
                draft.root, draft.fixed, draft.X_WO = "base", True, ground.frame(WORLD)
                draft.links = {"base": LinkDraft("base", mass=0.0), root: body.link}
                self.fasten(draft, ground, "base", root, Pose.of())
        elif self.pxr.UsdPhysics.RigidBodyAPI(body.prim).GetKinematicEnabledAttr().Get() is True:
            draft.fixed = True
            self.draft.changed(f"kinematic body `{root}`", "kinematic bodies are not supported, so the body is fixed")
        del left[root]
        todo = [root]
        while todo:
            here = todo.pop(0)
            for joint in at.get(here, ()):
                other = joint.child if joint.parent == here else joint.parent
                if id(joint) in used or other not in left or other == WORLD:
                    continue
                used.add(id(joint))
                self.fasten(draft, joint, here, other, self.bodies[here].X_BL.inverse() @ joint.frame(here))
                draft.links[other] = left.pop(other).link
                todo.append(other)
        self.rename(draft)

    def fasten(self, draft: BodyDraft, joint: UsdJoint, parent: str, child: str, X_PJ: Pose) -> None:
        """Attach a child to its parent, and move the frame of the child's link to the joint."""
        X_CJ, drafted = joint.frame(child), joint.draft
        X_CL = Pose.of(X_CJ.p) if drafted.type != "fixed" else Pose.of()
        self.bodies[child].X_BL = X_CL
        # If body0 is the child, the axis is reversed so that the joint coordinate is preserved.
        drafted.axis = X_CJ.rotation @ drafted.axis * (-1.0 if joint.child == parent else 1.0)
        drafted.parent, drafted.child = parent, child
        drafted.X_PC = X_PJ @ (X_CL.inverse() @ X_CJ).inverse()
        for part in self.bodies[child].link.parts:
            part.X_LG = X_CL.inverse() @ part.X_LG
        if joint.others:
            self.fasten_axes(draft, joint, X_CJ.rotation)
            return
        if drafted.type in ("revolute", "continuous", "prismatic"):
            drafted.position = self.position(draft, drafted)
        draft.joints.append(drafted)

    def fasten_axes(self, draft: BodyDraft, joint: UsdJoint, R_CJ: Array) -> None:
        """Attach a child to its parent with several axes. If body0 is the child, the axes act in reverse order."""
        first, is_reversed = joint.draft, joint.child == joint.draft.parent
        X_WJ = [
            (draft.X_WO if body is None else body.X_WB) @ frame
            for body, frame in ((self.bodies.get(joint.parent), joint.X_0), (self.bodies.get(joint.child), joint.X_1))
        ]
        moved = X_WJ[0].inverse() @ X_WJ[1]
        turn = moved.rotation  # about X, then Y, then Z
        beta = math.asin(float(np.clip(turn[0, 2], -1.0, 1.0)))
        angles = math.atan2(-turn[1, 2], turn[2, 2]), beta, math.atan2(-turn[0, 1], turn[0, 0])
        axes = [first, *joint.others]
        for axis in axes:
            k = "XYZ".index(axis.name[-1])
            value = float(moved.p[k]) if axis.type == "prismatic" else angles[k]
            axis.position = 0.0 if abs(value) < AT_ZERO else value
            if axis is not first:
                axis.axis = R_CJ @ axis.axis * (-1.0 if is_reversed else 1.0)
                axis.parent, axis.child = first.parent, first.child
        ordered = axes[::-1] if is_reversed else axes
        X_PC = first.X_PC
        for axis in ordered:
            axis.X_PC = Pose.of()
        ordered[0].X_PC = X_PC
        draft.joints += ordered

    def position(self, draft: BodyDraft, joint: JointDraft) -> float:
        """Return the current position of a joint.

        This is the motion of its child along the axis, relative to the zero position.
        """
        parent, child = self.bodies.get(joint.parent), self.bodies[joint.child]
        X_WP = draft.X_WO if parent is None else parent.X_WB @ parent.X_BL
        moved = joint.X_PC.inverse() @ X_WP.inverse() @ child.X_WB @ child.X_BL
        axis = joint.axis / np.linalg.norm(joint.axis)
        if joint.type == "prismatic":
            value = float(moved.p @ axis)
        else:
            value = (moved.angle_about(axis) + math.pi) % (2 * math.pi) - math.pi
        return 0.0 if abs(value) < AT_ZERO else value

    def rename(self, draft: BodyDraft) -> None:
        """Rename an object, its links and its joints after their prims.

        Before this step, these elements are identified by path because prim names are not unique.
        """
        bodies = [path for path in draft.links if path in self.bodies]
        names = {"base": "base"}
        for path in bodies:
            names[path] = free_name(self.bodies[path].prim.GetName(), list(names.values()))
        draft.name = self.draft.free_name(self.object_name(bodies))
        for path, link in draft.links.items():
            link.name = names[path]
            if (body := self.bodies.get(path)) is not None:
                self.mounts[path] = (draft, link.name, body.X_WB @ body.X_BL)
        draft.links, draft.root = {link.name: link for link in draft.links.values()}, names[draft.root]
        taken: set[str] = set()
        for joint in draft.joints:
            joint.parent, joint.child = names[joint.parent], names[joint.child]
            joint.name = free_name(joint.name.rpartition("/")[2], taken)
            taken.add(joint.name)

    def object_name(self, paths: list[str]) -> str:
        """Return a name for an object.

        An object with several bodies is named after their common parent prim, unless that is the stage root. Any other
        object is named after its first body.
        """
        first, *others = paths
        shared = posixpath.commonpath([posixpath.dirname(first), *others]).rpartition("/")[2]
        return shared if shared and others else str(self.bodies[first].prim.GetName())

    def colliders(self, body: UsdBody) -> list[Any]:
        """Return all collider prims that belong to a rigid body."""
        below = self.pxr.Usd.PrimRange(body.prim, self.pxr.Usd.TraverseInstanceProxies())
        return [prim for prim in below if is_collider(self.pxr, prim) and self.owner(prim) is body]
