"""Requests as the inputs of networks, and their outputs as members of answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from simfoundry.models.contract import ModelError
from simfoundry.models.tasks.masks import SegmentationPrompt, bounding_boxes
from simfoundry.models.wire import Bundle, BundleImage, Content

Run = Callable[[Mapping[str, Any]], Mapping[str, Any]]
Shapes = Mapping[str, tuple[Any, ...]]

LAMA_SIDE = 512  # Width and height of LaMa's images [px], fixed in the file

SAM_SIDE = 1024  # Width and height of EfficientSAM's images [px], fixed in the file

SAM_POINTS = 6  # Number of points of EfficientSAM; unused ones have the label -1

# Labels of EfficientSAM's points. There is none for a point beside the object.
ON_OBJECT, TOP_LEFT, BOTTOM_RIGHT, UNUSED = 1, 2, 3, -1

# Mean and standard deviation of ImageNet, by which DA3 and many others normalize.
MEAN, DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])

DA3_SIDE = 504  # Longest side of DA3's images [px], its default; sides are multiples of its patches

DA3_PATCH = 14

DA3_FOCAL = 300.0  # Focal length of DA3's canonical camera [px]: meters = output * focal length / 300


def _image(request: Bundle) -> Any:
    image = request.members["image"]
    assert isinstance(image, BundleImage)
    return image.pixels


def _resized(array: Any, width: int, height: int, is_smooth: bool = True) -> Any:
    import cv2

    return cv2.resize(array, (width, height), interpolation=cv2.INTER_LINEAR if is_smooth else cv2.INTER_NEAREST)


def _planes(image: Any) -> Any:
    """Return an image (H, W, 3) as a batch of planes (1, 3, H, W) in single precision."""
    return np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32)


def complete_lama(request: Bundle, run: Run, _: Shapes) -> dict[str, Content]:
    """Fill a mask by LaMa: RGB in 0 to 1 and a mask of 0 and 1 become RGB in 0 to 255."""
    image, mask = _image(request), request.members["mask"]
    assert isinstance(mask, np.ndarray)
    height, width = mask.shape
    small = _resized(image, LAMA_SIDE, LAMA_SIDE).astype(np.float32) / 255
    # A hole keeps all pixels that belong to it in part, so that nothing of the object remains at its edge.
    hole = _resized(mask.astype(np.float32), LAMA_SIDE, LAMA_SIDE) > 0
    filled = next(iter(run({"image": _planes(small), "mask": hole[None, None].astype(np.float32)}).values()))
    if filled.shape != (1, 3, LAMA_SIDE, LAMA_SIDE):
        raise ModelError(f"lama returned an image of the shape {filled.shape}; is the file the right one?")
    result = _resized(np.clip(filled[0].transpose(1, 2, 0), 0, 255).astype(np.float32), width, height)
    return {"image": BundleImage(np.where(mask[..., None], np.rint(result), image).astype(np.uint8))}


def segment_efficientsam(request: Bundle, run: Run, shapes: Shapes) -> dict[str, Content]:
    """Find objects by EfficientSAM from boxes, or one object from points."""
    prompt = SegmentationPrompt.model_validate(request.head["parameters"])
    if prompt.phrases:
        raise ModelError("efficientsam-ti finds objects by boxes or points; phrases need another model for `segment`")
    image = _image(request)
    height, width = image.shape[:2]
    planes = _planes(_resized(image, SAM_SIDE, SAM_SIDE).astype(np.float32) / 255)
    queries = [([(b[0], b[1], TOP_LEFT), (b[2], b[3], BOTTOM_RIGHT)], k) for k, b in enumerate(prompt.boxes)]
    on = [(u, v, ON_OBJECT) for u, v, is_on in prompt.points if is_on]
    beside = [(u, v) for u, v, is_on in prompt.points if not is_on]
    if prompt.points and not 0 < len(on) <= SAM_POINTS:
        raise ModelError(f"efficientsam-ti needs 1 to {SAM_POINTS} points on the object, not {len(on)}")
    queries += [(on, 0)] if on else []
    masks, scores, prompts = [], [], []
    for points, number in queries:
        rows = np.array([*points, *[(0, 0, UNUSED)] * (SAM_POINTS - len(points))], np.float32)
        corners = rows[:, :2] * [SAM_SIDE / width, SAM_SIDE / height]
        labels = rows[:, 2].reshape((1, 1, SAM_POINTS, 1)[: len(shapes["batched_point_labels"])])
        found = run({
            "batched_images": planes, "batched_point_coords": corners[None, None].astype(np.float32),
            "batched_point_labels": labels.astype(np.float32),
        })  # fmt: skip
        for k in np.argsort(-found["iou_predictions"][0, 0]):
            logits = found["output_masks"][0, 0, k].astype(np.float32)
            mask = _resized((logits >= 0).astype(np.uint8), width, height, is_smooth=False) > 0
            if mask.any() and not any(mask[min(int(v), height - 1), min(int(u), width - 1)] for u, v in beside):
                masks.append(mask)
                scores.append(float(np.clip(found["iou_predictions"][0, 0, k], 0, 1)))
                prompts.append(number)
                break
    stack = np.array(masks, bool).reshape(-1, height, width)
    return {
        "masks": stack, "boxes": bounding_boxes(stack), "scores": np.array(scores, np.float32),
        "prompts": np.array(prompts, np.int32),
    }  # fmt: skip


def depth_da3(request: Bundle, run: Run, shapes: Shapes) -> dict[str, Content]:
    """Estimate depth by DA3's metric model, whose output is in units of a focal length of 300 px."""
    K = request.members.get("K")
    if not isinstance(K, np.ndarray):
        raise ModelError("da3metric-large needs the intrinsic matrix of the image, because its depth scales with it")
    image = _image(request)
    height, width = image.shape[:2]
    (name, shape), *others = shapes.items()
    if others or len(shape) not in (4, 5) or shape[-3] not in (3, "3"):
        raise ModelError(f"the file is not da3metric-large: it has the inputs {dict(shapes)}, not one image")
    factor = DA3_SIDE / max(width, height)
    sides = [max(DA3_PATCH, round(side * factor / DA3_PATCH) * DA3_PATCH) for side in (height, width)]
    rows, columns = (size if isinstance(size, int) else side for size, side in zip(shape[-2:], sides, strict=True))
    normalized = (_resized(image, columns, rows) / 255.0 - MEAN) / DEVIATION
    outputs = run({name: _planes(normalized).reshape((1,) * (len(shape) - 3) + (3, rows, columns))})
    depth = next((value for key, value in outputs.items() if "depth" in key), next(iter(outputs.values())))
    depth = np.asarray(depth, np.float32).reshape(depth.shape[-2:])
    focal = (K[0, 0] * columns / width + K[1, 1] * rows / height) / 2
    meters = np.maximum(_resized(depth * np.float32(focal / DA3_FOCAL), width, height), 0)
    sky = next((np.asarray(value).reshape(depth.shape) for key, value in outputs.items() if "sky" in key), None)
    if sky is not None:
        meters = np.where(_resized(sky.astype(np.float32), width, height) > 0.5, 0, meters)
    return {"depth": meters.astype(np.float32), "K": K}
