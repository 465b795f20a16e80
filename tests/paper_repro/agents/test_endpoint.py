"""The openai backend against an endpoint on loopback that misbehaves: nothing lost, no key told."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from fake_endpoint import GOOD, fake_endpoint

from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.mdp.lazy import later
from exact_mdp.paper_repro.agents import endpoint as module
from exact_mdp.paper_repro.agents import recording
from exact_mdp.paper_repro.agents.__main__ import main
from exact_mdp.paper_repro.agents.chat import Style
from exact_mdp.paper_repro.agents.conversation import conversation, modules_of, recorded
from exact_mdp.paper_repro.agents.endpoint import LONGEST_WAIT, Endpoint
from exact_mdp.paper_repro.agents.prompts import Place
from exact_mdp.paper_repro.agents.protocol import BackendError, Request
from exact_mdp.paper_repro.agents.session import NAME, Recorded, hold, replayed

KEY = "sk-test-0123456789abcdef"


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def request_() -> Request:
    modules = modules_of(Scenario.load("yuan2025"))
    place = Place(step=modules.activity.steps[0], attempt=1, attempts=5)
    return modules.behaviour(place, (), "", dict.fromkeys(modules.statuses, 0), 9)


class Waits(list[float]):
    """Stands in for sleeping, and keeps how long it would have been."""

    def __call__(self, seconds: float) -> None:
        self.append(seconds)


def endpoint(url: str, waits: Waits | None = None, **settings: Any) -> Endpoint:
    style = settings.pop("style", Style())
    return Endpoint(
        model="fake",
        base_url=url,
        sleep=Waits() if waits is None else waits,
        style=style,
        **settings,
    )


def files(folder: Path) -> str:
    return "".join(path.read_text() for path in folder.rglob("*") if path.is_file())


# ---- one request ---------------------------------------------------------------------------------


def test_what_is_sent_and_what_comes_back(request_: Request) -> None:
    with fake_endpoint() as fake:
        reply = endpoint(fake.url).answer(request_)
    assert reply.data == GOOD["behaviour"]
    assert (reply.attempts, reply.prompt_tokens, reply.completion_tokens) == (1, 100, 10)
    (body,) = fake.bodies
    assert body["model"] == "fake"
    assert [message["role"] for message in body["messages"]] == ["system", "user"]
    assert body["response_format"]["json_schema"]["schema"] == request_.schema
    assert body["response_format"]["json_schema"]["strict"] is True
    assert fake.keys == [KEY]


@pytest.mark.parametrize("fault", [429, 500, 502, 503, 504, "drop", "not-json"])
def test_a_failure_that_passes_is_tried_again(request_: Request, fault: int | str) -> None:
    waits = Waits()
    with fake_endpoint(fault, fault) as fake:
        reply = endpoint(fake.url, waits).answer(request_)
    assert reply.data == GOOD["behaviour"]
    assert reply.attempts == 3
    assert len(waits) == 2
    assert 1 <= waits[0] <= 1.25
    assert 2 <= waits[1] <= 2.5


@pytest.mark.parametrize("fault", [429, 500, "drop", "not-json"])
def test_a_failure_that_stays_is_told(request_: Request, fault: int | str) -> None:
    with fake_endpoint(*[fault] * 9) as fake:
        with pytest.raises(BackendError, match="no answer in 4 attempts"):
            endpoint(fake.url).answer(request_)
        assert len(fake.bodies) == 4


@pytest.mark.parametrize("asked, waited", [("7", 7), ("0.5", 1), ("100000", LONGEST_WAIT)])
def test_the_wait_that_is_asked_for_is_kept(request_: Request, asked: str, waited: float) -> None:
    waits = Waits()
    with fake_endpoint(429, Retry_After=asked) as fake:
        endpoint(fake.url, waits).answer(request_)
    assert waited <= waits[0] <= max(waited, 1.25)


@pytest.mark.parametrize("asked", ["Wed, 21 Oct 2026 07:28:00 GMT", "-3", "nan", "inf", ""])
def test_a_wait_that_states_no_seconds_is_passed_over(request_: Request, asked: str) -> None:
    waits = Waits()
    with fake_endpoint(429, Retry_After=asked) as fake:
        endpoint(fake.url, waits).answer(request_)
    assert 1 <= waits[0] <= 1.25


@pytest.mark.parametrize(
    "fault, told",
    [
        ("malformed", "its content is not JSON"),
        ("wrong-schema", "lacks verbal"),
        ("cut", "cut off"),
        ("no-choice", "no choice"),
        ("not-object", "no choice"),
    ],
)
def test_a_bad_answer_is_asked_for_again_with_its_fault(
    request_: Request, fault: str, told: str
) -> None:
    with fake_endpoint(fault) as fake:
        reply = endpoint(fake.url).answer(request_)
        assert reply.data == GOOD["behaviour"]
        first, second = (body["messages"][-1]["content"] for body in fake.bodies)
        assert told not in first
        assert told in second
        assert second.startswith(first)
    with fake_endpoint(*[fault] * 9) as fake:
        with pytest.raises(BackendError, match=f"4 answers .* {told}"):
            endpoint(fake.url).answer(request_)
        assert len(fake.bodies) == 4


def test_a_fenced_answer_is_taken(request_: Request) -> None:
    with fake_endpoint("fenced") as fake:
        assert endpoint(fake.url).answer(request_).attempts == 1


@pytest.mark.parametrize("fault", ["refusal", "filtered"])
def test_a_refusal_stops_at_once(request_: Request, fault: str) -> None:
    with fake_endpoint(fault) as fake:
        with pytest.raises(BackendError, match="refused"):
            endpoint(fake.url).answer(request_)
        assert len(fake.bodies) == 1


@pytest.mark.parametrize(
    "fault, remedy", [(400, "--response-format"), (403, "OPENAI_API_KEY"), (404, "--base-url")]
)
def test_other_statuses_stop_at_once_with_a_remedy(
    request_: Request, fault: int, remedy: str
) -> None:
    with fake_endpoint(fault) as fake:
        with pytest.raises(BackendError, match=remedy):
            endpoint(fake.url).answer(request_)
        assert len(fake.bodies) == 1


@pytest.mark.parametrize("fault", ["slow", "drip"])
def test_an_answer_has_to_be_whole_in_time(request_: Request, fault: str) -> None:
    started = time.monotonic()
    with fake_endpoint(fault, fault) as fake, pytest.raises(BackendError, match=r"within 0\.3 s"):
        endpoint(fake.url, timeout=0.3, style=Style(tries=2)).answer(request_)
    assert time.monotonic() - started < 4


def test_an_endpoint_that_is_not_there(request_: Request) -> None:
    with fake_endpoint() as fake:
        url = fake.url
    with pytest.raises(BackendError, match="connection failed"):
        endpoint(url).answer(request_)


def test_the_shape_can_be_asked_for_otherwise(request_: Request) -> None:
    with fake_endpoint() as fake:
        for shape in ("json_object", "none"):
            endpoint(fake.url, style=Style(shape=shape, temperature=None)).answer(request_)
    assert fake.bodies[0]["response_format"] == {"type": "json_object"}
    assert "response_format" not in fake.bodies[1]
    assert "temperature" not in fake.bodies[1]


# ---- the key -------------------------------------------------------------------------------------


def test_no_key_is_told_by_an_error_or_a_repr(request_: Request) -> None:
    with fake_endpoint("echo-key") as fake:
        backend = endpoint(fake.url)
        with pytest.raises(BackendError) as caught:
            backend.answer(request_)
    assert KEY not in str(caught.value)
    assert "HTTP status 401 (Unauthorized)" in str(caught.value)
    assert "Incorrect" not in str(caught.value)
    assert KEY not in repr(backend) + str(backend.describe())


@pytest.mark.parametrize(
    "url, what",
    [
        ("http://example.invalid/v1", "unencrypted"),
        ("https://user:secret@example.invalid/v1", "credentials"),
        ("https://example.invalid/v1?key=secret", "credentials"),
        ("ftp://example.invalid", "not an http"),
        ("example.invalid/v1", "not an http"),
        ("http://[::1/v1", "not an http"),
        ("http://127.0.0.1:99999/v1", "not an http"),
        ("http://127.0.0.1/\nv1", "not an http"),
    ],
)
def test_addresses_that_would_tell_a_key_are_refused(url: str, what: str) -> None:
    with pytest.raises(ModelError, match=what) as caught:
        endpoint(url)
    assert "secret" not in str(caught.value)


def test_a_key_with_a_line_break_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-a\r\nX-Other: b")
    with pytest.raises(ModelError, match="a key cannot have") as caught:
        endpoint("http://127.0.0.1:1/v1")
    assert "X-Other" not in str(caught.value)


def test_without_a_key_none_is_sent(request_: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY")
    with fake_endpoint() as fake:
        endpoint(fake.url).answer(request_)
    assert fake.keys == [""]


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "httpcore", None)
    monkeypatch.delitem(sys.modules, "exact_mdp.paper_repro.agents.transport", raising=False)
    monkeypatch.setattr(module, "transport", later("exact_mdp.paper_repro.agents.transport"))
    with pytest.raises(ModelError, match=r"exact-mdp\[agents-openai\]"):
        endpoint("http://127.0.0.1:1/v1")


# ---- whole conversations -------------------------------------------------------------------------


def test_a_conversation_finishes_over_every_fault(tmp_path: Path) -> None:
    faults = [429, "malformed", "drop", 500, "wrong-schema", "not-json", "cut", "fenced", 503]
    with fake_endpoint(*faults) as fake:
        told = hold(conversation(endpoint(fake.url), policy="always:directive"), tmp_path)
    assert told.end is not None
    assert told.end["requests"] == 3 * len(told.steps)
    assert told.end["attempts"] == len(fake.bodies) == told.end["requests"] + 8
    assert told.end["prompt_tokens"] == 100 * (len(fake.bodies) - 5)
    assert KEY not in files(tmp_path)
    read = recording.read(tmp_path / NAME)
    assert replayed(recorded(read.header, Recorded(read)), read) == []


@pytest.mark.parametrize("fault", [401, 500, "drop", "malformed", "refusal", "slow"])
def test_a_run_that_stops_keeps_its_steps_and_goes_on(tmp_path: Path, fault: int | str) -> None:
    out = tmp_path / "out"
    with fake_endpoint() as fake:
        common = ["--backend", "openai", "--model", "fake", "--base-url", fake.url, "--tries", "1"]
        words = ["run", "--out", str(out), "--policy", "always:directive", "--seed", "2", *common]
        words += ["--timeout", "0.5"]
        fake.faults.extend(["none"] * 4 + [fault])
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 2, done.output
        assert "BackendError" in done.output
        assert "--resume goes on" in done.output
        assert "Traceback" not in done.output
        assert KEY not in done.output + files(out)
        kept = recording.read(out / NAME)
        assert len(kept.steps) == 1
        again = CliRunner().invoke(main, [*words, "--resume"])
        assert again.exit_code == 0, again.output
        assert KEY not in again.output + files(out)
    whole = recording.read(out / NAME)
    assert whole.steps[0] == kept.steps[0]
    assert whole.end is not None
    assert "run.json" in {path.name for path in out.iterdir()}


def test_measuring_an_endpoint_goes_on_after_a_stop_and_states_its_cost(tmp_path: Path) -> None:
    with fake_endpoint() as fake:
        words = ["measure", "--each", "1", "--draws", "0", "--scripted-behaviour"]
        words += ["--backend", "openai", "--model", "fake", "--base-url", fake.url, "--tries", "1"]
        words += ["--price", "2", "10", "--out", str(tmp_path)]
        fake.faults.extend(["none"] * 5 + [500])
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 2, done.output
        assert (tmp_path / "labelled.jsonl").read_text().count("\n") == 1 + 5
        done = CliRunner().invoke(main, [*words, "--resume"])
        assert done.exit_code == 0, done.output
    assert len(fake.bodies) == 16 + 1
    cost = (11 * 100 * 2 + 11 * 10 * 10) / 1e6
    assert f"11 attempts, 1,100 + 110 tokens, cost {cost:.4f}" in done.output
    assert "sensitivity 0.000" in done.output  # it always says 0000
    assert KEY not in done.output + files(tmp_path)
