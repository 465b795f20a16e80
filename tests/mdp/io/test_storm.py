"""The model checker Storm against ours, over UMB files in both directions.

Storm is no dependency and its wheel is large, so that these tests run where it is installed:
`make bench`, or `pytest -m storm`.
"""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from care_oracle import Oracle
from refusal_tables import refused

from exact_mdp import MDP, Scenario, certify, load, save

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
        "goal": [goal]
    }
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


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PRISM.replace("mdp", "ctmc", 1).replace("[jump]", "[run]"), "CTMC"),
        (PRISM.replace("place < 3 : 1;", "[run] true -> true : 1;"), "Storm says"),
        (PRISM.replace("0..3", "0..N"), "Storm says"),
        (PRISM.replace("module walk", "const int N;\nmodule walk"), "a constant has no value"),
        ("mdp mdp", "Storm says"),
    ],
)
def test_programs_that_are_refused(stormpy: Any, tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "m.prism").write_text(text, encoding="utf-8")
    refused(lambda: load(tmp_path / "m.prism"), said)


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
    for given in ({"N": 3, "p": Fraction(1, 3)}, {"N": "3", "p": "1/3"}):
        mdp = MDP.load(tmp_path / "walk.prism", constants=given, discount="1/2")
        assert mdp.n_states == 4
        assert mdp.table.row(0) == [(Fraction(2, 3), 0, 1), (Fraction(1, 3), 1, 1)]


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
