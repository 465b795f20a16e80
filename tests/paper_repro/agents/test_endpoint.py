"""A model behind an endpoint: what is sent, what is refused, what is tried again, and the key."""

import json
import pickle
import socket
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from fake_endpoint import DRIPS, GOOD, fake_endpoint

from exact_mdp import ModelError, Scenario
from exact_mdp.paper_repro.agents.endpoint import (
    SHAPES,
    BackendError,
    Endpoint,
    Malformed,
    require_form,
)
from exact_mdp.paper_repro.agents.simulate import NAME, build_conversation
from exact_mdp.paper_repro.agents.texts import Modules

KEY = "sk-test-0123456789abcdef"
ELSEWHERE = "https://example.org/v1"
MODULES = Modules.of(Scenario.load("yuan2025"))
QUESTION = MODULES.ask_behaviour(
    MODULES.describe_place(0, 1, 5), (), dict.fromkeys(MODULES.statuses, 0), 3
)


@pytest.fixture(autouse=True)
def _key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)


def endpoint(url: str, waits: list[float] | None = None, **settings: Any) -> Endpoint:
    wait = ([] if waits is None else waits).append
    return Endpoint(model="m", base_url=url, sleep=wait, **{"timeout": 10.0} | settings)


# ---- what is sent and what comes back ------------------------------------------------------------


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_sent_and_what_comes_back(shape: str) -> None:
    with fake_endpoint() as state:
        answer = endpoint(state.url, shape=shape, max_tokens=77).answer(QUESTION)
    assert answer == GOOD["behaviour"]
    (body,) = state.bodies
    assert state.asked[0]["Authorization"] == f"Bearer {KEY}"
    assert [m["role"] for m in body["messages"]] == ["system", "user"]
    assert (body["model"], body["max_tokens"], body["seed"]) == ("m", 77, 3)
    assert ("response_format" in body) == (shape != "none")
    if shape == "json_schema":
        assert body["response_format"]["json_schema"]["schema"]["required"] == [*QUESTION.fields]


def test_a_conversation_finishes_over_faults_and_is_resumed_after_a_failure(tmp_path: Path) -> None:
    (tmp_path / "two").mkdir()
    with fake_endpoint(429, "malformed", 500, "drop", "fenced", "wrong-schema", "cut") as state:
        one = endpoint(state.url, tries=8)
        record = build_conversation(one).hold(tmp_path)
        assert record.end is not None
        assert KEY not in (tmp_path / NAME).read_text("utf-8")
        assert record.header["backend"]["base_url"] == state.url
        with pytest.raises(BackendError):
            build_conversation(one).hold(
                tmp_path / "two", progress=lambda _: state.faults.__setitem__(slice(None), [401])
            )
        assert (tmp_path / "two" / NAME).read_text("utf-8").count("\n") == 2  # header and a step
        assert build_conversation(one).hold(tmp_path / "two", resume=True).end is not None


@pytest.mark.parametrize("fault", [408, 429, 500, 503, "drop", "not-json", "no-choice"])
def test_a_failure_that_passes_is_tried_again_and_one_that_stays_is_told(fault: int | str) -> None:
    with fake_endpoint(fault, fault) as state:
        assert endpoint(state.url).answer(QUESTION) == GOOD["behaviour"]
        state.faults[:] = [fault] * 3
        with pytest.raises(BackendError, match="no answer in 3 attempts"):
            endpoint(state.url, tries=3).answer(QUESTION)


def test_waits_grow_and_are_those_that_are_asked_for() -> None:
    waits: list[float] = []
    with fake_endpoint(500, 500, 500) as state:
        endpoint(state.url, waits).answer(QUESTION)
        assert waits == [1.0, 2.0, 4.0]
        for asked, wait in (("7", 7.0), ("3600", 60.0), ("nan", 1.0), ("-1", 1.0), ("soon", 1.0)):
            waits.clear()
            state.faults[:], state.headers["Retry-After"] = [429], asked
            endpoint(state.url, waits).answer(QUESTION)
            assert waits == [wait]


@pytest.mark.parametrize("fault", ["malformed", "wrong-schema", "cut", "twice", "not-object"])
def test_a_bad_answer_is_asked_for_again_with_its_fault(fault: str) -> None:
    with fake_endpoint(fault) as state:
        assert endpoint(state.url).answer(QUESTION) == GOOD["behaviour"]
    first, second = (body["messages"][-1]["content"] for body in state.bodies)
    assert second.startswith(first)
    assert "An earlier answer could not be used" in second.removeprefix(first)


STOPS = {code: str(code) for code in (400, 401, 404, 302)}
STOPS |= {"refusal": "refused", "filtered": "refused", "echo": "401"}


@pytest.mark.parametrize(("fault", "words"), STOPS.items())
def test_what_another_try_does_not_change_stops_at_once(fault: int | str, words: str) -> None:
    with fake_endpoint(fault) as state, pytest.raises(BackendError, match=words) as caught:
        endpoint(state.url).answer(QUESTION)
    assert len(state.bodies) == 1
    assert caught.value.fix
    for secret in (KEY, "told to fail"):  # nothing of what the endpoint writes
        assert secret not in str(caught.value)


BOUNDS = {"flood": "over 4,000,000", "bomb": "not JSON", "drop": "connection"}


@pytest.mark.parametrize(
    ("fault", "words"), [*((fault, r"no answer within 0\.5 s") for fault in DRIPS), *BOUNDS.items()]
)
def test_an_answer_is_bounded_in_time_and_size_and_not_unpacked(fault: str, words: str) -> None:
    with fake_endpoint(fault) as state, pytest.raises(BackendError, match=words):
        endpoint(state.url, timeout=0.5 if fault in DRIPS else 10.0, tries=1).answer(QUESTION)


# ---- forms ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    [None, [], {}, *({"x": "a", "b": 1} | other for other in (
        {"more": 0}, {"x": 5}, {"b": True}, {"b": 2}, {"x": "a" * 1201}, {"x": chr(0xD800)},
        {"b": 0.0}))],
)  # fmt: skip
def test_only_the_asked_form_is_taken(value: object) -> None:
    assert require_form({"x": "a", "b": 1}, {"x": "text", "b": "bit"}) == {"x": "a", "b": 1}
    with pytest.raises(Malformed):
        require_form(value, {"x": "text", "b": "bit"})


# ---- the key and the way -------------------------------------------------------------------------


def test_the_key_is_shown_and_kept_by_nothing(tmp_path: Path) -> None:
    one = endpoint(ELSEWHERE)
    assert KEY not in repr(one) + json.dumps(one.describe()) + str(vars(one))
    assert KEY.encode() not in pickle.dumps(one.describe())
    given_away = pytest.raises(BackendError, match="holds the key")
    with fake_endpoint("say") as state, given_away as caught:
        build_conversation(endpoint(state.url)).hold(tmp_path)
    assert KEY not in str(caught.value)
    assert all(KEY.encode() not in path.read_bytes() for path in tmp_path.iterdir())


def test_neither_a_key_nor_proxies_nor_netrc_are_made_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / ".netrc").write_text("machine 127.0.0.1 login a password b\n")
    monkeypatch.setenv("NETRC", str(tmp_path / ".netrc"))
    monkeypatch.delenv("OPENAI_API_KEY")
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
        monkeypatch.setenv(name.lower(), "http://127.0.0.1:9")
    with fake_endpoint() as state:
        assert endpoint(state.url).answer(QUESTION) == GOOD["behaviour"]
    assert "Authorization" not in state.asked[0]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        *(({"key_variable": name}, "no variable") for name in (KEY, "NOT_SET_ANYWHERE", "A B", "")),
        *(({"timeout": x}, "time limit") for x in (0.0, -1.0, float("inf"), float("nan"))),
        *(({"base_url": url}, "address|unencrypted") for url in (
            "http://example.org/v1", "http://127.0.0.1.example.org/v1", "http://10.0.0.1/v1",
            "ftp://a/v1", "example.org", "https://", "https://user:word@example.org/v1",
            "https://example.org/v1?key=1", "https://example.org:port/v1",
            "http://localhost.example.org/v1")),
    ],
)  # fmt: skip
def test_settings_that_would_tell_a_key_or_limit_nothing_are_refused(
    settings: dict[str, Any], words: str
) -> None:
    with pytest.raises(ModelError, match=words) as caught:
        Endpoint(**{"model": "m", "base_url": ELSEWHERE} | settings)
    assert "word" not in str(caught.value)
    assert not settings.get("key_variable") or settings["key_variable"] not in str(caught.value)


def test_a_broken_key_and_a_missing_package_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-a\nHost: elsewhere")
    with pytest.raises(ModelError, match="characters"):
        endpoint(ELSEWHERE)
    monkeypatch.setitem(sys.modules, "httpx", None)
    with pytest.raises(ModelError, match="httpx") as caught:
        endpoint(ELSEWHERE)
    assert "exact-mdp[agents]" in caught.value.fix


def test_a_certificate_of_nobody_is_not_trusted_and_secrets_are_written_nowhere(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    secrets = tmp_path / "secrets"
    monkeypatch.setenv("SSLKEYLOGFILE", str(secrets))
    monkeypatch.setenv("SSL_CERT_FILE", str(Path(__file__).parents[2] / "support/localhost.pem"))
    with fake_endpoint(tls=True) as state, pytest.raises(BackendError, match="certificate"):
        endpoint(state.url).answer(QUESTION)
    assert state.asked == []
    assert "SECRET" not in (secrets.read_text() if secrets.exists() else "")


def test_a_key_stays_here_where_a_redirect_leads_elsewhere() -> None:
    with fake_endpoint() as other, fake_endpoint(307) as state:
        state.headers["Location"] = f"{other.url}/chat/completions"
        with pytest.raises(BackendError, match="307"):
            endpoint(state.url).answer(QUESTION)
    assert other.asked == []


def test_the_deadline_holds_while_a_name_is_looked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    halt = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: halt.wait(30) or [])
    with pytest.raises(BackendError, match="no answer within"):
        endpoint(ELSEWHERE, timeout=0.3, tries=1).answer(QUESTION)
    halt.set()
