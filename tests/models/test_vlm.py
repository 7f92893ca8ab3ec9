"""The adapter to vision-language models, on models that answer without a network."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest
from pydantic import BaseModel

pytest.importorskip("pydantic_ai", reason="the extra `vlm` is not installed")

from pydantic_ai.messages import BinaryContent, ModelResponse, TextPart, UserPromptPart
from pydantic_ai.models.function import AgentInfo, FunctionModel
from pydantic_ai.models.test import TestModel

from simfoundry.models.vlm import MAX_BYTES, Vlm, VlmError

PNG = b"\x89PNG\r\n\x1a\n rest"


class Count(BaseModel):
    cups: int


def answering(*texts: str) -> tuple[Vlm, list[Any]]:
    """A model that gives one text after the other, and what it was sent."""
    sent: list[Any] = []

    def answer(messages: Any, info: AgentInfo) -> ModelResponse:
        sent.append((messages, info))
        return ModelResponse(parts=[TextPart(texts[min(len(sent), len(texts)) - 1])])

    profile: Any = {"supports_json_schema_output": True}
    return Vlm(FunctionModel(answer, profile=profile)), sent


def test_a_typed_answer_by_the_model_s_own_schema() -> None:
    vlm, sent = answering('{"cups": 3}')
    assert vlm.ask("How many?", [PNG], Count) == Count(cups=3)
    (part,) = [p for p in sent[0][0][0].parts if isinstance(p, UserPromptPart)]
    assert part.content == [BinaryContent(data=PNG, media_type="image/png"), "How many?"]
    settings = sent[0][1].model_settings
    assert settings["timeout"] == 120
    assert settings["max_tokens"] == 16_000


def test_a_wrong_form_is_asked_again_and_not_for_ever() -> None:
    vlm, sent = answering('{"cups": "many"}', '{"cups": 2}')
    assert vlm.ask("?", [], Count).cups == 2
    assert len(sent) == 2
    vlm, sent = answering("no idea")
    with pytest.raises(VlmError, match="did not return a valid response in 3 attempts"):
        vlm.ask("?", [], Count)
    assert len(sent) == 3


def test_the_library_s_own_test_model_fills_in_the_type() -> None:
    assert isinstance(Vlm(TestModel(), mode="tool").ask("?", [PNG], Count).cups, int)


def test_words() -> None:
    assert answering("a cup")[0].ask_text("What?", [b"\xff\xd8\xff jpeg"]) == "a cup"


@pytest.mark.parametrize(
    ("pictures", "said"),
    [
        ([b"GIF89a"], "must be PNG or JPEG"),
        ([PNG + bytes(MAX_BYTES)], "10 MiB in total"),
        ([PNG] * 17, "at most 16 images"),
    ],
)
def test_pictures_are_bounded(pictures: list[bytes], said: str) -> None:
    with pytest.raises(VlmError, match=said):
        answering("")[0].ask_text("?", pictures)


@pytest.mark.parametrize(
    ("name", "url", "said"),
    [("nobody:nothing", None, "cannot be used"), ("m", "ftp://here", "must start with http")],
)
def test_a_model_that_cannot_be(name: str, url: str | None, said: str) -> None:
    with pytest.raises(VlmError, match=said):
        Vlm(name, url)


def test_a_missing_key_is_said_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    with pytest.raises(VlmError, match="OPENAI_API_KEY"):
        Vlm("openai:some-model")


# -- any server that speaks OpenAI's protocol -------------------------------------------------------------------------


class _Server(BaseHTTPRequestHandler):
    asked: list[dict[str, Any]]
    status = 200

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        type(self).asked.append({"path": self.path, "key": self.headers.get("Authorization"), **body})
        message = {"role": "assistant", "content": '{"cups": 4}'}
        choice = {"index": 0, "finish_reason": "stop", "message": message}
        answer = {"id": "1", "object": "chat.completion", "created": 1, "model": "m", "choices": [choice]}
        data = json.dumps(answer if self.status == 200 else {"error": {"message": "bad key"}}).encode()
        self.send_response(self.status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[tuple[str, type[_Server]]]:
    handler = type("Handler", (_Server,), {"asked": []})
    running = HTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=running.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{running.server_port}/v1", handler
    running.shutdown()
    running.server_close()
    thread.join()


def test_a_server_of_one_s_own(server: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    url, handler = server
    monkeypatch.setenv("OPENAI_API_KEY", "from-the-environment")
    assert Vlm("local", url).ask("How many?", [PNG], Count).cups == 4
    (asked,) = handler.asked
    assert asked["path"] == "/v1/chat/completions"
    assert asked["key"] == "Bearer from-the-environment"
    assert asked["model"] == "local"
    assert asked["response_format"]["type"] == "json_schema"
    kinds = [part["type"] for part in asked["messages"][-1]["content"]]
    assert kinds == ["image_url", "text"]


def test_a_refusal_is_a_sentence(server: Any) -> None:
    url, handler = server
    handler.status = 401
    with pytest.raises(VlmError, match=r"returned status 401: .*bad key.*is the API key correct"):
        Vlm("local", url).ask_text("?")


def test_nobody_there() -> None:
    with pytest.raises(VlmError, match=r"m did not return a response|could not reach m"):
        Vlm("m", "http://127.0.0.1:9", timeout_s=2).ask_text("?")
