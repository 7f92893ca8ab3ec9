"""Open the model that is configured for a task, or the offline method where there is one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal, overload

from simfoundry.models.client import ModelClient
from simfoundry.models.contract import ModelError
from simfoundry.models.offline import OfflineDepth, OfflineImages, OfflineMasks, OfflineMeshes
from simfoundry.models.offline_splats import OfflineSplats
from simfoundry.models.provenance import provider_identity, require_commercial
from simfoundry.models.setup import ModelSetup, variable
from simfoundry.models.tasks.depth import BundleDepth, DepthCompletionModel, DepthModel, MultiviewModel, StereoModel
from simfoundry.models.tasks.images import BundleImages, ImageEditingModel, InpaintingModel, VideoInpaintingModel
from simfoundry.models.tasks.masks import BundleMasks, SegmentationModel, TrackingModel
from simfoundry.models.tasks.meshes import ArticulationModel, BundleMeshes, MeshModel, PartModel
from simfoundry.models.tasks.poses import BundlePoses, PoseModel
from simfoundry.models.tasks.scenes import BundleScenes, SceneModel
from simfoundry.models.tasks.splats import BundleSplats, SplatModel, SplatRenderer
from simfoundry.spec.project import MARKER

if TYPE_CHECKING:
    from simfoundry.models.vlm import Vlm

# The client of each task.
_CLIENTS: Mapping[str, Callable[[ModelClient], Any]] = {
    **dict.fromkeys(("depth", "multiview", "stereo", "complete_depth"), BundleDepth),
    **dict.fromkeys(("segment", "track"), BundleMasks),
    **dict.fromkeys(("inpaint", "inpaint_video", "edit"), BundleImages),
    **dict.fromkeys(("mesh", "parts", "articulate"), BundleMeshes),
    "pose": BundlePoses,
    "read_scene": BundleScenes,
    **dict.fromkeys(("splat", "splat_image"), BundleSplats),
}

# The methods that need no model.
OFFLINE: Mapping[str, tuple[Callable[[], Any], str]] = {
    "stereo": (OfflineDepth, "semi-global matching"),
    "complete_depth": (OfflineDepth, "continuation of the surfaces around a hole"),
    "segment": (OfflineMasks, "GrabCut from boxes or points; phrases need a model"),
    "track": (OfflineMasks, "optical flow"),
    "inpaint": (OfflineImages, "Telea's method"),
    "inpaint_video": (OfflineImages, "Telea's method, frame by frame"),
    "parts": (OfflineMeshes, "pieces that are not connected"),
    "splat_image": (OfflineSplats, "rasterization on a CPU"),
}

# The tasks that a provider's vision-language model can solve.
VLM_TASKS = ("read_scene", "articulate")

# What does the work of the other tasks without a model, as advice.
ADVICE: Mapping[str, str] = {
    "depth": "use a capture with measured depth or a stereo pair",
    "multiview": "use a capture with measured depth",
    "mesh": "`simfoundry capture` fits shapes to measured depth without a model",
    "pose": "`simfoundry capture` fits poses to measured depth without a model",
    "articulate": "state joints with `simfoundry articulate MESH --joint`",
    "read_scene": "`simfoundry capture` names objects by color and shape without a model",
}


@overload
def open_model(setup: ModelSetup, task: Literal["depth"]) -> DepthModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["multiview"]) -> MultiviewModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["stereo"]) -> StereoModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["complete_depth"]) -> DepthCompletionModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["segment"]) -> SegmentationModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["track"]) -> TrackingModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["inpaint"]) -> InpaintingModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["inpaint_video"]) -> VideoInpaintingModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["edit"]) -> ImageEditingModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["mesh"]) -> MeshModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["parts"]) -> PartModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["articulate"]) -> ArticulationModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["pose"]) -> PoseModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["read_scene"]) -> SceneModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["splat"]) -> SplatModel: ...
@overload
def open_model(setup: ModelSetup, task: Literal["splat_image"]) -> SplatRenderer: ...
def open_model(setup: ModelSetup, task: str) -> Any:
    """Return the model that is configured for a task; see the protocols in :mod:`simfoundry.models.tasks`.

    Nothing is loaded and no server is contacted before the model is used.

    Raises:
        ModelError: If no model is configured and there is no offline method, or if the configuration cannot be used.
    """
    source = setup.source(task)
    if source is None or source.offline:
        if task in OFFLINE:
            return OFFLINE[task][0]()
        advice = f"; {ADVICE[task]}" if task in ADVICE else ""
        raise ModelError(
            f"`{task}` needs a model: set {variable(task)} to the URL of a server, or add `{task}` under "
            f"`models: tasks:` in {MARKER}{advice}"
        )
    if source.vlm is not None:
        if task != "read_scene":
            hint = "; `simfoundry articulate MESH` uses it" if task in VLM_TASKS else ""
            raise ModelError(f"`vlm` can be configured for {' and '.join(VLM_TASKS)} only, not for `{task}`{hint}")
        from simfoundry.models.vlm_scenes import VlmScenes

        vlm = open_provider(setup, task)
        assert vlm is not None
        return VlmScenes(vlm)
    return _CLIENTS[task](setup.client(task))


def open_provider(setup: ModelSetup, task: str) -> Vlm | None:
    """Return the vision-language model of a provider that is configured for a task, or None if there is none.

    Raises:
        ModelError: If it cannot be used, or may not be used commercially although this is required; such models need an
            entry in `accepted`.
    """
    source = setup.source(task)
    if source is None or source.vlm is None:
        return None
    from simfoundry.models.vlm import VlmError

    try:
        return open_vlm(setup, source.vlm)
    except VlmError as error:
        raise ModelError(str(error)) from None


def open_vlm(setup: ModelSetup, name: str, base_url: str | None = None) -> Vlm:
    """Return the vision-language model of a provider, or of the server at ``base_url``.

    Raises:
        VlmError: If it cannot be used.
        ModelError: If it may not be used commercially although this is required; such models need an entry in
            `accepted`.
    """
    from simfoundry.models.vlm import Vlm

    vlm = Vlm(name, base_url)
    if setup.commercial_only and vlm.name not in setup.accepted:
        require_commercial(provider_identity(vlm.name), setup.accepted)
    return vlm
