"""The model checker Storm against ours, over UMB files in both directions.

Storm is no dependency and its wheel is large, so that these tests run where it is installed:
`make bench`, or `pytest -m storm`.
"""

import json
from copy import deepcopy
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from care_oracle import Oracle
from cli_runner import run
from refusal_tables import refused

from exact_mdp import MDP, Scenario, certify, load, return_distribution, save

pytestmark = pytest.mark.storm

READINGS = [
    {},
    {"influence_orientation": "column-to-row", "status_cost": "current"},
    {"skip_timestep": "own", "task_bonus": "no-subtask-skipped", "max_trial_rule": "after"},
]
PRISM = """mdp
module walk
  place: [0..3] init 0;
  [run] place < 3 -> 1/3: (place' = place + 1) + 2/3: (place' = 0);
  [jump] place < 3 -> 0.25: (place' = 3) + 0.75: (place' = place);
  [rest] place = 3 -> true;
endmodule
label "goal" = place = 3;
rewards "cost"
  [run] true : 1;
  [jump] true : 2.5;
  place = 1 : 7;
endrewards
rewards "steps"
  place < 3 : 1;
endrewards
"""


@pytest.fixture
def stormpy() -> Any:
    return pytest.importorskip("stormpy")


def answer(stormpy: Any, model: Any, query: str) -> Any:
    (formula,) = stormpy.parse_properties(query)
    return stormpy.model_checking(model, formula).get_value(model.initial_states[0])


def walk_of(stormpy: Any, tmp_path: Path, kind: Any) -> Any:
    """The program as a model of Storm in memory, in numbers of a kind, with all its parts."""
    (tmp_path / "walk.prism").write_text(PRISM, encoding="utf-8")
    options = stormpy.BuilderOptions()
    options.set_build_all_reward_models()
    options.set_build_all_labels()
    options.set_build_choice_labels(True)
    options.set_build_state_valuations(True)
    program = stormpy.parse_prism_program(str(tmp_path / "walk.prism"))
    return stormpy.build_model[kind](program, options=options)


@pytest.mark.filterwarnings("ignore:.*are added up")
@pytest.mark.parametrize("exactly", [True, False])
def test_explicit_files_and_models_in_memory(
    stormpy: Any, tmp_path: Path, *, exactly: bool
) -> None:
    """Each is the model of the program; one in doubles has floats."""
    model = walk_of(stormpy, tmp_path, stormpy.Rational if exactly else float)
    whole, exporter = load(tmp_path / "walk.prism"), stormpy.developer
    options = exporter.DirectEncodingExporterOptions()
    exporter.export_sparse_model_as_drn(model, str(tmp_path / "walk.drn"), options)
    for again in (load(model), load(tmp_path / "walk.drn")):
        assert (again.n_states, again.n_pairs) == (whole.n_states, whole.n_pairs)
        assert sorted(again.actions) == sorted(whole.actions)
        assert sorted(again.component_names) == ["cost", "steps"]
        for name in ("cost", "steps"):
            value = certify(again.with_(sense="min").until("goal", reward=name)).start_value
            wanted = certify(whole.with_(sense="min").until("goal", reward=name)).start_value
            assert float(value) == pytest.approx(float(wanted), rel=1e-12)
            assert value == wanted or not exactly
    assert load(model, discount="1/2", start=1).start[0][0] == 1


def test_other_models_of_storm_are_refused(stormpy: Any, tmp_path: Path) -> None:
    (tmp_path / "queue.prism").write_text(
        "ctmc\nmodule queue\n n: [0..2] init 0;\n [] n<2 -> 3 : (n'=n+1);\n endmodule\n"
    )
    program = stormpy.parse_prism_program(str(tmp_path / "queue.prism"), prism_compatibility=True)
    refused(lambda: load(stormpy.build_model[float](program)), "CTMC cannot be taken", "", "DTMC")
    refused(lambda: load(program), "a PrismProgram is not a model", "model", "sparse model")


def test_rewards_without_a_name_are_called_unnamed(tmp_path: Path) -> None:
    (path := tmp_path / "two.prism").write_text(
        "mdp\nmodule m\n s: [0..1] init 0;\n [] s=0 -> (s'=1);\n endmodule\n"
        'rewards s=0 : 3; endrewards\nrewards "unnamed" s=0 : 4; endrewards\n'
    )
    with pytest.warns(UserWarning, match="rewards unnamed, unnamed' are added up"):
        mdp = load(path, discount=1)
    assert mdp.component_names == ("unnamed", "unnamed'")
    assert certify(mdp.earning("unnamed'")).start_value == 3


@pytest.mark.parametrize("readings", READINGS, ids=range(len(READINGS)))
def test_storm_finds_the_exact_optimum(
    stormpy: Any, tmp_path: Path, readings: dict[str, str]
) -> None:
    mdp = Scenario.load("yuan2025").with_(readings=readings).compile()
    save(mdp, tmp_path / "care.umb")
    model = stormpy.build_model_from_umb(str(tmp_path / "care.umb"))
    assert (model.nr_states, model.nr_choices) == (mdp.n_states, mdp.n_pairs)
    value = answer(stormpy, model, 'R{"reward"}max=? [F "terminal"]')
    oracle = Oracle(readings)
    assert Fraction(str(value)) == oracle.value(oracle.start)


def test_a_program_becomes_an_exact_model(stormpy: Any, tmp_path: Path) -> None:
    """Rationals, rewards of states and choices, actions, labels, and names by variables."""
    (tmp_path / "walk.prism").write_text(PRISM, encoding="utf-8")
    with pytest.warns(UserWarning, match="are added up"):
        mdp = load(tmp_path / "walk.prism")
    assert (mdp.name, mdp.discount_exact, sorted(mdp.actions)) == (
        "walk",
        1,
        ["jump", "rest", "run"],
    )
    known = {mdp.space.label(state): state for state in range(mdp.n_states)}
    assert set(known) == {f"state place={n}" for n in range(4)}
    one, goal = known["state place=1"], known["state place=3"]
    assert {name: np.flatnonzero(on).tolist() for name, on in mdp.labels.items()} == {
        "goal": [goal], "init": [known["state place=0"]], "deadlock": [],
    }  # fmt: skip
    pair = mdp.pair(one, mdp.action("run"))
    assert {n: p for p, n, _ in mdp.table.row(pair)} == {
        known["state place=2"]: Fraction(1, 3), known["state place=0"]: Fraction(2, 3),
    }  # fmt: skip
    components = dict(zip(mdp.component_names, mdp.components[pair].tolist(), strict=True))
    assert components == {"cost": 8, "steps": 1}
    wanted = 'R{"steps"}min=? [F "goal"]'
    model = stormpy.build_model(stormpy.parse_prism_program(str(tmp_path / "walk.prism")))
    value = certify(mdp.with_(sense="min").until("goal", "steps")).start_value
    assert float(value) == pytest.approx(float(answer(stormpy, model, wanted)), rel=1e-5)


def program(lines: str, *, head: str = "mdp", reward: str = "0") -> str:
    """A program of one variable s from 0 to 2, with lines of its own."""
    rewards = f"rewards true : {reward}; endrewards" * (reward != "0")
    return f"{head}\nmodule m\n s : [0..2] init 0;\n{lines}\nendmodule\n{rewards}"


GO = "[go] s=0 -> (s'=1);"


@pytest.mark.parametrize(
    ("text", "what", "fix"),
    [
        (PRISM.replace("mdp", "ctmc", 1).replace("[jump]", "[run]"), "the model is a CTMC", "DTMC"),
        (PRISM.replace("place < 3 : 1;", "[run] true -> true : 1;"), "next state", "actions"),
        (PRISM.replace("0..3", "0..N"), "Storm says", "that place"),
        (program(GO, head="mdp const int N;"), "the constant N has no value", "--constants N=…;"),
        (program(GO, head="mdp const int N; const double p;"), "the constants N, p", "N=…,p=…"),
        ("mdp mdp", "Storm says", "that place"),
        (program(GO, head=""), "not begin with the type", '"mdp"'),
        (program("[go] s=0 -> (t'=1);"), "Unknown variable 't'", "that this names"),
        # A value out of its range would be another one: s'=5 would be s'=1.
        (program("[go] s=0 -> (s'=5);"), "out-of-bounds value (5)", "that this names"),
        (program("[go] s=0 -> 0.5:(s'=1);"), "do not sum to one", "that this names"),
        (program(GO, reward="mod(7,4)/10"), "in exact rationals", "write a number"),
        (program(GO, reward="log(3,2)"), "in exact rationals", "write a number"),
        (program(GO, reward="pow(2,0.5)"), "in exact rationals", "write a number"),
        (program(GO, reward="1/s"), "divides by zero", "divides by 0"),
        (program("[go] s=0 -> 1/s:(s'=1);"), "divides by zero", "divides by 0"),
    ],
)
def test_programs_that_are_refused(
    stormpy: Any, tmp_path: Path, text: str, what: str, fix: str
) -> None:
    (tmp_path / "m.prism").write_text(text, encoding="utf-8")
    refused(lambda: load(tmp_path / "m.prism"), what, "m.prism", fix)


def test_a_division_by_zero_ends_a_command_in_words(stormpy: Any, tmp_path: Path) -> None:
    """Storm's process ends by a signal then; and the remedy for an open constant works."""
    text = program("[go] s=0 -> 1/N:(s'=1) + 1-1/N:true;", head="mdp const int N;")
    (path := tmp_path / "m.prism").write_text(text, encoding="utf-8")
    said = run("convert", str(path), str(tmp_path / "m.npz"), "--constants", "N=0").refusal()
    assert "divides by zero" in said
    assert not (tmp_path / "m.npz").exists()
    assert "--constants N=…" in run("solve", str(path)).refusal()
    assert run("solve", str(path), "--constants", "N=2", "--reach", "deadlock").status == 0
    made = run("convert", str(path), str(tmp_path / "m.npz"), "--constants", "N=4", "--json").result
    assert made["states"] == 2
    assert MDP.load(tmp_path / "m.npz").table.row(0)[1][:2] == (Fraction(1, 4), 1)


def test_a_program_that_is_too_large_is_refused(
    stormpy: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = program("[go] s<2 -> (x'=min(x+1,100000000));") + "\nglobal x : [0..100000000] init 0;"
    (tmp_path / "m.prism").write_text(text, encoding="utf-8")
    monkeypatch.setattr("exact_mdp.mdp.io.storm._most_memory", lambda: 250_000_000)
    refused(lambda: load(tmp_path / "m.prism"), "more than 0.25 GB of memory", "m.prism", "smaller")


def test_labels_that_no_state_has_are_reached_with_probability_0(
    stormpy: Any, tmp_path: Path
) -> None:
    (tmp_path / "m.prism").write_text(program(GO) + '\nlabel "bad" = s>1;', encoding="utf-8")
    mdp = load(tmp_path / "m.prism")
    assert {name: on.tolist() for name, on in mdp.labels.items()} == {
        "bad": [False, False], "init": [True, False], "deadlock": [False, True],
    }  # fmt: skip
    assert certify(mdp.reaching("bad")).start_value == 0


def test_choices_keep_their_names_and_states_the_order_of_variables(
    stormpy: Any, tmp_path: Path
) -> None:
    text = """mdp
        module m
          z : [0..1] init 0;
          b : bool init true;
          a : [0..1] init 0;
          [go] z=0 -> (z'=1);
          [go] z=0 -> (b'=false)&(z'=1);
          [] z=0 -> (a'=1)&(z'=1);
        endmodule
        module n = m [z=x, b=c, a=d, go=walk] endmodule"""
    (tmp_path / "m.prism").write_text(text, encoding="utf-8")
    mdp = load(tmp_path / "m.prism")
    assert mdp.space.label(mdp.start[0][0]) == "state z=0, b=true, a=0, x=0, c=true, d=0"
    assert set(mdp.actions) == {
        *("go", "go#2", "walk", "walk#2", "unnamed", "unnamed#2"),
    }
    last = mdp.space.number("z=1, b=true, a=1, x=1, c=true, d=1")  # a deadlock, where Storm stays
    assert mdp.actions[mdp.pair_action[mdp.pair_offsets[last]]] == "unnamed"


JANI: dict[str, Any] = {
    "jani-version": 1,
    "name": "walk",
    "type": "mdp",
    "features": [],
    "variables": [
        {"name": "cost", "type": "real", "transient": True, "initial-value": 0},
        {
            "name": "z",
            "type": {"kind": "bounded", "base": "int", "lower-bound": 0, "upper-bound": 1},
            "initial-value": 0,
        },
        {"name": "b", "type": "bool", "initial-value": True},
    ],
    "actions": [{"name": "go"}],
    "properties": [],
    "automata": [
        {
            "name": "A",
            "locations": [
                {"name": "here"},
                {"name": "there", "transient-values": [{"ref": "cost", "value": 2.5}]},
                {"name": "over"},
            ],
            "initial-locations": ["here"],
            "edges": [
                {
                    "location": "here",
                    "action": "go",
                    "destinations": [
                        {"location": "there", "probability": {"exp": 0.25}},
                        {"location": "over", "probability": {"exp": 0.75}},
                    ],
                },
                {
                    "location": "there",
                    "destinations": [
                        {
                            "location": "over",
                            "assignments": [{"ref": "z", "value": 1}, {"ref": "b", "value": False}],
                        }
                    ],
                },
            ],
        }
    ],
    "system": {"elements": [{"automaton": "A"}]},
}


def pay(*amounts: Any, **other: Any) -> str:
    """The model of which the destinations of the first edge pay these amounts, if any."""
    content = deepcopy(JANI)
    destinations = content["automata"][0]["edges"][0]["destinations"]
    for destination, amount in zip(destinations, amounts, strict=True):
        if amount is not None:
            destination["assignments"] = [{"ref": "cost", "value": amount} | other]
    return json.dumps(content)


def test_a_jani_model_has_the_names_of_its_variables(stormpy: Any, tmp_path: Path) -> None:
    """The transient variable, which is a reward, is no part of them."""
    (tmp_path / "m.jani").write_text(pay(8, 8), encoding="utf-8")
    mdp = load(tmp_path / "m.jani")
    assert mdp.space.label(mdp.start[0][0]) == "state z=0, b=true, _loc_A=0"
    assert mdp.actions == ("go", "unnamed")
    returns = return_distribution(mdp, "random")
    assert (returns.values, returns.probabilities.tolist()) == (
        (8, Fraction(21, 2)),
        [0.75, 0.25],
    )


@pytest.mark.parametrize("text", [pay(8, 4), pay(None, 4), pay(8, None), pay("z", "z", index=1)])
def test_a_jani_reward_that_depends_on_the_destination_is_refused(
    stormpy: Any, tmp_path: Path, text: str
) -> None:
    (tmp_path / "m.jani").write_text(text, encoding="utf-8")
    said = "the reward cost depends on the destination", "automaton A, edge 0", "of its own"
    refused(lambda: load(tmp_path / "m.jani"), *said)


def test_constants_by_name_are_exact(stormpy: Any, tmp_path: Path) -> None:
    text = """mdp
        const int N; const double p;
        module walk
          s : [0..N] init 0;
          [go] s < N -> p : (s'=s+1) + (1-p) : (s'=s);
          [stop] s = N -> true;
        endmodule
        rewards "steps" [go] true : 1; endrewards"""
    (tmp_path / "walk.prism").write_text(text, encoding="utf-8")
    for given, p in (
        ({"N": 3, "p": Fraction(1, 3)}, Fraction(1, 3)),
        ({"N": "3", "p": "1/3"}, Fraction(1, 3)),
        ({"N": 3, "p": 0.1}, Fraction(1, 10)),
        ({"N": np.int64(3), "p": np.float64(0.1)}, Fraction(1, 10)),
        ({"N": 3.0, "p": 1e-05}, Fraction(1, 10**5)),
        ("N=3,p=0.1", Fraction(1, 10)),
    ):
        mdp = MDP.load(tmp_path / "walk.prism", constants=given, discount="1/2")
        assert mdp.n_states == 4
        assert mdp.table.row(0) == [(1 - p, 0, 1), (p, 1, 1)]
    said = "unknown undefined constant 'q'", "constants", "NAME=NUMBER"
    refused(lambda: MDP.load(tmp_path / "walk.prism", constants="N=3,p=1/3,q=1"), *said)
    said = "the constant p has no value", "walk.prism", "--constants N=3,p=…;"
    refused(lambda: MDP.load(tmp_path / "walk.prism", constants="N=3"), *said)
    nan = {"N": 3, "p": float("nan")}
    refused(lambda: MDP.load(tmp_path / "walk.prism", constants=nan), "nan", "constants")


def test_a_model_that_storm_builds_and_writes(stormpy: Any, tmp_path: Path) -> None:
    source = tmp_path / "walk.prism"
    source.write_text(PRISM, encoding="utf-8")
    options = stormpy.BuilderOptions()
    options.set_build_all_reward_models()
    options.set_build_choice_labels(True)
    options.set_build_all_labels()
    program = stormpy.parse_prism_program(str(source))
    model = stormpy.build_model(program, options=options)
    stormpy.io.export_to_umb(model, str(tmp_path / "walk.umb"))
    for name in ("cost", "steps"):
        wanted = answer(stormpy, model, f'R{{"{name}"}}min=? [F "goal"]')
        mdp = load(f"{tmp_path / 'walk.umb'}#{name}", discount=1)
        assert set(mdp.actions) == {"run", "jump", "rest"}
        value = np.zeros(mdp.n_states)
        for _ in range(2000):
            value = np.minimum.reduceat(mdp.backup(value), mdp.pair_offsets[:-1])
        assert value[mdp.start[0][0]] == pytest.approx(float(wanted), rel=1e-5)
