"""All tasks that models solve, by name."""

from __future__ import annotations

from collections.abc import Mapping

from simfoundry.models.contract import ModelTask
from simfoundry.models.tasks.depth import COMPLETE_DEPTH, DEPTH, MULTIVIEW, STEREO
from simfoundry.models.tasks.images import EDIT, INPAINT, INPAINT_VIDEO
from simfoundry.models.tasks.masks import SEGMENT, TRACK
from simfoundry.models.tasks.meshes import ARTICULATE, MESHING, PARTS
from simfoundry.models.tasks.poses import POSE
from simfoundry.models.tasks.scenes import READ_SCENE
from simfoundry.models.tasks.splats import SPLAT, SPLAT_IMAGE

TASKS: Mapping[str, ModelTask] = {task.name: task for task in (
    DEPTH, MULTIVIEW, STEREO, COMPLETE_DEPTH, SEGMENT, TRACK, INPAINT, INPAINT_VIDEO, EDIT, MESHING, PARTS, ARTICULATE,
    POSE, READ_SCENE, SPLAT, SPLAT_IMAGE,
)}  # fmt: skip
