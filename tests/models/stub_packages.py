"""Packages of models with their real names and parameters, which answer with the truth in the models' own conventions.

A call with another name of a parameter fails as it would in the real package. Which signatures were read in the source
of a package, and which follow descriptions, is listed in docs/models.md.
"""

from __future__ import annotations

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
