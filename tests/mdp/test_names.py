"""No name steers a terminal, turns the text around it, or makes a report that XML cannot hold."""

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from archives import read_by_umbi
from cli_runner import run
from refusal_tables import refused

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
GOOD = ["größer", "<script>alert(1)</script>", "$x^$", "a & b", '"q"', "'", "مساعدة", "👩\u200d🔬",
        "`|`"]  # fmt: skip
ROWS = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
TEA = Scenario.load("tea")


def safe(text: str) -> bool:
    return not any(character in text for character in BAD if character != "\n")


def environment(name: str) -> object:
    chances = {0: {0: [(1.0, 0, 0.0, False)]}}
    spec = SimpleNamespace(id=name)
    return SimpleNamespace(P=chances, initial_state_distrib=[1.0], spec=spec)


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
    "scenario": lambda name: Scenario(**{**vars(TEA), "name": name}),
}


@pytest.mark.parametrize("kind", MAKERS)
def test_constructors_refuse_them_by_their_number(kind: str) -> None:
    for character in BAD:
        with pytest.raises(ModelError, match=f"U\\+{ord(character):04X}") as caught:
            MAKERS[kind](f"go{character}x")
        assert safe(str(caught.value))
    refused(lambda: MAKERS[kind]("n" * 1001), "1,001 characters")
    for name in (*GOOD, "n" * 1000):
        MAKERS[kind](name)


@pytest.mark.parametrize("character", "\u202e\x1b\x85\u2028")
@pytest.mark.parametrize("key", ["title", "source"])
def test_titles_and_sources_of_scenarios_refuse_them(key: str, character: str) -> None:
    with pytest.raises(ModelError, match=f"U\\+{ord(character):04X}"):
        Scenario(**{**vars(TEA), key: f"a{character}b"})


def test_files_made_elsewhere_are_no_way_around_the_rule(tmp_path: Path) -> None:
    import umbi

    mdp = MDP.from_outcomes([*ROWS, (0, 1, [(1, 0, 0)])], "1/2", actions=["go", "1"], name="m")
    save(mdp, tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(arrays["header"].tobytes())
    spoiled = {"name": "\u202e", "actions": ["\x1b[2J", "1"], "events": ["\ud800"]}
    for key, value in spoiled.items():
        text = json.dumps(header | {key: value}).encode()
        np.savez(tmp_path / "bad.npz", **{**arrays, "header": np.frombuffer(text, np.uint8)})
        with pytest.raises(ModelError, match="contains the character U"):
            load(tmp_path / "bad.npz")
    save(mdp, tmp_path / "m.umb")
    content = read_by_umbi(tmp_path / "m.umb")
    content.index.annotations["exact-mdp"]["start"].description = None  # as another program would
    content.choice_action_to_string = ["\x1b[2J", "1"]
    umbi.umb.write(content, tmp_path / "m.umb")
    refused(lambda: load(tmp_path / "m.umb", discount=1), "U+001B")
    (tmp_path / "p.csv").write_text("state,action\n0,\x1b[31m\u202e\n", encoding="utf-8")
    (tmp_path / "p.json").write_text(json.dumps({"0": "\x1b[31m", "\u202e": "0"}), encoding="utf-8")
    for name in ("p.csv", "p.json"):  # a word that is no action is shown escaped
        with pytest.raises(ModelError) as caught:
            Policy.of(mdp, tmp_path / name)
        assert safe(str(caught.value))


def test_paths_that_hold_them(tmp_path: Path) -> None:
    path = tmp_path / "a\x1b[31m\u202e\nwhere: b.npz"
    said = run("info", path).refusal()
    assert safe(said)
    assert (said.count("where:"), len(said.splitlines())) == (2, 3)
    assert safe(run("check", "yuan2025", "optimal", f"--{path.name}").refusal())
    words = ["convert", "yuan2025", path, "--set", "tasks=[1]", "--set", "max_trial=1"]
    done = run(*words)
    assert done.status == 0
    assert safe(done.out)
    assert run(*words, "--json").result["written"] == str(path)


def test_shown_text_is_the_same_twice() -> None:
    """Text that was escaped is not escaped again where an error is wrapped in another."""
    for name in (*GOOD, *(f"a{character}b" for character in BAD)):
        once = ModelError(name).what
        assert safe(once)
        assert ModelError(once).what == once
    assert all(ModelError(name).what == name for name in GOOD)


def test_a_list_of_long_names_in_advice_ends_after_some() -> None:
    """Names of states may be as long as their columns are many."""
    labels = {f"{letter * 700}": [True] for letter in "abcdefghij"}
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 0)])], labels=labels)
    with pytest.raises(ModelError, match="unknown label") as error:
        mdp.until("home")
    assert "choose one of the 10 known names, such as aaa" in error.value.fix
    assert len(str(error.value)) < 1000
    assert len(ModelError("wrong", fix="x" * 9000).fix) <= 2000
