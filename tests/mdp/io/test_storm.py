"""The model checker Storm against ours, over UMB files in both directions.

Storm is no dependency and its wheel is large, so that these tests run where it is installed:
`make bench`, or `pytest -m storm`.
"""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracle import Oracle

from exact_mdp.mdp import MDP, Scenario
from exact_mdp.mdp.io import umb

pytestmark = [pytest.mark.bench, pytest.mark.storm]

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
    """The same rational number from Storm's policy iteration and from the reference model."""
    mdp = Scenario.load("yuan2025").with_(readings=readings).compile()
    umb.save(mdp, tmp_path / "care.umb")
    model = stormpy.build_model_from_umb(str(tmp_path / "care.umb"))
    assert (model.nr_states, model.nr_choices) == (mdp.n_states, mdp.n_pairs)
    found = answer(stormpy, model, 'R{"reward"}max=? [F "terminal"]')
    oracle = Oracle(readings)
    assert Fraction(str(found)) == oracle.value(oracle.start)


def test_storm_evaluates_a_policy_by_component(stormpy: Any, tmp_path: Path) -> None:
    """With a single action left, the expected totals of all components are the reference's."""
    mdp = Scenario.load("yuan2025").compile()
    kept = [
        pair for pair in range(mdp.n_pairs) if mdp.actions[mdp.pair_action[pair]] == "directive"
    ]
    kept.append(mdp.n_pairs - 1)
    chain = MDP.from_pairs(
        mdp.pair_state[kept],
        np.zeros(len(kept), dtype=int),
        mdp.transition[kept],
        mdp.reward[kept],
        component_names=mdp.component_names,
        components=mdp.components[kept],
    )
    umb.save(chain, tmp_path / "chain.umb")
    model = stormpy.build_model_from_umb(str(tmp_path / "chain.umb"))
    oracle = Oracle()
    wanted = oracle.evaluate(lambda state: {"directive": Fraction(1)}, distribution=False)
    for name, value in wanted["components"].items():
        known_as = re.sub(r"\W", "_", name)
        found = answer(stormpy, model, f'R{{"{known_as}"}}max=? [F "terminal"]')
        assert float(found) == pytest.approx(float(value), abs=1e-5)


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
        mdp = umb.load(tmp_path / "walk.umb", reward=name, discount=1)
        assert set(mdp.actions) == {"run", "jump", "rest"}
        value = np.zeros(mdp.n_states)
        for _ in range(2000):
            value = np.minimum.reduceat(mdp.backup(value), mdp.pair_offsets[:-1])
        assert value[mdp.start[0][0]] == pytest.approx(float(wanted), rel=1e-5)
