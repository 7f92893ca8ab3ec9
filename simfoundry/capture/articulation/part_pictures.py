"""Pictures for naming the moving parts of a mesh: its numbered segments, and its parts in motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simfoundry.assets.mesh import MeshPart
from simfoundry.capture.articulation.mesh_asset import BODY, joined, link_frames, link_pieces
from simfoundry.capture.articulation.placed_joints import PartJoint
from simfoundry.capture.articulation.segments import SegmentedMesh
from simfoundry.geometry.frames import IDENTITY, Pose, frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.render.montage import Image, overlay, side_by_side
from simfoundry.render.raycast import quick_image, raycast
from simfoundry.render.views import MARGIN, VIEW_DEG, Orbit, orbit_camera
from simfoundry.scene.model import Camera, Joint, JointType, Link, Scene, SceneObject, Visual
from simfoundry.scene.state import SceneState

# Size of one view [px]; a model reads the numbers on segments of a twentieth of it.
WIDTH, HEIGHT = 400, 340

# Azimuth and elevation of each view [deg]; 0 faces the front, and negative azimuths are to the left of it.
VIEWS = {
    "front": (0.0, 10.0),
    "from the left": (-50.0, 20.0),
    "from the right": (50.0, 20.0),
    "from above": (0.0, 60.0),
}

# Shares of the travel that show a motion, and an angle at which a knob shows that it turns [rad].
SHARES = (0.0, 1 / 3, 2 / 3, 1.0)
KNOB = 1.5

# Fewest pixels of a segment in a view in which its number is written.
LEAST_PIXELS = 60

NO_GRAVITY = frozen_array([0.0, 0.0, 0.0])
GRAY = (0.75, 0.75, 0.75, 1.0)


def plain_picture(mesh: SegmentedMesh) -> Image:
    """Return views of a mesh in its own colors."""
    scene = Scene("mesh", NO_GRAVITY, (_still("body", mesh.pieces),))
    return side_by_side([(name, quick_image(scene, camera)) for name, camera in _cameras(mesh).items()], columns=2)


def segment_picture(mesh: SegmentedMesh) -> Image:
    """Return views of a mesh in which each segment has a color and its number."""
    items = [_still(f"s{segment.number}", segment.pieces) for segment in mesh.segments]
    if mesh.rest:
        items.append(_still("rest", mesh.rest))
    scene = Scene("segments", NO_GRAVITY, tuple(items))
    shown = []
    for name, camera in _cameras(mesh).items():
        seen = raycast(scene, camera)
        labels = np.where(seen.objects > len(mesh.segments), 0, seen.objects)
        shown.append((name, _numbered(overlay(seen.color, labels), labels)))
    return side_by_side(shown, columns=2)


def motion_picture(mesh: SegmentedMesh, joints: Sequence[PartJoint]) -> Image:
    """Return one row for each joint, in which its part moves from where it is to the end of its travel."""
    item = jointed_object(mesh, joints)
    scene = Scene("motion", NO_GRAVITY, (item,))
    camera = _camera(mesh, *VIEWS["from the left" if _opens_left(joints) else "from the right"], reach=1.5)
    panels = []
    for joint in joints:
        for share in SHARES:
            reach = KNOB if joint.type == "continuous" else max(joint.lower, joint.upper, key=abs)
            state = SceneState.of({item.name: IDENTITY}, {f"{item.name}.{joint.name}": share * reach})
            panels.append((f"{joint.name}, {share:.0%}", quick_image(scene, camera, state)))
    return side_by_side(panels, columns=len(SHARES))


def jointed_object(mesh: SegmentedMesh, joints: Sequence[PartJoint]) -> SceneObject:
    """Return the object with its joints for rendering. Its masses are placeholders."""
    starts, pieces = link_frames(joints), link_pieces(mesh, joints)
    parents = {joint.name: joint.parent or BODY for joint in joints}
    ordered = [BODY]
    while len(ordered) < len(pieces):  # parents first
        ordered += [name for name, parent in parents.items() if parent in ordered and name not in ordered]
    moving = []
    for joint in joints:
        parent = joint.parent or BODY
        X_PC = Pose.of(starts[joint.name] - starts[parent])
        moving.append(Joint(joint.name, JointType(joint.type), parent, joint.name, X_PC, frozen_array(joint.axis)))
    links = tuple(_link(name, pieces[name], Pose.of(-starts[name])) for name in ordered)
    return SceneObject("thing", "", True, IDENTITY, links, tuple(moving))


def _still(name: str, pieces: Sequence[MeshPart]) -> SceneObject:
    return SceneObject(name, "", True, IDENTITY, (_link(BODY, pieces, IDENTITY),))


def _link(name: str, pieces: Sequence[MeshPart], X_LG: Pose) -> Link:
    visuals = []
    for k, piece in enumerate(joined(pieces)):
        mesh = Mesh(frozen_array(piece.vertices), piece.faces, piece.uv, piece.texture)
        color = (1.0, 1.0, 1.0, 1.0) if piece.texture is not None else piece.rgba or GRAY
        visuals.append(Visual(f"{name}_{k}", mesh, frozen_array(color), X_LG))
    return Link(name, 1.0, frozen_array(np.zeros(3)), frozen_array(np.eye(3)), tuple(visuals), ())


def _cameras(mesh: SegmentedMesh) -> dict[str, Camera]:
    return {name: _camera(mesh, *angles) for name, angles in VIEWS.items()}


def _camera(mesh: SegmentedMesh, azimuth_deg: float, elevation_deg: float, reach: float = 1.0) -> Camera:
    """Return a camera that shows a sphere around the mesh, which is ``reach`` times as large as the mesh."""
    low, high = mesh.bounds
    radius = reach * float(np.linalg.norm(high - low)) / 2
    distance = MARGIN * radius / float(np.sin(np.radians(VIEW_DEG / 2)))
    return orbit_camera((low + high) / 2, Orbit(azimuth_deg, elevation_deg, distance), WIDTH, HEIGHT)


def _opens_left(joints: Sequence[PartJoint]) -> bool:
    """Return True if the picture is best taken from the left, because hinges are on the right."""
    return sum(joint.origin[1] for joint in joints if joint.type == "revolute") > 0


def _numbered(image: Image, labels: np.ndarray) -> Image:
    """Write the number of each segment on its pixel that is farthest from its outline."""
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont
    from scipy import ndimage

    picture = Pillow.fromarray(image)
    draw = ImageDraw.Draw(picture)
    for label in np.unique(labels[labels > 0]):
        mask = np.pad(labels == label, 1)
        if mask.sum() < LEAST_PIXELS:
            continue
        inner = ndimage.distance_transform_edt(mask)[1:-1, 1:-1]
        row, column = np.unravel_index(int(inner.argmax()), inner.shape)
        font = ImageFont.load_default(float(np.clip(inner.max(), 11, 22)))
        draw.text((int(column), int(row)), str(label), "white", font, "mm", stroke_width=2, stroke_fill="black")
    return np.asarray(picture, dtype=np.uint8)
