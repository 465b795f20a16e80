"""The agents' endpoint: what an endpoint, a proxy or the environment cannot bring about."""

from __future__ import annotations

import json
import os
import pickle
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
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
from exact_mdp.paper_repro.agents.__main__ import main
from exact_mdp.paper_repro.agents.chat import Malformed, Style, decoded
from exact_mdp.paper_repro.agents.conversation import modules_of
from exact_mdp.paper_repro.agents.endpoint import Endpoint
from exact_mdp.paper_repro.agents.prompts import Place
from exact_mdp.paper_repro.agents.protocol import BackendError, Request, plain

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


def endpoint(url: str, tries: int = 1, **settings: Any) -> Endpoint:
    style = Style(tries=tries)
    return Endpoint(model="fake", base_url=url, sleep=lambda seconds: None, style=style, **settings)


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
        reply = endpoint(fake.url, timeout=3, trust_environment=trust).answer(question)
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
            endpoint("https://endpoint.test/v1", timeout=0.5).answer(question)
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
            backend = endpoint("https://endpoint.test/v1", timeout=5, trust_environment=True)
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
            endpoint(fake.url, timeout=5).answer(question)
        assert fake.keys == []
        trusting = endpoint(fake.url, timeout=5, trust_environment=True)
        assert trusting.answer(question).data == GOOD["behaviour"]


def test_the_secrets_of_a_connection_are_written_nowhere(
    question: Request, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """SSLKEYLOGFILE, with which others could read the key on its way, is not followed."""
    log = tmp_path / "secrets"
    monkeypatch.setenv("SSLKEYLOGFILE", str(log))
    monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATE))
    with fake_endpoint(tls=True) as fake:
        endpoint(fake.url, timeout=5, trust_environment=True).answer(question)
    assert not log.exists()


def test_a_key_stays_on_this_machine_where_the_name_leads_elsewhere(
    question: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    """localhost is trusted with a key for the address behind the name, not for the name."""
    place = ("192.0.2.1", 80)
    found = [(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP, "", place)]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    with pytest.raises(BackendError, match="does not lead to this machine"):
        endpoint("http://localhost:1/v1", timeout=0.5).answer(question)


# ---- the deadline --------------------------------------------------------------------------------

OK = b"HTTP/1.1 200 OK\r\n"
DRIPS = {
    "silence": lambda state, line: None,
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
    """The time limit covers headers, body, chunks and continuations, and ends the connection."""
    monkeypatch.delenv("OPENAI_API_KEY")  # so that the text of an error is read
    with raw_server(DRIPS[name]) as server:
        started = time.monotonic()
        with pytest.raises(BackendError, match=r"no whole answer within 0\.5 s"):
            endpoint(server.url, timeout=0.5).answer(question)
        assert time.monotonic() - started < 5
        assert server.all_ended()


@pytest.mark.usefixtures("nothing_left_open")
def test_the_deadline_holds_in_a_handshake(question: Request) -> None:
    """A server that drips its part of the TLS handshake is left at the deadline."""
    with raw_server(dripping(b"\x16\x03\x03\x3f\xff\x02\x00\x3f\xfb", b"\x00")) as server:
        url, started = server.url.replace("http:", "https:"), time.monotonic()
        with pytest.raises(BackendError, match=r"no whole answer within 0\.5 s"):
            endpoint(url, timeout=0.5).answer(question)
        assert time.monotonic() - started < 5
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
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: stuck.wait(30) and [])
    started = time.monotonic()
    with pytest.raises(BackendError, match=r"no whole answer within 0\.5 s"):
        endpoint("https://endpoint.test/v1", timeout=0.5).answer(question)
    stuck.set()
    assert time.monotonic() - started < 5


@pytest.mark.usefixtures("nothing_left_open")
def test_the_deadline_holds_for_what_is_sent() -> None:
    """A server that reads nothing does not hold a long question up."""
    from exact_mdp.paper_repro.agents.transport import Address, Route, Transient, post

    def script(state: RawServer, line: socket.socket) -> None:
        state.halt.wait(3)

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


def test_nothing_is_decompressed(question: Request) -> None:
    """An answer that is compressed twice is refused as it is; 'identity' alone was asked for."""
    with fake_endpoint("bomb") as fake:
        with pytest.raises(BackendError, match="compressed or otherwise encoded"):
            endpoint(fake.url, tries=3).answer(question)
        assert [asked["Accept-Encoding"] for asked in fake.asked] == ["identity"]


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
        line.settimeout(3)
        line.sendall(first)
        while not state.halt.is_set():
            line.sendall(flood)

    with raw_server(script) as server:
        with pytest.raises(BackendError, match=told):
            endpoint(server.url, timeout=20).answer(question)
        assert server.all_ended()


# ---- the key -------------------------------------------------------------------------------------


@pytest.mark.parametrize("disguise", sorted(disguises(KEY)))
@pytest.mark.parametrize("command", ["run", "measure", "variants"])
def test_an_error_tells_no_key_in_any_disguise(tmp_path: Path, disguise: str, command: str) -> None:
    """What an endpoint writes beside an error is not printed where a key was sent."""
    with fake_endpoint(f"echo-{disguise}") as fake:
        words = [command, "--backend", "openai", "--model", "fake", "--base-url", fake.url]
        words += ["--tries", "1"] + (["--out", str(tmp_path)] if command != "variants" else [])
        done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    assert "HTTP status 401 (Unauthorized)" in done.output
    assert "Incorrect" not in done.output
    kept = "".join(path.read_text() for path in tmp_path.rglob("*") if path.is_file())
    assert parts_of_key(done.output + kept) == []


@pytest.mark.parametrize("status", [400, 403, 404, 418, 599])
def test_a_phrase_of_the_endpoint_is_not_shown(question: Request, status: int) -> None:
    """Neither the reason nor a header of an error is taken from the endpoint."""
    reason = disguises(KEY)["reversed"].encode()
    answer = b"HTTP/1.1 %d %b\r\nX-Key: %b\r\nContent-Length: 0\r\n\r\n" % (status, reason, reason)

    with raw_server(saying(answer)) as server, pytest.raises(BackendError) as caught:
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
    answer = b"HTTP/1.1 400 Bad\r\nContent-Length: %d\r\n\r\n%b" % (len(text), text)

    with raw_server(saying(answer)) as server, pytest.raises(BackendError) as caught:
        endpoint(server.url).answer(question)
    assert "HTTP status 400 (Bad Request): no model [2J fake\n" in str(caught.value)


def test_a_redirect_is_not_followed(question: Request) -> None:
    """A redirect carries neither key nor question elsewhere."""
    with fake_endpoint() as other, fake_endpoint("redirect", Location=other.url) as fake:
        with pytest.raises(BackendError, match="redirects are not followed"):
            endpoint(fake.url, tries=3).answer(question)
        assert (len(fake.bodies), len(other.bodies)) == (1, 0)


@pytest.mark.parametrize("disguise", sorted(disguises(KEY)))
def test_an_answer_that_holds_the_key_is_not_kept(tmp_path: Path, disguise: str) -> None:
    """A key that comes back within a good answer gets into no recording, text or page."""
    with fake_endpoint(f"say-{disguise}") as fake:
        words = ["run", "--backend", "openai", "--model", "fake", "--base-url", fake.url]
        done = CliRunner().invoke(main, [*words, "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert "holds a part of the key" in done.output
    kept = "".join(path.read_text() for path in tmp_path.rglob("*") if path.is_file())
    assert "header" in kept
    assert parts_of_key(done.output + kept) == []


def test_a_name_of_an_unasked_part_is_not_shown(question: Request) -> None:
    """The key as the name of a part of an answer is told to nobody, the model included."""
    said = json.dumps({KEY: 1, **GOOD["behaviour"]})
    text = json.dumps({"choices": [{"message": {"content": said}}]}).encode()

    answer = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(text), text)

    with raw_server(saying(answer)) as server:
        with pytest.raises(BackendError, match="a part that was not asked for") as caught:
            endpoint(server.url, tries=2).answer(question)
        body = b"".join(server.received.split(b"\r\n\r\n")[1:])
    assert KEY.encode() not in body.replace(f"Bearer {KEY}".encode(), b"")
    assert KEY not in str(caught.value)


def test_a_key_is_shown_and_kept_by_nothing() -> None:
    """Neither repr, description nor pickle of an endpoint holds the key."""
    backend = Endpoint(model="fake", base_url="http://127.0.0.1:1/v1")
    assert parts_of_key(f"{backend!r} {backend} {vars(backend)} {backend.describe()}") == []
    with pytest.raises(TypeError, match="not pickled"):
        pickle.dumps(backend)


@pytest.mark.parametrize("name", [KEY, "gsk_0123456789abcdef", "A B"])
def test_a_key_given_for_the_name_of_its_variable_is_not_shown(tmp_path: Path, name: str) -> None:
    """Whoever gives the key itself to --key-variable does not find it in a message."""
    words = ["run", "--backend", "openai", "--model", "fake", "--out", str(tmp_path / "out")]
    words += ["--base-url", "http://127.0.0.1:1/v1", "--key-variable", name]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    assert "--key-variable" in done.output
    assert name not in done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "url",
    [
        "https://endpoint.test/v1#hush",
        "https://@endpoint.test/v1",
        "http://127.0.0.1\\@endpoint.test/v1",
        "http://127.0.0.1:80@endpoint.test/v1",
        "http://127.0.0.1.endpoint.test/v1",
        "http://localhost./v1",
        "http://0.0.0.0/v1",
        "https://endpoint.test/a b",
        "https://endpöint.test/v1",
        "https://endpoint.test:port/v1",
    ],
)
def test_an_address_that_two_readers_read_differently_is_refused(url: str) -> None:
    """An address is taken apart once, and what is in doubt is refused."""
    with pytest.raises(ModelError) as caught:
        endpoint(url)
    assert "hush" not in str(caught.value)


# ---- what an answer may hold ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "fault, told",
    [
        ("digits", "holds a number of over 40 digits"),
        ("twice", "names a part twice"),
        ("deep", "is nested deeper than 64"),
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


@pytest.mark.parametrize("fault", ["digits", "count"])
def test_counts_of_many_digits_end_in_a_message_or_a_result(tmp_path: Path, fault: str) -> None:
    """A count of tokens of 4,300 digits is no traceback."""
    with fake_endpoint(*[fault] * 3) as fake:
        words = ["run", "--backend", "openai", "--model", "fake", "--base-url", fake.url]
        words += ["--tries", "1", "--limit", "2", "--out", str(tmp_path)]
        done = CliRunner().invoke(main, words)
    assert done.exit_code == (2 if fault == "digits" else 0), done.output
    assert "Traceback" not in done.output
    assert "9" * 50 not in done.output
    assert str(10**39) not in done.output


@pytest.mark.parametrize(
    "text",
    [b"\xff\xfe{\x00}\x00", b'{"a": "\xff"}', "[" * 100_000, '{"a": -' + "1" * 60 + "}", ""],
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
    told = json.dumps({"nonverbal": said, "verbal": said, "speech": said})

    def script(state: RawServer, line: socket.socket) -> None:
        hear(state, line)
        speaks = b"voice of an assistive robot" in state.received
        part = ("speech",) if speaks else ("nonverbal", "verbal")
        content = json.dumps({name: json.loads(told)[name] for name in part})
        text = json.dumps({"choices": [{"message": {"content": content}}]}).encode()
        state.received.clear()
        line.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(text), text))

    with raw_server(script) as server:
        words = ["variants", "--backend", "openai", "--model", "fake", "--base-url", server.url]
        done = CliRunner().invoke(main, [*words, "--status", "0000", "--tries", "1"])
    assert done.exit_code == 0, done.output
    assert plain(said) in done.output
    assert all(letter.isprintable() for letter in done.output.replace("\n", ""))


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
