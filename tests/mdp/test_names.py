"""No name steers a terminal, turns the text around it, or makes a report that XML cannot hold."""

from __future__ import annotations

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from archives import read_by_umbi
from cli_runner import run
from own_scenarios import SHIPPED, scenario_of

from exact_mdp import (
    MDP,
    Column,
    Family,
    ModelError,
    Parameter,
    Policy,
    Scenario,
    StateSpace,
    load,
    save,
)

BAD = [
    *map(chr, range(0x20)), *map(chr, range(0x7F, 0xA0)), *map(chr, range(0x202A, 0x202F)),
    *map(chr, range(0x2066, 0x206A)), "\u200e", "\u200f", "\u061c", "\u2028", "\u2029", "\ud800",
    "\udfff", "\ufffe", "\u200b", "\ufeff",
]  # fmt: skip
GOOD = [
    "größer",
    "<script>alert(1)</script>",
    "$x^$",
    "a & b",
    '"q"',
    "'",
    "مساعدة",
    "👩\u200d🔬",
    "`|`",
]
ROWS = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
TEA = SHIPPED["tea"]


def safe(text: str) -> bool:
    """Whether no bad character but the line ends of a message is left in it."""
    return not any(character in text for character in BAD if character != "\n")


def environment(name: str) -> object:
    return SimpleNamespace(
        P={0: {0: [(1.0, 0, 0.0, False)]}},
        initial_state_distrib=[1.0],
        spec=SimpleNamespace(id=name),
    )


MAKERS: dict[str, Callable[[str], object]] = {
    "model": lambda name: MDP.from_outcomes(ROWS, name=name),
    "action": lambda name: MDP.from_outcomes(ROWS, actions=[name]),
    "state": lambda name: MDP.from_outcomes(ROWS, states=["a", name]),
    "component": lambda name: MDP.from_outcomes(ROWS, component_names=(name,)),
    "event": lambda name: MDP.from_outcomes(ROWS, events=(name,)),
    "parameter": lambda name: Parameter(name=name, value=Fraction(1)),
    "column": lambda name: Column(name=name, size=2),
    "word": lambda name: Column(name="c", size=1, words=(name,)),
    "extra": lambda name: StateSpace(columns=(), extra=(name,)),
    "changed": lambda name: MDP.from_outcomes(ROWS).with_(name=name),
    "arrays": lambda name: MDP.from_arrays([np.eye(1)], [1.0], 0.5, actions=[name]),
    "pairs": lambda name: MDP.from_pairs([0], [0], [[1.0]], [1.0], 0.5, states=[name]),
    "environment": lambda name: MDP.from_gymnasium(environment(name)),
    "policy": lambda name: Policy(
        space=StateSpace(columns=()), actions=(name,), rule=np.ones((1, 1))
    ),
    "family": lambda name: Family(parameters=(), build=lambda _: None, name=name),
    "scenario": lambda name: Scenario(**{**vars(Scenario.load("tea")), "name": name}),
}


@pytest.mark.parametrize("kind", MAKERS)
def test_constructors_refuse_them_by_their_number(kind: str) -> None:
    """Every constructor names the character as U+XXXX, and takes what people write."""
    for character in BAD:
        with pytest.raises(ModelError, match=f"U\\+{ord(character):04X}") as caught:
            MAKERS[kind](f"go{character}x")
        assert safe(str(caught.value))
    with pytest.raises(ModelError, match="1,001 characters"):
        MAKERS[kind]("n" * 1001)
    for name in (*GOOD, "n" * 1000):
        MAKERS[kind](name)


@pytest.mark.parametrize("character", ["\\u202e", "\\u001b", "\\u0085", "\\u2028"])
def test_scenario_files_refuse_them(character: str) -> None:
    """A scenario's name, actions, statuses, title and source are held to the same rule."""
    number = int(character[2:], 16)
    for old in ('name = "tea', 'title = "', 'source = "'):
        assert old in TEA
        with pytest.raises(ModelError, match=f"U\\+{number:04X}"):
            scenario_of(TEA.replace(old, f"{old}{character}", 1))
    for word in (Scenario.load("tea").actions[0], Scenario.load("tea").statuses[0]):
        with pytest.raises(ModelError):
            scenario_of(TEA.replace(f'"{word}"', f'"{word}{character}"', 1))


def test_saved_models_refuse_them(tmp_path: Path) -> None:
    """A file made elsewhere is no way around the rule."""
    import umbi

    mdp = MDP.from_outcomes(ROWS, "1/2", actions=["go"], name="m")
    save(mdp, tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(arrays["header"].tobytes())
    for key, value in (("name", "\u202e"), ("actions", ["\x1b[2J"]), ("events", ["\ud800"])):
        text = json.dumps(header | {key: value}).encode()
        np.savez(tmp_path / "bad.npz", **{**arrays, "header": np.frombuffer(text, np.uint8)})
        with pytest.raises(ModelError, match="holds the character U"):
            load(tmp_path / "bad.npz")
    save(mdp, tmp_path / "m.umb")
    content = read_by_umbi(tmp_path / "m.umb")
    content.index.annotations["exact-mdp"]["start"].description = None  # as another program would
    content.choice_action_to_string = ["\x1b[2J"]
    umbi.umb.write(content, tmp_path / "m.umb")
    with pytest.raises(ModelError, match=r"U\+001B"):
        load(tmp_path / "m.umb", discount=1)


def test_policy_files_that_hold_them(tmp_path: Path) -> None:
    """A word that is no action is shown escaped."""
    mdp = MDP.from_outcomes([*ROWS, (0, 1, [(1, 0, 0)])], "1/2")
    (tmp_path / "p.csv").write_text("state,action\n0,\x1b[31m\u202e\n", encoding="utf-8")
    (tmp_path / "p.json").write_text(json.dumps({"0": "\x1b[31m", "\u202e": "0"}), encoding="utf-8")
    for name in ("p.csv", "p.json"):
        with pytest.raises(ModelError) as caught:
            Policy.of(mdp, tmp_path / name)
        assert safe(str(caught.value))


def test_paths_that_hold_them(tmp_path: Path) -> None:
    """The path of a file reaches no terminal raw, in errors nor in results nor in warnings."""
    name = "a\x1b[31m\u202e\nwhere: b.npz"
    told = run("info", tmp_path / name)
    assert (told.status, told.out) == (2, "")
    assert safe(told.err)
    assert told.err.count("where:") == 2
    assert len(told.err.splitlines()) == 3
    told = run("check", "yuan2025", "optimal", f"--{name}")
    assert told.status == 2
    assert safe(told.err)
    small = ["--set", "tasks=[1]", "--set", "max_trial=1"]
    told = run("convert", "yuan2025", tmp_path / name, *small)
    assert told.status == 0
    assert safe(told.out)
    told = run("convert", "yuan2025", tmp_path / name, "--json", *small)
    assert told.result["written"] == str(tmp_path / name)


def test_shown_text_is_the_same_twice() -> None:
    """Text that was escaped is not escaped again where an error is wrapped in another."""
    for character in BAD:
        once = ModelError(f"a{character}b").what
        assert safe(once) or character == "\n"
        assert ModelError(once).what == once
    for name in GOOD:
        assert ModelError(name).what == name
