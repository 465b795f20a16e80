"""Whatever bytes a reader is given, it returns a valid object or raises ModelError.

Valid files are spoiled at random bytes, and by exchanging values for awkward ones, the syntax
staying sound. The arrays of archives are spoiled and packed anew, since a checksum would find any
change of theirs.
"""

import json
import re
from collections.abc import Callable
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from archives import array_header, tarred, untarred, unzipped, zipped
from certified_models import MODELS, certified
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from own_scenarios import SHIPPED

from exact_mdp import (
    MDP,
    BoundedCertificate,
    Certificate,
    ModelError,
    Policy,
    Scenario,
    certify,
    load,
)

SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=1)
CARE = SMALL.compile()
STATUSES = [format(number, "04b") for number in range(16)]
TOY = MDP.from_outcomes(
    [(0, 0, [("1/3", 0, 1), ("2/3", 1, "1/7")]), (0, 1, [(1, 1, 5)]), (1, 0, [(1, 1, 0)])],
    "9/10", name="toy", states=["here", "there"], actions=["stay", "go"],
)  # fmt: skip

# What is read in spite of an edit may be a file of another program, of which a warning says more.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

fuzz = settings(
    max_examples=120,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@st.composite
def spoiled(draw: st.DrawFn, content: bytes) -> bytes:
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        first = draw(st.integers(0, len(data)))
        last = draw(st.integers(first, min(len(data), first + draw(st.sampled_from([1, 4, 60])))))
        match draw(st.sampled_from(["change", "cut", "copy", "insert", "end"])):
            case "change":
                data[first:last] = draw(st.binary(min_size=last - first, max_size=last - first))
            case "cut":
                del data[first:last]
            case "copy":
                place = draw(st.integers(0, len(data)))
                data[place:place] = data[first:last]
            case "insert":
                data[first:first] = draw(st.binary(max_size=12))
            case "end":
                del data[first:]
    return bytes(data)


def survives(read: Callable[[], object]) -> bool:
    """True where reading gives an object, False where it is refused in so many words."""
    try:
        read()
    except ModelError:
        return False
    return True


AWKWARD = [
    *("none", "skip", "", " none", "0000", "1/0", "-1", "1e400", "nan", "\0", '"', "😀"),
    "9" * 5000,
    *("0110", "2", "0.5", "status", "action", "1e9999999999", "none\n", "=1", "٣"),
]
json_values = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.sampled_from(AWKWARD), st.text()
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(
            st.sampled_from(["none", "directive", "x", ""]) | st.text(max_size=3), inner, max_size=3
        ),
    ),
    max_leaves=5,
)


numbers = st.one_of(
    st.integers(-3, 5), st.sampled_from([2**31, 2**62, 2**63 - 1, -(2**63)]), st.just(10**6)
)


TOML = SHIPPED["yuan2025"]
AWKWARD_TOML = [
    *("0", "1", "-1", "1.5", "1e400", "1e-400", "nan", "inf", "-inf", "true", '""', '"1/0"'),
    *('"1/3"', '"0x1"', '"1e9999"', "9" * 5000, "[]", "[1]", "[[1]]", "{}", "{a = 1}", "'x'"),
    *("1979-05-27", "07:32:00", "0b1", "0o7", "1_000", '"\\u0000"', "[3, true]", "[1e0]", "1e9"),
    *('"' + "9" * 9000 + '"', "[99999999]", "4611686018427387905", '["a", "a"]', "[" * 2000),
]


def load_scenario(path: Path) -> None:
    scenario = Scenario.load(path)
    states = sum(scenario.tasks) * scenario.trials * 2 ** len(scenario.statuses)
    if states < 2000:
        scenario.compile()


JSON = json.dumps(dict.fromkeys(STATUSES, "none") | {"0110": {"none": 0.5, "directive": "1/2"}})
CSV = "status,action,probability\n" + "".join(f"{status},none,1\n" for status in STATUSES)


def read_policy(path: Path, mdp: MDP = CARE) -> None:
    policy = Policy.of(mdp, path)
    weights = policy.weights(mdp)
    assert np.add.reduceat(weights, mdp.pair_offsets[:-1]) == pytest.approx(1)


# ---- bytes of every kind of file ----------------------------------------------------------------

CYCLE = MODELS["cycle"]


def read_certificate(path: Path) -> None:
    """What still is a certificate holds only if it says the same."""
    kind = Certificate if path.stem == "proof" else BoundedCertificate
    again, value = kind.load(path), certified("cycle").value
    if again.violations(CYCLE) == []:
        low, high = (
            (again.value, again.value) if kind is Certificate else (again.lower, again.upper)
        )
        assert all(a <= x <= b for a, x, b in zip(map(F, low), value, map(F, high), strict=True))


def log_of(path: Path) -> None:
    names = ["episode", "state", "action", "reward", "next_state"]
    log = pd.DataFrame([(1, "a", "x", 0, "a")] * 3, columns=names)
    log.to_csv(path, index=False) if path.suffix == ".csv" else log.to_parquet(path)


FILES: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "scenario.toml": (lambda path: path.write_text(TOML), load_scenario),
    "policy.json": (lambda path: path.write_text(JSON), read_policy),
    "policy.csv": (lambda path: path.write_text(CSV), read_policy),
    "q.npy": (lambda path: np.save(path, np.eye(16, 4)), read_policy),
    "q.npz": (lambda path: np.savez(path, np.eye(16, 4)), read_policy),
    **{f"model.{ending}": (TOY.save, load) for ending in ("npz", "umb", "json")},
    "proof.json": (lambda path: certified("cycle").save(path), read_certificate),
    "bounds.json": (lambda path: certify(CYCLE, bounded=True).save(path), read_certificate),
    **{f"log.{ending}": (log_of, MDP.from_transitions) for ending in ("csv", "parquet")},
}
written = dict[str, bytes]()


def valid_file(folder: Path, name: str) -> tuple[Path, bytes, Callable[[Path], object]]:
    """Return a file as it is written, its bytes, and the reader that takes them."""
    (write, read), path = FILES[name], folder / name
    if name not in written:
        write(path)
        assert survives(lambda: read(path))
        written[name] = path.read_bytes()
    path.write_bytes(written[name])
    return path, written[name], read


VALUES = {".toml": r"(?m)(?<== ).*$", ".csv": r"[^,\n]+"}


@pytest.mark.parametrize("name", [name for name in FILES if Path(name).suffix in VALUES])
@fuzz
@given(data=st.data())
def test_values_of_text(folder: Path, name: str, data: st.DataObject) -> None:
    path, content, read = valid_file(folder, name)
    text, other = content.decode(), AWKWARD_TOML if name.endswith("toml") else AWKWARD
    places = list(re.finditer(VALUES[path.suffix], text))
    for place in sorted(data.draw(st.sets(st.integers(0, len(places) - 1), max_size=3)))[::-1]:
        first, last = places[place].span()
        text = text[:first] + data.draw(st.sampled_from(other)) + text[last:]
    path.write_text(text, encoding="utf-8")
    survives(lambda: read(path))


PACKED = {".umb": (untarred, tarred), ".npz": (unzipped, zipped)}


@pytest.mark.parametrize("name", FILES)
@fuzz
@given(data=st.data())
def test_bytes(folder: Path, name: str, data: st.DataObject) -> None:
    path, content, read = valid_file(folder, name)
    if path.suffix in PACKED and data.draw(st.booleans()):  # members, packed anew
        unpack, pack = PACKED[path.suffix]
        members = unpack(path)
        for member in data.draw(st.lists(st.sampled_from(sorted(members)), min_size=1, max_size=2)):
            other = st.sampled_from([*members.values()])
            members[member] = data.draw(st.one_of(spoiled(members[member]), other))
        path.write_bytes(pack(members))
    else:
        path.write_bytes(data.draw(st.one_of(spoiled(content), st.binary(max_size=60))))
    survives(lambda: read(path))


def opened(path: Path) -> tuple[Any, Callable[[Any], object]]:
    """The JSON of a file, or of the header of an archive, and what writes another in its place."""
    if path.suffix == ".json":
        return json.loads(path.read_text()), lambda content: path.write_bytes(encoded(content))
    unpack, pack = PACKED[path.suffix]
    members, name = unpack(path), "index.json" if path.suffix == ".umb" else "header.npy"
    start = members[name].index(b'{"') if path.suffix == ".npz" else 0

    def write(content: Any) -> None:
        data = encoded(content)
        if path.suffix == ".npz":
            data = array_header(f"({len(data)},)", "|u1") + data
        path.write_bytes(pack(members | {name: data}))

    return json.loads(members[name][start:]), write


def encoded(content: Any) -> bytes:
    return json.dumps(content, ensure_ascii=False).encode("utf-8", "replace")


@pytest.mark.parametrize("name", [n for n in FILES if n.endswith("json") or n.startswith("model.")])
@fuzz
@given(data=st.data())
def test_values_of_json(folder: Path, name: str, data: st.DataObject) -> None:
    path, _, read = valid_file(folder, name)
    content, write_again = opened(path)
    places: list[tuple[Any, Any]] = []

    def visit(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                visit(node[key])

    visit(content)
    for node, key in data.draw(st.lists(st.sampled_from(places), min_size=1, max_size=2)):
        node[key] = data.draw(st.one_of(json_values, numbers, st.sampled_from(["1/3", "-1", "2"])))
        if isinstance(node, dict) and data.draw(st.integers(0, 3)) == 0:
            node[data.draw(st.sampled_from(AWKWARD))] = node.pop(key)
    write_again(content)
    survives(lambda: read(path))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")
