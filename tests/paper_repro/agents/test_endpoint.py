"""The openai backend: what an endpoint, a proxy or the environment cannot bring about."""

from __future__ import annotations

import json
import os
import pickle
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from fake_endpoint import (
    CERTIFICATE,
    GOOD,
    RawServer,
    disguises,
    dripping,
    fake_endpoint,
    hear,
    listen,
    raw_server,
    saying,
)

from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.paper_repro.agents import recording
from exact_mdp.paper_repro.agents.__main__ import main
from exact_mdp.paper_repro.agents.chat import Malformed, Style, decoded
from exact_mdp.paper_repro.agents.conversation import conversation, modules_of, recorded
from exact_mdp.paper_repro.agents.endpoint import LONGEST_WAIT, Endpoint
from exact_mdp.paper_repro.agents.prompts import Place
from exact_mdp.paper_repro.agents.protocol import BackendError, Request, plain
from exact_mdp.paper_repro.agents.session import NAME, Recorded, hold, replayed

KEY = "sk-test-0123456789abcdef"
PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "NO_PROXY")


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*PROXIES, "SSL_CERT_FILE", "SSL_CERT_DIR", "SSLKEYLOGFILE"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)


@pytest.fixture(scope="module")
def question() -> Request:
    modules = modules_of(Scenario.load("yuan2025"))
    place = Place(step=modules.activity.steps[0], attempt=1, attempts=5)
    return modules.behaviour(place, (), "", dict.fromkeys(modules.statuses, 0), 9)


@pytest.fixture
def nothing_left_open() -> Iterator[None]:
    """Hold that no thread and no socket outlives a test."""
    threads, sockets = set(threading.enumerate()), _sockets()
    yield
    assert set(threading.enumerate()) <= threads
    assert _sockets() <= sockets


def _sockets() -> set[str]:
    folder = Path("/proc/self/fd")
    if not folder.is_dir():
        return set()
    links = []
    for entry in folder.iterdir():
        try:
            links.append(os.readlink(entry))
        except OSError:
            continue
    return {link for link in links if link.startswith("socket:")}


def leads_to(monkeypatch: pytest.MonkeyPatch, names: dict[str, int]) -> None:
    """Let names be those of ports of this machine."""
    plainly = socket.getaddrinfo

    def look_up(host: str, port: int, *rest: Any, **words: Any) -> Any:
        if host in names:
            place = ("127.0.0.1", names[host])
            return [(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP, "", place)]
        return plainly(host, port, *rest, **words)

    monkeypatch.setattr(socket, "getaddrinfo", look_up)


def parts_of_key(text: str) -> list[str]:
    """Return the disguises of the key that a text holds."""
    return [name for name, form in disguises(KEY).items() if form in text]


def endpoint(
    url: str, tries: int = 1, waits: list[float] | None = None, **settings: Any
) -> Endpoint:
    """Return an endpoint that does not sleep, and keeps how long it would have waited."""
    forms = {name: settings.pop(name) for name in ("shape", "temperature") if name in settings}
    return Endpoint(
        model="fake",
        base_url=url,
        sleep=([] if waits is None else waits).append,
        style=Style(tries=tries, **forms),
        **settings,
    )


def command(*words: object, url: str) -> Result:
    """Run a command of the agents that asks an endpoint once."""
    asked = ("--backend", "openai", "--model", "fake", "--base-url", url, "--tries", "1")
    return CliRunner().invoke(main, [str(word) for word in (*words, *asked)])


def answering(status: str, content: bytes, header: bytes = b"") -> Callable[..., None]:
    """Return a script that answers a question with a status line and a body."""
    length = b"Content-Length: %d" % len(content)
    return saying(b"HTTP/1.1 %b\r\n%b%b\r\n\r\n%b" % (status.encode(), header, length, content))


def files(folder: Path) -> str:
    return "".join(path.read_text() for path in folder.rglob("*") if path.is_file())


# ---- one request ---------------------------------------------------------------------------------


def test_what_is_sent_and_what_comes_back(question: Request) -> None:
    with fake_endpoint() as fake:
        reply = endpoint(fake.url, 4).answer(question)
    assert reply.data == GOOD["behaviour"]
    assert (reply.attempts, reply.prompt_tokens, reply.completion_tokens) == (1, 100, 10)
    (body,) = fake.bodies
    assert body["model"] == "fake"
    assert [message["role"] for message in body["messages"]] == ["system", "user"]
    assert body["response_format"]["json_schema"]["schema"] == question.schema
    assert body["response_format"]["json_schema"]["strict"] is True
    assert fake.keys == [KEY]


@pytest.mark.parametrize("fault", [429, 500, 502, 503, 504, "drop", "not-json"])
def test_a_failure_that_passes_is_tried_again_and_one_that_stays_is_told(
    question: Request, fault: int | str
) -> None:
    waits: list[float] = []
    with fake_endpoint(fault, fault) as fake:
        reply = endpoint(fake.url, 4, waits).answer(question)
    assert (reply.data, reply.attempts) == (GOOD["behaviour"], 3)
    assert len(waits) == 2
    assert 1 <= waits[0] <= 1.25
    assert 2 <= waits[1] <= 2.5
    with fake_endpoint(*[fault] * 9) as fake:
        with pytest.raises(BackendError, match="no answer in 4 attempts"):
            endpoint(fake.url, 4).answer(question)
        assert len(fake.bodies) == 4


@pytest.mark.parametrize(
    "asked, least, most",
    [
        ("7", 7, 7),
        ("0.5", 1, 1.25),
        ("100000", LONGEST_WAIT, LONGEST_WAIT),
        ("Wed, 21 Oct 2026 07:28:00 GMT", 1, 1.25),
        ("-3", 1, 1.25),
        ("nan", 1, 1.25),
        ("inf", 1, 1.25),
        ("", 1, 1.25),
    ],
)
def test_the_wait_that_is_asked_for_in_seconds_is_kept(
    question: Request, asked: str, least: float, most: float
) -> None:
    waits: list[float] = []
    with fake_endpoint(429, Retry_After=asked) as fake:
        endpoint(fake.url, 4, waits).answer(question)
    assert least <= waits[0] <= most


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
    question: Request, fault: str, told: str
) -> None:
    with fake_endpoint(fault) as fake:
        reply = endpoint(fake.url, 4).answer(question)
        assert reply.data == GOOD["behaviour"]
        first, second = (body["messages"][-1]["content"] for body in fake.bodies)
        assert told not in first
        assert told in second
        assert second.startswith(first)
    with fake_endpoint(*[fault] * 9) as fake:
        with pytest.raises(BackendError, match=f"4 answers .* {told}"):
            endpoint(fake.url, 4).answer(question)
        assert len(fake.bodies) == 4


@pytest.mark.parametrize(
    "fault, told",
    [
        ("refusal", "refused"),
        ("filtered", "refused"),
        ("bomb", "compressed or otherwise encoded"),
        (307, "redirects are not followed"),
        (400, "--response-format"),
        (403, "OPENAI_API_KEY"),
        (404, "--base-url"),
    ],
)
def test_what_another_try_does_not_change_stops_at_once_with_a_remedy(
    question: Request, fault: int | str, told: str
) -> None:
    """A redirect carries neither key nor question elsewhere, and nothing is decompressed."""
    with fake_endpoint() as other, fake_endpoint(fault, Location=other.url) as fake:
        with pytest.raises(BackendError, match=told):
            endpoint(fake.url, 4).answer(question)
        assert (len(fake.bodies), len(other.bodies)) == (1, 0)
        assert fake.asked[0]["Accept-Encoding"] == "identity"


def test_an_endpoint_that_is_not_there(question: Request) -> None:
    with fake_endpoint() as fake:
        url = fake.url
    with pytest.raises(BackendError, match="connection failed"):
        endpoint(url).answer(question)


def test_the_shape_can_be_asked_for_otherwise(question: Request) -> None:
    with fake_endpoint() as fake:
        for shape in ("json_object", "none"):
            endpoint(fake.url, shape=shape, temperature=None).answer(question)
    assert fake.bodies[0]["response_format"] == {"type": "json_object"}
    assert "response_format" not in fake.bodies[1]
    assert "temperature" not in fake.bodies[1]


# ---- the key -------------------------------------------------------------------------------------


@pytest.mark.parametrize("disguise", sorted(disguises(KEY)))
@pytest.mark.parametrize("name", ["run", "measure", "variants"])
def test_an_error_tells_no_key_in_any_disguise(tmp_path: Path, disguise: str, name: str) -> None:
    """What an endpoint writes beside an error is not printed where a key was sent."""
    with fake_endpoint(f"echo-{disguise}") as fake:
        out = () if name == "variants" else ("--out", tmp_path)
        done = command(name, *out, url=fake.url)
    assert done.exit_code == 2
    assert "HTTP status 401 (Unauthorized)" in done.output
    assert "Incorrect" not in done.output
    assert parts_of_key(done.output + files(tmp_path)) == []


@pytest.mark.parametrize("disguise", sorted(disguises(KEY)))
def test_an_answer_that_holds_the_key_is_not_kept(tmp_path: Path, disguise: str) -> None:
    """A key that comes back within a good answer gets into no recording, text or page."""
    with fake_endpoint(f"say-{disguise}") as fake:
        done = command("run", "--out", tmp_path, url=fake.url)
    assert done.exit_code == 2
    assert "holds a part of the key" in done.output
    assert "header" in files(tmp_path)
    assert parts_of_key(done.output + files(tmp_path)) == []


@pytest.mark.parametrize("status", [400, 403, 404, 418, 599])
def test_a_phrase_of_the_endpoint_is_not_shown(question: Request, status: int) -> None:
    """Neither the reason nor a header of an error is taken from the endpoint."""
    reason = disguises(KEY)["reversed"]
    script = answering(f"{status} {reason}", b"", f"X-Key: {reason}\r\n".encode())
    with raw_server(script) as server, pytest.raises(BackendError) as caught:
        endpoint(server.url).answer(question)
    assert f"HTTP status {status}" in str(caught.value)
    assert parts_of_key(str(caught.value)) == []
    assert caught.value.__cause__ is None


def test_without_a_key_the_text_of_an_error_is_shown_plainly(
    question: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What helps is still told, on one line and without control characters."""
    monkeypatch.delenv("OPENAI_API_KEY")
    text = json.dumps({"error": {"message": "no model\x1b[2J\u202e\nfake"}}).encode()
    script = answering("400 Bad", text)
    with raw_server(script) as server, pytest.raises(BackendError) as caught:
        endpoint(server.url).answer(question)
    assert "HTTP status 400 (Bad Request): no model [2J fake\n" in str(caught.value)


def test_a_name_of_an_unasked_part_is_not_shown(question: Request) -> None:
    """The key as the name of a part of an answer is told to nobody, the model included."""
    said = json.dumps({KEY: 1, **GOOD["behaviour"]})
    text = json.dumps({"choices": [{"message": {"content": said}}]}).encode()
    with raw_server(answering("200 OK", text)) as server:
        with pytest.raises(BackendError, match="a part that was not asked for") as caught:
            endpoint(server.url, tries=2).answer(question)
        body = b"".join(server.received.split(b"\r\n\r\n")[1:])
    assert KEY.encode() not in body.replace(f"Bearer {KEY}".encode(), b"")
    assert KEY not in str(caught.value)


@pytest.mark.parametrize("name", [KEY, "gsk_0123456789abcdef", "A B"])
def test_a_key_given_for_the_name_of_its_variable_is_not_shown(tmp_path: Path, name: str) -> None:
    """Whoever gives the key itself to --key-variable does not find it in a message."""
    words = ("run", "--out", tmp_path / "out", "--key-variable", name)
    done = command(*words, url="http://127.0.0.1:1/v1")
    assert done.exit_code == 2
    assert "--key-variable" in done.output
    assert name not in done.output
    assert not (tmp_path / "out").exists()


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
        ("https://endpoint.test/v1#secret", None),
        ("https://@endpoint.test/v1", None),
        ("http://127.0.0.1\\@endpoint.test/v1", None),
        ("http://127.0.0.1:80@endpoint.test/v1", None),
        ("http://127.0.0.1.endpoint.test/v1", None),
        ("http://localhost./v1", None),
        ("http://0.0.0.0/v1", None),
        ("https://endpoint.test/a b", None),
        ("https://endpöint.test/v1", None),
        ("https://endpoint.test:port/v1", None),
    ],
)
def test_addresses_that_would_tell_a_key_or_are_in_doubt_are_refused(
    url: str, what: str | None
) -> None:
    """An address is taken apart once: what two readers read differently is refused."""
    with pytest.raises(ModelError, match=what) as caught:
        endpoint(url)
    assert "secret" not in str(caught.value)


def test_a_key_with_a_line_break_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-a\r\nX-Other: b")
    with pytest.raises(ModelError, match="a key cannot have") as caught:
        endpoint("http://127.0.0.1:1/v1")
    assert "X-Other" not in str(caught.value)


def test_without_a_key_none_is_sent(question: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY")
    with fake_endpoint() as fake:
        endpoint(fake.url, 4).answer(question)
    assert fake.keys == [""]


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "httpcore", None)
    monkeypatch.delitem(sys.modules, "exact_mdp.paper_repro.agents.transport", raising=False)
    with pytest.raises(ModelError, match=r"exact-mdp\[agents\]"):
        endpoint("http://127.0.0.1:1/v1")


# ---- whole conversations -------------------------------------------------------------------------


def test_a_conversation_finishes_over_every_fault(tmp_path: Path) -> None:
    faults = [429, "malformed", "drop", 500, "wrong-schema", "not-json", "cut", "fenced", 503]
    with fake_endpoint(*faults) as fake:
        told = hold(conversation(endpoint(fake.url, 4), policy="always:directive"), tmp_path)
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
        words = ("run", "--out", out, "--policy", "always:directive", "--seed", 2)
        words = (*words, "--timeout", "2" if fault == "slow" else "120")
        fake.faults.extend(["none"] * 4 + [fault])
        done = command(*words, url=fake.url)
        assert done.exit_code == 2, done.output
        assert "BackendError" in done.output
        assert "--resume goes on" in done.output
        assert "Traceback" not in done.output
        assert KEY not in done.output + files(out)
        kept = recording.read(out / NAME)
        assert len(kept.steps) == 1
        again = command(*words, "--resume", url=fake.url)
        assert again.exit_code == 0, again.output
        assert KEY not in again.output + files(out)
    whole = recording.read(out / NAME)
    assert whole.steps[0] == kept.steps[0]
    assert whole.end is not None
    assert "run.json" in {path.name for path in out.iterdir()}


def test_measuring_an_endpoint_goes_on_after_a_stop_and_states_its_cost(tmp_path: Path) -> None:
    with fake_endpoint() as fake:
        words = ("measure", "--each", 1, "--draws", 0, "--scripted-behaviour")
        words = (*words, "--price", 2, 10, "--out", tmp_path)
        fake.faults.extend(["none"] * 5 + [500])
        done = command(*words, url=fake.url)
        assert done.exit_code == 2, done.output
        assert (tmp_path / "labelled.jsonl").read_text().count("\n") == 1 + 5
        done = command(*words, "--resume", url=fake.url)
        assert done.exit_code == 0, done.output
    assert len(fake.bodies) == 16 + 1
    cost = (11 * 100 * 2 + 11 * 10 * 10) / 1e6
    assert f"11 attempts, 1,100 + 110 tokens, cost {cost:.4f}" in done.output
    assert "sensitivity 0.000" in done.output  # it always says 0000
    assert KEY not in done.output + files(tmp_path)


# ---- the environment -----------------------------------------------------------------------------


@pytest.mark.parametrize("trust", [False, True])
def test_an_address_of_this_machine_is_never_asked_through_a_proxy(
    question: Request, monkeypatch: pytest.MonkeyPatch, trust: bool
) -> None:
    """With HTTP_PROXY set, neither key nor question of a loopback address reach the proxy."""
    with fake_endpoint() as fake, raw_server(lambda state, line: None) as proxy:
        for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
            monkeypatch.setenv(name, f"http://127.0.0.1:{proxy.port}")
            monkeypatch.setenv(name.lower(), f"http://127.0.0.1:{proxy.port}")
        reply = endpoint(fake.url, timeout=120, trust_environment=trust).answer(question)
        assert reply.data == GOOD["behaviour"]
        assert fake.keys == [KEY]
        assert proxy.begun == 0


def test_no_proxy_is_used_unless_asked_for(
    question: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another machine is asked directly, whatever the environment says of proxies."""
    with raw_server(dripping(b"", b"x")) as there, raw_server(dripping(b"", b"x")) as proxy:
        leads_to(monkeypatch, {"endpoint.test": there.port})
        for name in ("HTTPS_PROXY", "ALL_PROXY"):
            monkeypatch.setenv(name, f"http://127.0.0.1:{proxy.port}")
        with pytest.raises(BackendError):
            endpoint("https://endpoint.test/v1", timeout=120).answer(question)
        assert (there.begun, proxy.begun) == (1, 0)


def test_a_proxy_that_is_asked_for_sees_no_key(
    question: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through a proxy of the environment the key travels encrypted, and the answer comes back."""
    with fake_endpoint(tls=True) as fake:
        port = int(fake.url.rpartition(":")[2].partition("/")[0])
        with raw_server(_tunnel(port)) as proxy:
            monkeypatch.setenv("HTTPS_PROXY", f"http://me:secret@127.0.0.1:{proxy.port}")
            monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATE))
            backend = endpoint("https://endpoint.test/v1", timeout=120, trust_environment=True)
            assert backend.answer(question).data == GOOD["behaviour"]
            assert fake.keys == [KEY]
            assert proxy.received.startswith(b"CONNECT endpoint.test:443 HTTP/1.1\r\n")
            assert KEY.encode() not in proxy.received
            assert "secret" not in repr(backend) + json.dumps(backend.describe())


def _tunnel(port: int) -> Callable[..., None]:
    """Return a script of a proxy that joins a connection to a port of this machine."""

    def script(state: RawServer, line: socket.socket) -> None:
        while b"\r\n\r\n" not in state.received and not state.halt.is_set():
            listen(state, line)
        line.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
        with socket.create_connection(("127.0.0.1", port)) as other:
            other.settimeout(0.05)
            while not state.halt.is_set():
                sent = listen(state, line)
                if sent == b"":
                    return
                other.sendall(sent or b"")
                try:
                    line.sendall(other.recv(65_536))
                except TimeoutError:
                    continue

    return script


@pytest.mark.parametrize(
    "proxy", ["socks5://127.0.0.1:1", "https://h:1", "http://u:hush@h h", "x/y"]
)
def test_a_proxy_in_another_form_is_refused_and_not_shown(
    monkeypatch: pytest.MonkeyPatch, proxy: str
) -> None:
    """A proxy that cannot be used as asked is an error, not a direct connection."""
    monkeypatch.setenv("HTTPS_PROXY", proxy)
    with pytest.raises(ModelError, match="HTTPS_PROXY") as caught:
        endpoint("https://endpoint.test/v1", trust_environment=True)
    assert "hush" not in str(caught.value)


def test_nothing_is_read_from_netrc(
    question: Request, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A name and password of .netrc go nowhere."""
    (tmp_path / ".netrc").write_text("machine 127.0.0.1 login me password hush\n")
    (tmp_path / ".netrc").chmod(0o600)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("NETRC", str(tmp_path / ".netrc"))
    monkeypatch.delenv("OPENAI_API_KEY")
    with fake_endpoint() as fake:
        endpoint(fake.url).answer(question)
    assert "Authorization" not in fake.asked[0]


def test_certificates_of_the_environment_are_trusted_only_where_asked_for(
    question: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SSL_CERT_FILE makes nobody trusted unless --trust-environment is given."""
    monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATE))
    with fake_endpoint(tls=True) as fake:
        with pytest.raises(BackendError, match="certificate of the endpoint is not trusted"):
            endpoint(fake.url, timeout=120).answer(question)
        assert fake.keys == []
        trusting = endpoint(fake.url, timeout=120, trust_environment=True)
        assert trusting.answer(question).data == GOOD["behaviour"]


def test_the_secrets_of_a_connection_are_written_nowhere(
    question: Request, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """SSLKEYLOGFILE, with which others could read the key on its way, is not followed."""
    log = tmp_path / "secrets"
    monkeypatch.setenv("SSLKEYLOGFILE", str(log))
    monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATE))
    with fake_endpoint(tls=True) as fake:
        endpoint(fake.url, timeout=120, trust_environment=True).answer(question)
    assert not log.exists()


def test_a_key_stays_on_this_machine_where_the_name_leads_elsewhere(
    question: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    """localhost is trusted with a key for the address behind the name, not for the name."""
    place = ("192.0.2.1", 80)
    found = [(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP, "", place)]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    with pytest.raises(BackendError, match="does not lead to this machine"):
        endpoint("http://localhost:1/v1", timeout=120).answer(question)


# ---- the deadline --------------------------------------------------------------------------------

OK = b"HTTP/1.1 200 OK\r\n"
DRIPS = {
    "silence": lambda state, line: None,
    "handshake": dripping(b"\x16\x03\x03\x3f\xff\x02\x00\x3f\xfb", b"\x00"),
    "status line": dripping(b"HTTP/1.1 200 ", b"O"),
    "headers": dripping(OK, b"X-A: b\r\n"),
    "one header": dripping(OK + b"X-A: ", b"b"),
    "body": dripping(OK + b"Content-Length: 100000\r\n\r\n", b" "),
    "body to the end": dripping(OK + b"\r\n", b" "),
    "chunks": dripping(OK + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\n \r\n"),
    "size of a chunk": dripping(OK + b"Transfer-Encoding: chunked\r\n\r\n", b"0", 0.2),
    "trailers": dripping(OK + b"Transfer-Encoding: chunked\r\n\r\n0\r\n", b"X-A: b\r\n"),
    "continue": dripping(b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
    "error body": dripping(b"HTTP/1.1 400 Bad\r\nContent-Length: 99999\r\n\r\n", b" "),
}


@pytest.mark.parametrize("name", DRIPS)
@pytest.mark.usefixtures("nothing_left_open")
def test_one_deadline_holds_whatever_drips(
    question: Request, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The time limit covers handshake, headers, body, chunks and continuations, and ends it all."""
    monkeypatch.delenv("OPENAI_API_KEY")  # so that the text of an error is read
    with raw_server(DRIPS[name]) as server:
        url = server.url.replace("http:", "https:") if name == "handshake" else server.url
        with pytest.raises(BackendError, match=r"no whole answer within 0\.5 s"):
            endpoint(url, timeout=0.5).answer(question)
        assert server.all_ended()


@pytest.mark.usefixtures("nothing_left_open")
def test_the_deadline_holds_in_a_proxy(question: Request, monkeypatch: pytest.MonkeyPatch) -> None:
    """A proxy that drips its answer is left at the deadline."""
    with raw_server(dripping(OK, b"X-A: b\r\n")) as proxy:
        monkeypatch.setenv("ALL_PROXY", f"127.0.0.1:{proxy.port}")
        backend = endpoint("https://endpoint.test/v1", timeout=0.5, trust_environment=True)
        with pytest.raises(BackendError, match=r"no whole answer within 0\.5 s"):
            backend.answer(question)
        assert proxy.all_ended()


def test_the_deadline_holds_while_a_name_is_looked_up(
    question: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A look-up that never ends is not waited for."""
    stuck = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: stuck.wait() and [])
    with pytest.raises(BackendError, match=r"no whole answer within 0\.5 s"):
        endpoint("https://endpoint.test/v1", timeout=0.5).answer(question)
    stuck.set()


@pytest.mark.usefixtures("nothing_left_open")
def test_the_deadline_holds_for_what_is_sent() -> None:
    """A server that reads nothing does not hold a long question up."""
    from exact_mdp.paper_repro.agents.transport import Address, Route, Transient, post

    def script(state: RawServer, line: socket.socket) -> None:
        state.halt.wait()

    with raw_server(script) as server:
        address = Address.of(server.url)
        assert address is not None
        with pytest.raises(Transient, match=r"no whole answer within 0\.5 s"):
            post(address, "/chat/completions", bytes(50_000_000), {}, route=Route(), seconds=0.5,
                 wanted=lambda status: True)  # fmt: skip


@pytest.mark.parametrize("timeout", [0, -1, float("nan"), float("inf"), 1e9])
def test_a_time_limit_that_limits_nothing_is_refused(timeout: float) -> None:
    """The limit is a number of seconds that ends."""
    with pytest.raises(ModelError, match="the time limit is"):
        endpoint("http://127.0.0.1:1/v1", timeout=timeout)


# ---- the size ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "first, flood, told",
    [
        (OK, b"X-A: b\r\n" * 1000, "headers of over 65,536 bytes"),
        (b"", b"HTTP/1.1 100 Continue\r\n\r\n" * 1000, "headers of over 65,536 bytes"),
        (OK + b"\r\n", b" " * 10_000, "an answer of over 4,000,000 bytes"),
        (
            OK + b"Transfer-Encoding: chunked\r\n\r\n",
            b"1;" + b"x" * 9_000 + b"\r\n \r\n",
            "an answer of over 4,000,000 bytes",
        ),
    ],
)
@pytest.mark.usefixtures("nothing_left_open")
def test_a_flood_is_counted_as_it_comes(
    question: Request, first: bytes, flood: bytes, told: str
) -> None:
    """Headers, continuations and the framing of chunks count, not the text in them alone."""

    def script(state: RawServer, line: socket.socket) -> None:
        hear(state, line)
        line.settimeout(120)
        line.sendall(first)
        while not state.halt.is_set():
            line.sendall(flood)

    with raw_server(script) as server:
        with pytest.raises(BackendError, match=told):
            endpoint(server.url, timeout=120).answer(question)
        assert server.all_ended()


def test_a_key_is_shown_and_kept_by_nothing() -> None:
    """Neither repr, description nor pickle of an endpoint holds the key."""
    backend = Endpoint(model="fake", base_url="http://127.0.0.1:1/v1")
    assert parts_of_key(f"{backend!r} {backend} {vars(backend)} {backend.describe()}") == []
    with pytest.raises(TypeError, match="not pickled"):
        pickle.dumps(backend)


# ---- what an answer may hold ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "fault, told",
    [
        ("digits", "holds a number of over 40 digits"),
        ("twice", "names a part twice"),
        ("deep", "is nested deeper than 100"),
        ("nan", "not finite"),
        ("infinite", "not finite"),
    ],
)
def test_a_form_that_no_reader_should_take_is_refused(
    question: Request, fault: str, told: str
) -> None:
    """Limits on digits and depth, and nothing read in one of two ways."""
    with fake_endpoint(*[fault] * 2) as fake:
        with pytest.raises(BackendError, match=told):
            endpoint(fake.url, tries=2).answer(question)
        assert len(fake.bodies) == 2


@pytest.mark.parametrize(
    "text", [b"\xff\xfe{\x00}\x00", b'{"a": "\xff"}', "[" * 100_000, '{"a": -' + "1" * 60 + "}", ""]
)
def test_text_that_is_no_json_in_utf_8_is_refused(text: str | bytes) -> None:
    """Nothing is guessed about the encoding of an answer."""
    with pytest.raises(Malformed):
        decoded(text)


def test_brackets_in_texts_are_no_nesting() -> None:
    """The limit of nesting counts arrays and objects, not what stands in a text."""
    text = "[" * 500 + '\\" ' + "{" * 500
    assert decoded(json.dumps({"a": [text]})) == {"a": [text]}


# ---- what is shown -------------------------------------------------------------------------------


def test_texts_reach_the_terminal_without_control_characters() -> None:
    """The four variants side by side show what was said, not what a terminal would do with it."""
    said = "One\x1b]0;two\x07\u202ethree\nFour"

    def script(state: RawServer, line: socket.socket) -> None:
        hear(state, line)
        speaks = b"voice of an assistive robot" in state.received
        parts = ("speech",) if speaks else ("nonverbal", "verbal")
        content = json.dumps(dict.fromkeys(parts, said))
        state.received.clear()
        text = json.dumps({"choices": [{"message": {"content": content}}]}).encode()
        line.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(text), text))

    with raw_server(script) as server:
        done = command("variants", "--status", "0000", url=server.url)
    assert done.exit_code == 0, done.output
    assert plain(said) in done.output
    assert all(letter.isprintable() for letter in done.output.replace("\n", ""))


@pytest.mark.parametrize("fault", ["digits", "count"])
def test_counts_of_many_digits_end_in_a_message_or_a_result(tmp_path: Path, fault: str) -> None:
    """A count of tokens of 4,300 digits is no traceback."""
    with fake_endpoint(*[fault] * 3) as fake:
        done = command("run", "--limit", "2", "--out", tmp_path, url=fake.url)
    assert done.exit_code == (2 if fault == "digits" else 0), done.output
    assert "Traceback" not in done.output
    assert "9" * 50 not in done.output
    assert str(10**39) not in done.output


@pytest.mark.parametrize(
    "words",
    [
        ["--timeout", "nan"], ["--timeout", "inf"], ["--temperature", "nan"], ["--noise", "nan"],
        ["--price", "nan", "1"], ["--price", "1", "inf"], ["--price", "-1", "1"],
    ],
)  # fmt: skip
def test_numbers_that_are_none_are_refused(tmp_path: Path, words: list[str]) -> None:
    """nan passes every comparison with the ends of a range, so it is asked for by itself."""
    done = CliRunner().invoke(main, ["run", "--out", str(tmp_path / "out"), *words])
    assert done.exit_code == 2, done.output
    assert words[0] in done.output
    assert not (tmp_path / "out").exists()
