"""Foundation models that a project uses: the server, command or recording behind each task."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import FORMAT_NAME, TOKEN_VARIABLE, URL, Model, Positive, consistent, exclusive

ModelTaskName = Literal[
    "depth",
    "multiview",
    "stereo",
    "complete_depth",
    "segment",
    "track",
    "inpaint",
    "inpaint_video",
    "edit",
    "mesh",
    "parts",
    "articulate",
    "pose",
    "read_scene",
    "splat",
    "splat_image",
]

Url = Annotated[str, StringConstraints(pattern=URL, max_length=500)]
TokenVariable = Annotated[str, StringConstraints(pattern=TOKEN_VARIABLE, max_length=100)]
RelativePath = Annotated[str, StringConstraints(min_length=1, max_length=500)]
Argument = Annotated[str, StringConstraints(max_length=1000)]


class ModelSource(Model):
    """The source of answers for one task."""

    url: Url | None = Field(None, description="URL of a server that speaks `bundle/1`, without `/v1`.")
    token: TokenVariable | None = Field(
        None, description="Environment variable with the server's bearer token; its name starts with `SIMFOUNDRY_`."
    )
    command: tuple[Argument, ...] | None = Field(
        None,
        min_length=1,
        max_length=100,
        description="Program and arguments that read a bundle from standard input and write one to standard output. It "
        "is started only if `SIMFOUNDRY_TRUST` lists the project's folder.",
    )
    recorded: RelativePath | None = Field(None, description="Folder with recorded answers, relative to this file.")
    weights: RelativePath | None = Field(
        None, description="ONNX file with the weights of a model that runs in this process, relative to this file."
    )
    adapter: Annotated[str, StringConstraints(pattern=FORMAT_NAME, max_length=64)] | None = Field(
        None, description="Name of the model in `weights`, as `simfoundry models` lists it."
    )
    vlm: Annotated[str, StringConstraints(min_length=1, max_length=200)] | None = Field(
        None,
        description="Vision-language model of a provider, such as `google:gemini-3-pro`; for `read_scene` and "
        "`articulate` only.",
    )
    offline: Literal[True] | None = Field(None, description="Use the method that needs no model.")
    record: RelativePath | None = Field(
        None, description="Folder, relative to this file, in which answers are recorded and looked up first."
    )
    timeout_s: Positive | None = Field(None, description="Time limit for one answer [s]; default: 300.")

    @consistent
    def _one_source(self) -> None:
        exclusive(self, "url", "command", "recorded", "weights", "vlm", "offline", needed=True)


class ProjectModels(Model):
    """The models of a project."""

    commercial_only: bool = Field(False, description="Refuse models that may not be used commercially.")
    accepted: tuple[Annotated[str, StringConstraints(min_length=1, max_length=100)], ...] = Field(
        (), max_length=100, description="Models whose conditions for commercial use you have read and meet."
    )
    tasks: dict[ModelTaskName, ModelSource] = Field({}, description="The source of answers for each task.")
