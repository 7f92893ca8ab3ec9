"""The known ONNX models, and the way to them: like a server, they receive a bundle and answer with one.

An answer thus passes the same checks as one from elsewhere, and can be recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.models.contract import ModelError, plain
from simfoundry.models.onnx.networks import complete_lama, depth_da3, segment_efficientsam
from simfoundry.models.provenance import licences
from simfoundry.models.wire import ANSWER, REQUEST, VERSION, Bundle, BundleError, Content, read_bundle, write_bundle
from simfoundry.runtime.extras import need_extra

# Runs a network: takes arrays by name of the input, and returns arrays by name of the output.
Run = Callable[[Mapping[str, Any]], Mapping[str, Any]]


@dataclass(frozen=True)
class OnnxNetwork:
    """A network that is distributed as an ONNX file.

    Attributes:
        name: Name of the model, as in the table of licences.
        task: Task that it solves.
        file: Name of the file.
        megabytes: Size of the file [MB].
        inputs: Names of its inputs.
        outputs: Names of its outputs that are used.
        solve: Function that turns a request into the members of an answer.
    """

    name: str
    task: str
    file: str
    megabytes: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    solve: Callable[[Bundle, Run, Mapping[str, tuple[Any, ...]]], dict[str, Content]]

    @property
    def version(self) -> str:
        """The file name without its suffix."""
        return self.file.removesuffix(".onnx")

    def how_to_get(self) -> str:
        """Return where the weights come from, as a clause of a message."""
        entry = licences()[self.name]
        return f"download {self.file} ({self.megabytes:g} MB, {entry.weights}) from {entry.source}"


NETWORKS: Mapping[str, OnnxNetwork] = {network.name: network for network in (
    OnnxNetwork("lama", "inpaint", "inpainting_lama_2025jan.onnx", 92.6, ("image", "mask"), (), complete_lama),
    OnnxNetwork("efficientsam-ti", "segment", "image_segmentation_efficientsam_ti_2025april.onnx", 48,
                ("batched_images", "batched_point_coords", "batched_point_labels"),
                ("output_masks", "iou_predictions"), segment_efficientsam),
    OnnxNetwork("da3metric-large", "depth", "da3metric-large.onnx", 1240, (), (), depth_da3),
)}  # fmt: skip


def open_network(task: str, name: str, weights: Path) -> OnnxTransport:
    """Return the way to an ONNX model. The file is read when the model is first used.

    Raises:
        ModelError: If the model is unknown or its weights are missing.
        MissingExtraError: If onnxruntime is not installed.
    """
    fitting = {known: network for known, network in NETWORKS.items() if network.task == task}
    network = fitting.get(name)
    if network is None:
        listed = ", ".join(f"`{known}`" for known in fitting) or "none"
        raise ModelError(f"`{name}` is no known ONNX model for `{task}`; set `adapter` to one of these: {listed}")
    if not weights.is_file():
        raise ModelError(f"the weights of {name} are missing: {network.how_to_get()}, and save it as {weights}")
    need_extra("onnx", f"the model {name}")
    return OnnxTransport(network, weights)


class OnnxTransport:
    """A model in this process. The network is loaded when the first request arrives."""

    def __init__(self, network: OnnxNetwork, weights: Path) -> None:
        self._network, self._weights = network, weights
        self._session: Any = None

    @property
    def place(self) -> str:
        """The file with the weights."""
        return str(self._weights)

    def describe(self) -> Mapping[str, Any]:
        """Return the model and its licence."""
        entry = licences()[self._network.name]
        model = {"name": entry.name, "version": self._network.version, "licence": entry.weights}
        return {"bundle": VERSION, "tasks": {self._network.task: {"model": model}}}

    def exchange(self, task: str, digest: str, data: bytes) -> bytes:
        """Run the network on a request, and return the answer as a bundle."""
        network = self._network
        session = self._loaded()
        shapes = {one.name: tuple(one.shape) for one in session.get_inputs()}
        names = [one.name for one in session.get_outputs()]

        def run(inputs: Mapping[str, Any]) -> Mapping[str, Any]:
            try:
                results = session.run(None, dict(inputs))
            except Exception as error:  # onnxruntime raises many kinds
                reason = plain(error)
                raise ModelError(f"{network.name} failed on this request ({reason})") from None
            return dict(zip(names, map(np.asarray, results), strict=True))

        members = network.solve(read_bundle(data, REQUEST), run, shapes)
        model = {**self.describe()["tasks"][task]["model"], "weights_sha256": self._digest}
        try:
            return write_bundle(
                Bundle({"bundle": VERSION, "task": task, "request": digest, "model": model}, members), ANSWER
            )
        except BundleError as error:
            raise ModelError(f"the answer of {network.name} {error}") from None

    def _loaded(self) -> Any:
        """Return the session, after comparing the network's inputs and outputs with the expected ones."""
        if self._session is not None:
            return self._session
        import onnxruntime

        onnxruntime.set_default_logger_severity(4)  # its warnings about a machine without a GPU help nobody
        network = self._network
        try:
            content = self._weights.read_bytes()
            session = onnxruntime.InferenceSession(str(self._weights), providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises many kinds
            reason = plain(error)
            raise ModelError(f"{self._weights} cannot be loaded ({reason}); {network.how_to_get()}") from None
        self._digest = sha256(content).hexdigest()
        found = ({one.name for one in session.get_inputs()}, {one.name for one in session.get_outputs()})
        for kind, wanted, has in zip(("input", "output"), (network.inputs, network.outputs), found, strict=True):
            missing = [name for name in wanted if name not in has]
            if missing:
                listed = ", ".join(sorted(has))
                raise ModelError(
                    f"{self._weights} is not {network.name}: it has no {kind} `{missing[0]}`, but {listed}; "
                    f"{network.how_to_get()}"
                )
        self._session = session
        return session
