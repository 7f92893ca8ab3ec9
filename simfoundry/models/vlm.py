"""Vision-language models, which take a prompt and images and return a typed response or text.

The model name selects the provider, for example ``openai:gpt-5``, ``google:gemini-3-pro`` or
``anthropic:claude-opus-4``. Any server with an OpenAI-compatible API can be selected by its URL. API keys are read only
from the environment variables that the providers define. The implementation uses pydantic-ai, which is not exposed
outside this module.
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

TIMEOUT_S = 120.0  # Time limit for one response [s]; thinking models take up to a minute

MAX_TOKENS = 16_000  # Maximum tokens per response, including thinking; a task proposal takes about 2,000 without it

# Limits on the images in one request [bytes, count]; providers reject requests larger than about 20 MB.
MAX_BYTES, MAX_PICTURES = 10 * 2**20, 16

MAX_PROMPT = 200_000  # Maximum prompt length [characters]; about 50,000 tokens, which every current model accepts

RETRIES = 2  # Maximum number of times that a model is asked to correct the format of its response

KINDS = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"))

# Method of requesting a typed response: native structured output (JSON schema), a tool call, or the prompt.
Mode = Literal["native", "tool", "prompt"]

Answer = TypeVar("Answer", bound=BaseModel)


class VlmError(SimfoundryError):
    """Raised if a model returns no usable response. The message states the reason and the remedy."""


class Vlm:
    """A vision-language model.

    ``model`` is a model name or, as in tests, a pydantic-ai model. ``base_url`` is the URL of a server with an
    OpenAI-compatible API; if the server requires a key, it is read from the ``OPENAI_API_KEY`` environment variable.
    ``timeout_s`` is the time limit for one response [s].
    """

    def __init__(
        self, model: str | Model, base_url: str | None = None, mode: Mode = "native", timeout_s: float = TIMEOUT_S
    ) -> None:
        self._model, self._mode, self._timeout_s = _model(model, base_url), mode, timeout_s

    @property
    def name(self) -> str:
        """The name of the model."""
        return str(self._model.model_name)

    def ask(self, prompt: str, pictures: Sequence[bytes], answer: type[Answer]) -> Answer:
        """Send a prompt and return a response of the type ``answer``.

        ``pictures`` contains the bytes of PNG or JPEG files.

        Raises:
            VlmError: If the model returns no usable response.
        """
        from pydantic_ai import NativeOutput, PromptedOutput, ToolOutput

        kind: Any = {"native": NativeOutput, "tool": ToolOutput, "prompt": PromptedOutput}[self._mode]
        found = self._run(prompt, pictures, kind(answer))
        assert isinstance(found, answer)
        return found

    def ask_text(self, prompt: str, pictures: Sequence[bytes] = ()) -> str:
        """Send a prompt and return the response as text.

        Raises:
            VlmError: If the model returns no usable response.
        """
        return str(self._run(prompt, pictures, str))

    def _run(self, prompt: str, pictures: Sequence[bytes], output: Any) -> Any:
        from pydantic_ai import Agent, exceptions
        from pydantic_ai.usage import UsageLimits

        agent: Any = Agent(self._model, output_type=output, retries=RETRIES)
        limits = UsageLimits(request_limit=RETRIES + 1)
        settings = {"max_tokens": MAX_TOKENS, "timeout": self._timeout_s}
        budget_s = self._timeout_s * (RETRIES + 1)
        parts = _message(prompt, pictures)
        try:
            result = agent.run_sync(parts, model_settings=settings, usage_limits=limits, timeout=budget_s)
        except exceptions.ModelHTTPError as error:
            hint = "; is the API key correct?" if error.status_code in (401, 403) else ""
            raise VlmError(f"{self.name} returned status {error.status_code}: {_short(error.body)}{hint}") from None
        except exceptions.UnexpectedModelBehavior as error:
            raise VlmError(
                f"{self.name} did not return a valid response in {RETRIES + 1} attempts: {_short(error)}"
            ) from None
        except exceptions.AgentRunError as error:
            raise VlmError(f"{self.name} did not return a response: {_short(error)}") from None
        except (OSError, TimeoutError) as error:
            raise VlmError(f"could not reach {self.name}: {_short(error) or 'the request timed out'}") from None
        return result.output


def _model(model: str | Model, base_url: str | None) -> Model:
    try:
        from pydantic_ai.exceptions import UserError
        from pydantic_ai.models import infer_model
    except ImportError:
        raise VlmError(f"vision-language models require pydantic-ai; install with `{install_line('vlm')}`") from None
    if not isinstance(model, str):
        return model
    try:
        if base_url is None:
            return infer_model(model)
        from pydantic_ai.models.openai import OpenAIChatModel
        from pydantic_ai.providers.openai import OpenAIProvider

        if not base_url.startswith(("http://", "https://")):
            raise VlmError(f"the URL of a model must start with http:// or https://, not `{base_url}`")
        key = os.environ.get("OPENAI_API_KEY") or "none"  # self-hosted servers rarely require a key
        return OpenAIChatModel(model.removeprefix("openai:"), provider=OpenAIProvider(base_url=base_url, api_key=key))
    except ImportError as error:
        raise VlmError(f"`{model}` requires the `{error.name}` package; install with `{install_line('vlm')}`") from None
    except (UserError, ValueError) as error:
        raise VlmError(f"`{model}` cannot be used: {_short(error)}") from None


def _message(prompt: str, pictures: Sequence[bytes]) -> list[Any]:
    """Return the message parts: the images, followed by the prompt."""
    from pydantic_ai import BinaryContent

    if len(prompt) > MAX_PROMPT:
        raise VlmError(f"the prompt is {len(prompt)} characters long; the maximum is {MAX_PROMPT}")
    size = sum(map(len, pictures))
    if len(pictures) > MAX_PICTURES or size > MAX_BYTES:
        most = f"{MAX_PICTURES} images and {MAX_BYTES / 2**20:.0f} MiB in total"
        raise VlmError(f"cannot send {len(pictures)} images of {size / 2**20:.1f} MiB; use at most {most}")
    kinds = [next((kind for start, kind in KINDS if data.startswith(start)), "") for data in pictures]
    if not all(kinds):
        raise VlmError("images for a model must be PNG or JPEG")
    return [*(BinaryContent(data=data, media_type=kind) for data, kind in zip(pictures, kinds, strict=True)), prompt]


def _short(what: object) -> str:
    text = " ".join(str(what).split())
    return text if len(text) <= 300 else f"{text[:297]}..."
