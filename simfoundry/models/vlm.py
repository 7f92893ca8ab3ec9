"""Vision-language models: a prompt and pictures in, a typed answer or text out.

The name selects the provider, such as ``openai:gpt-5``, ``google:gemini-3-pro`` or ``anthropic:claude-opus-4``; any
server with an OpenAI-compatible API is selected by its address. Keys come only from the environment, under the names
that the providers use. pydantic-ai does the work, and is not exposed outside of this module.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from pydantic import BaseModel

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.extras import install_line

if TYPE_CHECKING:
    from pydantic_ai.models import Model

TIMEOUT_S = 120.0  # Time for one answer [s]: thinking models take up to a minute

MAX_TOKENS = 16_000  # Tokens of one answer, thinking included: a task proposal takes about 2,000 without thinking

# Bounds of the pictures in one request [bytes, count]: providers refuse requests of about 20 MB.
MAX_BYTES, MAX_PICTURES = 10 * 2**20, 16

MAX_PROMPT = 200_000  # Longest prompt [characters]: about 50,000 tokens, which every current model takes

RETRIES = 2  # Number of times that a model is asked to correct the form of its answer

KINDS = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"))

# Form of a request for a typed answer: by the model's own JSON schema, as a tool call, or in the prompt.
Mode = Literal["native", "tool", "prompt"]

Answer = TypeVar("Answer", bound=BaseModel)


class VlmError(SimfoundryError):
    """A model without a usable answer; the message states the reason and the remedy."""


class Vlm:
    """One model. ``model`` is its name, or a model of pydantic-ai, as in tests.

    ``base_url`` is the address of a server with an OpenAI-compatible API; its key, if it needs one, is
    ``OPENAI_API_KEY`` in the environment. ``temperature`` is the provider's default if None.
    """

    def __init__(
        self,
        model: str | Model,
        base_url: str | None = None,
        mode: Mode = "native",
        temperature: float | None = None,
        timeout_s: float = TIMEOUT_S,
        max_tokens: int = MAX_TOKENS,
    ) -> None:
        self._model = _model(model, base_url)
        self._mode = mode
        self._settings: dict[str, Any] = {"max_tokens": max_tokens, "timeout": timeout_s}
        if temperature is not None:
            self._settings["temperature"] = temperature
        self._timeout_s = timeout_s

    @property
    def name(self) -> str:
        """Name of the model."""
        return str(self._model.model_name)

    def ask(self, prompt: str, pictures: Sequence[bytes], answer: type[Answer]) -> Answer:
        """Return a typed answer. ``pictures`` are the bytes of PNG or JPEG files. Raises :class:`VlmError`."""
        from pydantic_ai import NativeOutput, PromptedOutput, ToolOutput

        kind: Any = {"native": NativeOutput, "tool": ToolOutput, "prompt": PromptedOutput}[self._mode]
        found = self._run(prompt, pictures, kind(answer))
        assert isinstance(found, answer)
        return found

    def ask_text(self, prompt: str, pictures: Sequence[bytes] = ()) -> str:
        """Return an answer as text. Raises :class:`VlmError`."""
        return str(self._run(prompt, pictures, str))

    def _run(self, prompt: str, pictures: Sequence[bytes], output: Any) -> Any:
        from pydantic_ai import Agent, exceptions
        from pydantic_ai.usage import UsageLimits

        agent: Any = Agent(self._model, output_type=output, retries=RETRIES)
        limits = UsageLimits(request_limit=RETRIES + 1)
        try:
            result = agent.run_sync(
                _message(prompt, pictures), model_settings=self._settings, usage_limits=limits, timeout=self._budget
            )
        except exceptions.ModelHTTPError as error:
            hint = "; is its key right?" if error.status_code in (401, 403) else ""
            raise VlmError(
                f"{self.name} answered with status {error.status_code}: {_short(error.body)}{hint}"
            ) from None
        except exceptions.UnexpectedModelBehavior as error:
            raise VlmError(
                f"{self.name} gave no answer of the right form in {RETRIES + 1} tries: {_short(error)}"
            ) from None
        except exceptions.AgentRunError as error:
            raise VlmError(f"{self.name} gave no answer: {_short(error)}") from None
        except (OSError, TimeoutError) as error:
            raise VlmError(f"{self.name} cannot be reached: {_short(error) or 'it took too long'}") from None
        return result.output

    @property
    def _budget(self) -> float:
        """Time limit for all tries together [s]."""
        return self._timeout_s * (RETRIES + 1)


def _model(model: str | Model, base_url: str | None) -> Model:
    try:
        from pydantic_ai.exceptions import UserError
        from pydantic_ai.models import infer_model
    except ImportError:
        raise VlmError(f"vision-language models need pydantic-ai; install with `{install_line('vlm')}`") from None
    if not isinstance(model, str):
        return model
    try:
        if base_url is None:
            return infer_model(model)
        from pydantic_ai.models.openai import OpenAIChatModel
        from pydantic_ai.providers.openai import OpenAIProvider

        if not base_url.startswith(("http://", "https://")):
            raise VlmError(f"the address of a model must start with http:// or https://, not `{base_url}`")
        key = os.environ.get("OPENAI_API_KEY") or "none"  # self-hosted servers rarely require one
        return OpenAIChatModel(model.removeprefix("openai:"), provider=OpenAIProvider(base_url=base_url, api_key=key))
    except ImportError as error:
        raise VlmError(f"`{model}` needs the package `{error.name}`; install with `{install_line('vlm')}`") from None
    except (UserError, ValueError) as error:
        raise VlmError(f"`{model}` cannot be used: {_short(error)}") from None


def _message(prompt: str, pictures: Sequence[bytes]) -> list[Any]:
    """Return the pictures, followed by the prompt."""
    from pydantic_ai import BinaryContent

    if len(prompt) > MAX_PROMPT:
        raise VlmError(f"a prompt has at most {MAX_PROMPT} characters, not {len(prompt)}")
    size = sum(map(len, pictures))
    if len(pictures) > MAX_PICTURES or size > MAX_BYTES:
        most = f"{MAX_PICTURES} pictures of {MAX_BYTES / 2**20:.0f} MiB together"
        raise VlmError(f"at most {most} are sent, not {len(pictures)} of {size / 2**20:.1f} MiB; make them smaller")
    return [*(BinaryContent(data=data, media_type=_kind(data)) for data in pictures), prompt]


def _kind(data: bytes) -> str:
    for start, kind in KINDS:
        if data.startswith(start):
            return kind
    raise VlmError("a picture for a model must be a PNG or a JPEG")


def _short(what: object) -> str:
    text = " ".join(str(what).split())
    return text if len(text) <= 300 else f"{text[:297]}..."
