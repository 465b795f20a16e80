"""Whatever bytes a reader of text is given, it returns a valid object or raises ModelError.

Valid scenarios and policies are spoiled at random bytes, and by exchanging values for awkward
ones, the syntax staying sound.
"""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzzing import AWKWARD, CARE, SMALL, STATUSES, fuzz, json_values, spoiled, survives
from hypothesis import given
from hypothesis import strategies as st

from exact_mdp.mdp import MDP, Policy, Scenario
from exact_mdp.mdp.care.toml import parse
from exact_mdp.mdp.io import npz

TOML = (Path(npz.__file__).parent.parent / "scenarios" / "yuan2025.toml").read_bytes()
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


@fuzz
@given(data=st.data())
def test_scenario_bytes(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(data.draw(st.one_of(spoiled(TOML), st.binary(max_size=60))))
    survives(lambda: load_scenario(path))


@fuzz
@given(data=st.data())
def test_scenario_values(tmp_path: Path, data: st.DataObject) -> None:
    lines = TOML.decode().splitlines()
    places = [number for number, line in enumerate(lines) if re.match(r"\S+ *= *", line)]
    for place in data.draw(st.lists(st.sampled_from(places), min_size=1, max_size=3)):
        key = lines[place].partition("=")[0]
        lines[place] = f"{key}= {data.draw(st.sampled_from(AWKWARD_TOML))}"
    path = tmp_path / "s.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    survives(lambda: load_scenario(path))


@fuzz
@given(st.text(max_size=40), st.sampled_from(SMALL.names), st.sampled_from(["", "=", ".", "=1/3"]))
def test_settings(text: str, name: str, middle: str) -> None:
    survives(lambda: SMALL.set(text))
    survives(lambda: SMALL.set(name + middle + text))
    survives(lambda: SMALL.set(f"tasks={text}").compile())
    survives(lambda: SMALL.set(f"max_trial={text}"))


def test_some_spoiled_scenarios_are_still_scenarios() -> None:
    """The fuzzing above would show nothing if no change were ever accepted."""
    assert survives(lambda: parse(TOML.decode().replace("0.05", "0.06"), Scenario))
    assert not survives(lambda: parse(TOML.decode().replace("0.05", "nan"), Scenario))


# ---- policies ---------------------------------------------------------------------------------

JSON = json.dumps(dict.fromkeys(STATUSES, "none") | {"0110": {"none": 0.5, "directive": "1/2"}})
CSV = "status,action,probability\n" + "".join(f"{status},none,1\n" for status in STATUSES)


def read_policy(path: Path, mdp: MDP = CARE) -> None:
    policy = Policy.read(path, mdp)
    weights = policy.weights(mdp)
    assert np.add.reduceat(weights, mdp.pair_offsets[:-1]) == pytest.approx(1)


@fuzz
@given(data=st.data())
def test_policy_bytes(tmp_path: Path, data: st.DataObject) -> None:
    name, content = data.draw(st.sampled_from([("p.json", JSON), ("p.csv", CSV)]))
    path = tmp_path / name
    path.write_bytes(data.draw(st.one_of(spoiled(content.encode()), st.binary(max_size=60))))
    survives(lambda: read_policy(path))


@fuzz
@given(
    changes=st.dictionaries(
        st.sampled_from(STATUSES) | st.sampled_from(AWKWARD), json_values, min_size=1, max_size=3
    )
)
def test_policy_values_in_json(tmp_path: Path, changes: dict[str, Any]) -> None:
    path = tmp_path / "p.json"
    text = json.dumps({**json.loads(JSON), **changes}, ensure_ascii=False)
    path.write_bytes(text.encode("utf-8", "replace"))
    survives(lambda: read_policy(path))
    path.write_bytes(json.dumps(next(iter(changes.values()))).encode())
    survives(lambda: read_policy(path))


@fuzz
@given(data=st.data())
def test_policy_values_in_csv(tmp_path: Path, data: st.DataObject) -> None:
    table = [line.split(",") for line in CSV.splitlines()]
    for _ in range(data.draw(st.integers(1, 3))):
        row = data.draw(st.sampled_from(table))
        row[data.draw(st.integers(0, len(row) - 1))] = data.draw(st.sampled_from(AWKWARD))
    path = tmp_path / "p.csv"
    path.write_bytes("\n".join(",".join(row) for row in table).encode())
    survives(lambda: read_policy(path))


arrays = st.one_of(
    st.builds(
        lambda shape, kind: np.zeros(shape, dtype=kind),
        st.sampled_from([(16, 4), (17, 4), (16, 4, 1), (4, 16), (0,), (), (64,), (16, 0)]),
        st.sampled_from(
            ["f8", "f4", "f2", ">f8", "i8", "u1", "?", "c16", "U3", "S2", "M8[s]", "V8"]
        ),
    ),
    st.lists(st.floats(), min_size=64, max_size=64).map(lambda x: np.array(x).reshape(16, 4)),
)


@fuzz
@given(data=st.data())
def test_q_tables(tmp_path: Path, data: st.DataObject) -> None:
    array, stream = data.draw(arrays), io.BytesIO()
    if data.draw(st.booleans()):
        path = tmp_path / "q.npy"
        np.save(stream, array)
    else:
        path = tmp_path / "q.npz"
        names = data.draw(st.lists(st.sampled_from(["q", "a", "b"]), max_size=2, unique=True))
        np.savez(stream, **dict.fromkeys(names, array))
    content = stream.getvalue()
    path.write_bytes(content)
    survives(lambda: read_policy(path))
    path.write_bytes(data.draw(st.one_of(spoiled(content), st.binary(max_size=60))))
    survives(lambda: read_policy(path))
