"""Packages of models with their real names and parameters, which answer with the truth in the models' own conventions.

A call with another name of a parameter fails as it would in the real package. Which signatures were read in the source
of a package, and which follow descriptions, is listed in docs/models.md.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from tests.models import truth
from tests.models.truth import BOX, HEIGHT, MASK, POSES, WIDTH, K


class Tensor(np.ndarray):
    """An array with the methods of a tensor that servers call."""

    device = "cpu"

    def cpu(self) -> Tensor:
        return self

    cuda = float_ = cpu

    def to(self, *_: Any) -> Tensor:
        return self

    def float(self) -> Tensor:
        return self.astype(np.float32).view(Tensor)

    def permute(self, *axes: int) -> Tensor:
        return self.transpose(axes)


def tensor(values: Any) -> Any:
    return np.array(values).view(Tensor)


class _Context:
    def __init__(self, *_: Any, **__: Any) -> None: ...
    def __enter__(self) -> None: ...
    def __exit__(self, *_: Any) -> None: ...


class _Loadable:
    """A model as most packages have it."""

    device = "cpu"

    @classmethod
    def from_pretrained(cls, name: str, torch_dtype: Any = None) -> Any:
        assert "/" in name and torch_dtype in (None, "bfloat16")
        return cls()

    def to(self, *_: Any) -> Any:
        return self

    eval = cuda = to


def _module(name: str, **members: Any) -> tuple[str, ModuleType]:
    module = ModuleType(name)
    vars(module).update(members)
    return name, module


def torch() -> list[tuple[str, ModuleType]]:
    amp = SimpleNamespace(autocast=_Context)
    cuda = SimpleNamespace(is_available=lambda: False, amp=amp)
    return [_module("torch", inference_mode=_Context, cuda=cuda, as_tensor=tensor, float32="float32",
                    bfloat16="bfloat16", manual_seed=lambda seed: ("generator", seed),
                    load=lambda path, map_location=None, weights_only=True: {"model": "weights"})]  # fmt: skip


# -- transformers: SAM 3 and SAM 2 -------------------------------------------------------------------------------------


class Sam3Processor(_Loadable):
    def __call__(
        self, images: Any = None, text: Any = None, input_boxes: Any = None, input_boxes_labels: Any = None,
        return_tensors: Any = None,
    ) -> dict[str, Any]:  # fmt: skip
        assert images.size == (WIDTH, HEIGHT) and return_tensors == "pt" and (text is None) != (input_boxes is None)
        if input_boxes is not None:
            assert np.shape(input_boxes) == (1, 1, 4) and np.shape(input_boxes_labels) == (1, 1)
        return {"pixel_values": tensor(np.zeros((1, 3, 1008, 1008))), "text": text}

    def post_process_instance_segmentation(
        self, outputs: Any, threshold: float = 0.3, mask_threshold: float = 0.5, target_sizes: Any = None
    ) -> list[dict[str, Any]]:
        assert target_sizes == [(HEIGHT, WIDTH)]
        count = 0 if outputs == "unicorn" else 1
        one = {"scores": [0.9], "boxes": np.array([BOX], np.float32), "masks": MASK[None].astype(np.int64)}
        return [{name: tensor(values)[:count] for name, values in one.items()}]


class Sam3Model(_Loadable):
    def __call__(self, pixel_values: Any = None, text: Any = None) -> Any:
        return text


class Sam2VideoProcessor(_Loadable):
    def init_video_session(
        self, video: Any = None, inference_device: str = "cpu", processing_device: Any = None, dtype: Any = None
    ) -> Any:
        return SimpleNamespace(video=video, masks=None, has_run=False)

    def add_inputs_to_inference_session(
        self, inference_session: Any, frame_idx: int, obj_ids: Any, input_points: Any = None, input_labels: Any = None,
        input_boxes: Any = None, input_masks: Any = None, original_size: Any = None, clear_old_inputs: bool = True,
    ) -> None:  # fmt: skip
        assert frame_idx == 0 and len(obj_ids) == len(input_masks) and input_masks[0].shape == (HEIGHT, WIDTH)
        inference_session.masks = np.array(input_masks)

    def post_process_masks(
        self, masks: Any, original_sizes: Any, mask_threshold: float = 0.0, binarize: bool = True
    ) -> list[Any]:
        assert original_sizes == [[HEIGHT, WIDTH]] and masks[0].ndim == 4
        return [one > mask_threshold if binarize else one for one in masks]


class Sam2VideoModel(_Loadable):
    def __call__(self, inference_session: Any = None, frame_idx: Any = None) -> None:
        inference_session.has_run = True

    def propagate_in_video_iterator(self, inference_session: Any, start_frame_idx: Any = None) -> Any:
        if start_frame_idx is None and not inference_session.has_run:
            raise ValueError("Cannot determine the starting frame index; run inference on a frame with inputs first.")
        for k in range(len(inference_session.video)):
            logits = np.where(np.roll(inference_session.masks, k, axis=2), 8.0, -8.0)[:, None]
            yield SimpleNamespace(frame_idx=k, pred_masks=tensor(logits))


def transformers() -> list[tuple[str, ModuleType]]:
    return [_module("transformers", Sam3Processor=Sam3Processor, Sam3Model=Sam3Model, Sam2VideoModel=Sam2VideoModel,
                    Sam2VideoProcessor=Sam2VideoProcessor)]  # fmt: skip


# -- depth -------------------------------------------------------------------------------------------------------------

PROCESSED = (378, 504)  # rows and columns that 48 x 64 becomes at 504 px


def _processed(depth: Any) -> Any:
    rows, columns = (np.arange(size) * small // size for size, small in zip(PROCESSED, depth.shape, strict=True))
    return depth[rows][:, columns]


class DepthAnything3(_Loadable):
    @classmethod
    def from_pretrained(cls, name: str, torch_dtype: Any = None) -> Any:
        model = super().from_pretrained(name, torch_dtype)
        vars(model)["is_metric"] = name == "depth-anything/DA3METRIC-LARGE"
        return model

    def inference(
        self, image: Any, extrinsics: Any = None, intrinsics: Any = None, align_to_input_ext_scale: bool = True,
        infer_gs: bool = False, use_ray_pose: bool = False, ref_view_strategy: str = "saddle_balanced",
        process_res: int = 504, process_res_method: str = "upper_bound_resize", export_dir: Any = None,
        export_format: str = "mini_npz",
    ) -> Any:  # fmt: skip
        scale = PROCESSED[1] / WIDTH
        if vars(self)["is_metric"]:  # in units of a focal length of 300 px
            return SimpleNamespace(depth=_processed(truth.view()[1])[None] * 300 / (60 * scale), sky=None, conf=None)
        depths = np.array([_processed(truth.view(X)[1]) for X in POSES[: len(image)]])
        inner = np.array([np.diag([scale, scale, 1]) @ K] * len(image))
        return SimpleNamespace(depth=depths, extrinsics=POSES[: len(image), :3], intrinsics=inner, conf=5 * depths)


class MoGeModel(_Loadable):
    def infer(
        self, image: Any, num_tokens: Any = None, resolution_level: int = 9, force_projection: bool = True,
        apply_mask: bool = True, fov_x: Any = None, use_fp16: bool = True,
    ) -> dict[str, Any]:  # fmt: skip
        assert image.shape == (3, HEIGHT, WIDTH) and image.max() <= 1
        assert fov_x is None or abs(fov_x - 2 * np.degrees(np.arctan(WIDTH / 2 / 60))) < 1e-6
        depth = truth.view()[1].astype(np.float64)
        depth[:3] = np.inf
        normalized = np.diag([1 / WIDTH, 1 / HEIGHT, 1]) @ K
        return {"depth": tensor(depth), "mask": tensor(np.isfinite(depth)), "intrinsics": tensor(normalized)}


class PriorDepthAnything:
    def __init__(
        self, device: str = "cuda:0", version: str = "1.1", mde_path: Any = None, ckpt_path: Any = None,
        frozen_model_size: Any = None, conditioned_model_size: Any = None, coarse_only: bool = False,
    ) -> None: ...  # fmt: skip

    def infer_one_sample(
        self, image: Any = None, prior: Any = None, geometric: Any = None, pattern: Any = None,
        double_global: bool = False, prior_cover: bool = False, visualize: bool = False,
    ) -> Any:  # fmt: skip
        assert Path(image).is_file() and (np.load(prior)[MASK] == 0).all() and np.load(prior).dtype == np.float32
        return tensor(truth.view()[1])


class FoundationStereo(_Loadable):
    def __init__(self, args: Any) -> None:
        assert args["vit_size"] == "vitl"

    def load_state_dict(self, weights: Any) -> None:
        assert weights == "weights"

    def forward(self, image1: Any, image2: Any, iters: int = 12, flow_init: Any = None, test_mode: bool = False) -> Any:
        assert image1.shape == (1, 3, 64, 64) and image1.max() > 1 and test_mode  # 0 to 255, padded to 32
        disparity = np.pad(60 * truth.BASELINE / truth.view()[1], ((8, 8), (0, 0)))
        return tensor(disparity[None, None])

    def run_hierachical(
        self, image1: Any, image2: Any, iters: int = 12, test_mode: bool = False, small_ratio: float = 0.5
    ) -> Any:
        raise AssertionError("only for large images")


class InputPadder:
    def __init__(self, dims: Any, mode: str = "sintel", divis_by: int = 8, force_square: bool = False) -> None:
        assert divis_by == 32 and tuple(dims[-2:]) == (HEIGHT, WIDTH)

    def pad(self, *inputs: Any) -> list[Any]:
        return [tensor(np.pad(x, ((0, 0), (0, 0), (8, 8), (0, 0)))) for x in inputs]

    def unpad(self, x: Any) -> Any:
        return x[..., 8:-8, :]


class InferenceSession:
    """onnxruntime's, for c-foundationstereo-s at a fixed size."""

    def __init__(self, path: str, providers: Any = None) -> None: ...

    def get_inputs(self) -> list[Any]:
        return [SimpleNamespace(name=f"{side}_image", shape=[1, 3, 96, 128]) for side in ("right", "left")]

    def run(self, outputs: Any, inputs: Any) -> list[Any]:
        assert inputs["left_image"].shape == (1, 3, 96, 128) and abs(inputs["left_image"]).max() < 3
        disparity = 60 * truth.BASELINE / truth.view()[1]
        return [2 * np.repeat(np.repeat(disparity, 2, 0), 2, 1)[None].astype(np.float32)]  # in its own pixels


def depths() -> list[tuple[str, ModuleType]]:
    config = SimpleNamespace(load=lambda path: {}, create=dict)
    return [
        _module("depth_anything_3"), _module("depth_anything_3.api", DepthAnything3=DepthAnything3), _module("moge"),
        _module("moge.model"), _module("moge.model.v2", MoGeModel=MoGeModel), _module("core"), _module("core.utils"),
        _module("prior_depth_anything", PriorDepthAnything=PriorDepthAnything), _module("omegaconf", OmegaConf=config),
        _module("core.foundation_stereo", FoundationStereo=FoundationStereo),
        _module("core.utils.utils", InputPadder=InputPadder),
        _module("onnxruntime", InferenceSession=InferenceSession, get_available_providers=lambda: ["CPU"]),
    ]  # fmt: skip


# -- meshes and poses --------------------------------------------------------------------------------------------------


def _box() -> Any:
    import trimesh

    return trimesh.creation.box((0.2, 0.1, 0.3))


class Hunyuan3DDiTFlowMatchingPipeline(_Loadable):
    def __call__(
        self, image: Any = None, num_inference_steps: int = 50, timesteps: Any = None, sigmas: Any = None,
        eta: float = 0.0, guidance_scale: float = 7.5, generator: Any = None, box_v: float = 1.01,
        octree_resolution: int = 384, mc_level: float = 0.0, mc_algo: Any = None, num_chunks: int = 8000,
        output_type: str = "trimesh", enable_pbar: bool = True,
    ) -> list[Any]:  # fmt: skip
        assert image.mode == "RGBA" and output_type == "trimesh" and generator[0] == "generator"
        return [_box()]


class Hunyuan3DPaintConfig:
    def __init__(self, max_num_view: int, resolution: int) -> None: ...


class Hunyuan3DPaintPipeline:
    def __init__(self, config: Hunyuan3DPaintConfig) -> None: ...

    def __call__(
        self, mesh_path: Any = None, image_path: Any = None, output_mesh_path: Any = None, use_remesh: bool = True,
        save_glb: bool = True,
    ) -> str:  # fmt: skip
        assert Path(image_path).is_file() and output_mesh_path.endswith(".obj") and save_glb
        shutil.copy(mesh_path, Path(output_mesh_path).with_suffix(".glb"))
        return str(output_mesh_path)


class Trellis2ImageTo3DPipeline(_Loadable):
    def run(
        self, image: Any, num_samples: int = 1, seed: int = 42, preprocess_image: bool = True,
        return_latent: bool = False, pipeline_type: Any = None,
    ) -> list[Any]:  # fmt: skip
        assert image.mode == "RGBA"
        names = dict.fromkeys(("vertices", "faces", "attrs", "coords", "layout"), "x")
        return [SimpleNamespace(**names, voxel_size=1 / 512, simplify=lambda faces: None)]


def to_glb(
    vertices: Any, faces: Any, attr_volume: Any, coords: Any, attr_layout: Any, aabb: Any, voxel_size: Any = None,
    grid_size: Any = None, decimation_target: int = 1_000_000, texture_size: int = 2048, remesh: bool = False,
    remesh_band: float = 1, remesh_project: float = 0.9, verbose: bool = False, use_tqdm: bool = False,
) -> Any:  # fmt: skip
    return _box()


class Inference:
    def __init__(self, config_file: str, compile: bool = False) -> None:  # noqa: A002
        assert config_file.endswith("pipeline.yaml")

    def __call__(self, image: Any, mask: Any, seed: Any = None, pointmap: Any = None) -> dict[str, Any]:
        assert image.shape == (HEIGHT, WIDTH, 3) and mask.dtype == bool and mask.shape == (HEIGHT, WIDTH)
        return {"glb": _box(), "gs": None, "rotation": None, "translation": None, "scale": None}


class FoundationPose:
    def __init__(
        self, model_pts: Any, model_normals: Any, symmetry_tfs: Any = None, mesh: Any = None, scorer: Any = None,
        refiner: Any = None, glctx: Any = None, debug: int = 0, debug_dir: str = "",
    ) -> None:  # fmt: skip
        assert np.allclose(np.ptp(model_pts, axis=0), (0.2, 0.1, 0.3)), "the axes of the file, in meters"
        self.scores: Any = []

    def register(
        self, K: Any, rgb: Any, depth: Any, ob_mask: Any, ob_id: Any = None, glctx: Any = None, iteration: int = 5
    ) -> Any:
        assert (
            rgb.dtype == np.uint8 and depth.dtype == np.float32 and K.shape == (3, 3) and ob_mask.shape == depth.shape
        )
        self.scores = tensor([3.5, 1.0])
        return truth.OBJECT_TO_CAMERA


def meshes() -> list[tuple[str, ModuleType]]:
    paint = {"Hunyuan3DPaintConfig": Hunyuan3DPaintConfig, "Hunyuan3DPaintPipeline": Hunyuan3DPaintPipeline}
    return [
        _module("hy3dshape"), _module("textureGenPipeline", **paint), _module("trellis2"), _module("nvdiffrast"),
        _module("hy3dshape.pipelines", Hunyuan3DDiTFlowMatchingPipeline=Hunyuan3DDiTFlowMatchingPipeline),
        _module("trellis2.pipelines", Trellis2ImageTo3DPipeline=Trellis2ImageTo3DPipeline),
        _module("o_voxel", postprocess=SimpleNamespace(to_glb=to_glb)), _module("inference", Inference=Inference),
        _module("nvdiffrast.torch", RasterizeCudaContext=object),
        _module("estimater", FoundationPose=FoundationPose, ScorePredictor=object, PoseRefinePredictor=object),
    ]  # fmt: skip


# -- parts, videos, images ---------------------------------------------------------------------------------------------


class AutoMask:
    def __init__(
        self, ckpt_path: Any = None, point_num: int = 100_000, prompt_num: int = 400, threshold: float = 0.95,
        post_process: bool = True,
    ) -> None: ...  # fmt: skip

    def predict_aabb(
        self, mesh: Any, point_num: Any = None, prompt_num: Any = None, threshold: Any = None, post_process: Any = None,
        save_path: Any = None, save_mid_res: bool = False, show_info: bool = True, clean_mesh_flag: bool = True,
        seed: int = 42, is_parallel: bool = True, prompt_bs: int = 32,
    ) -> tuple[Any, Any, Any]:  # fmt: skip
        import trimesh

        cleaned = trimesh.Trimesh(mesh.vertices, mesh.faces[::-1], process=False)  # another order of the triangles
        return None, np.array([7, 7, -1, 3])[: len(cleaned.faces)], cleaned


def segment_mesh(
    filename: Any, config: Any, visualize: bool = False, extension: str = "glb", target_labels: Any = None,
    texture: bool = False,
) -> Any:  # fmt: skip
    import trimesh

    mesh = trimesh.load(filename, force="mesh", process=False)
    out = Path(config.output) / Path(filename).stem
    out.mkdir(parents=True)
    (out / f"{Path(filename).stem}_face2label.json").write_text(
        json.dumps({k: 5 + k % 2 for k in range(len(mesh.faces))})
    )
    return mesh


class AgglomerativeClustering:
    def __init__(self, n_clusters: int = 2, *, connectivity: Any = None) -> None: ...

    def fit(self, features: Any) -> Any:
        return SimpleNamespace(labels_=(features[:, 0] > 0).astype(int))


class QwenImageEditPipeline(_Loadable):
    def __call__(
        self, image: Any = None, prompt: Any = None, negative_prompt: Any = None, true_cfg_scale: float = 4.0,
        height: Any = None, width: Any = None, num_inference_steps: int = 50, guidance_scale: Any = None,
        generator: Any = None,
    ) -> Any:  # fmt: skip
        assert image.mode == "RGB" and prompt and generator[0] == "generator"
        return SimpleNamespace(images=[image.resize((96, 80))])


def _write(path: Any, frames: Any, fps: int) -> None:
    with Path(path).open("wb") as stream:
        np.save(stream, frames)


def others() -> list[tuple[str, ModuleType]]:
    video = {"imwrite": _write, "imread": lambda path: np.load(Path(path).open("rb"))}  # noqa: SIM115
    config = SimpleNamespace(load=lambda path: SimpleNamespace(cache="", output=""))
    return [
        _module("auto_mask", AutoMask=AutoMask), _module("samesh"), _module("samesh.models"), _module("sklearn"),
        _module("samesh.models.sam_mesh", segment_mesh=segment_mesh), _module("omegaconf", OmegaConf=config),
        _module("sklearn.cluster", AgglomerativeClustering=AgglomerativeClustering), _module("imageio"),
        _module("imageio.v3", **video), _module("diffusers", QwenImageEditPipeline=QwenImageEditPipeline),
    ]  # fmt: skip
