"""Packages of models for meshes, poses, parts, videos and images, as in :mod:`tests.models.stub_packages`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from tests.models import truth
from tests.models.stub_packages import _Loadable, _module, tensor
from tests.models.truth import HEIGHT, WIDTH

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
