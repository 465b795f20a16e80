"""What fronts, limits and weights must not claim."""

from dataclasses import replace
from fractions import Fraction as F
from math import inf
from pathlib import Path

import pytest

from exact_mdp import MDP, ModelError, certify, check, rationalize, solve, tradeoff

STAY_OR_GO = [(0, 0, [(1, 1, -5)]), (0, 1, [(1, 2, -1)]), (1, 0, [(1, 1, 0)])]
HOME = {"home": [False, True, False]}
TWO = MDP.from_outcomes(
    [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])],
    components={"gain": [6, 3, 0], "effort": [-1, 0, 0]},
)


@pytest.mark.parametrize("trap", [[(1, 2, 0)], [("1/2", 2, 1), ("1/2", 2, -1)]])
def test_totals_are_refused_where_a_run_may_end_beside_the_goal(trap: list[object]) -> None:
    mdp = MDP.from_outcomes([*STAY_OR_GO, (2, 0, trap)], labels=HOME).until("home")
    for call in (
        lambda: solve(mdp, subject_to={"reward": ">= -3"}),
        lambda: tradeoff(mdp, ["reward", "steps"]),
        lambda: rationalize(mdp, [0, 0, 0]),
    ):
        with pytest.raises(ModelError, match=r"beside the goal|no finite total"):
            call()
    assert solve(mdp.with_(start=[0, 1, 0]), subject_to={"reward": ">= -3"}).start_value == 0


def test_a_proof_of_totals_does_not_hold_where_a_run_may_end_beside_the_goal() -> None:
    plain = MDP.from_outcomes([*STAY_OR_GO, (2, 0, [(1, 2, 0)])], labels=HOME)
    mdp = plain.until("home")
    proof = solve(mdp.with_(goal=None), subject_to={"reward": ">= -3"})
    assert proof.violations() == []
    totals = proof.of.counted()
    totals.model.goal = {1}
    assert any("beside the goal" in fault for fault in totals.sound(proof.rank))


def test_weights_are_those_of_all_components() -> None:
    alone = MDP.from_outcomes([(0, 0, [(1, 1, -1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])])
    true, other = (rationalize(mdp, {"0": "1", "1": "0"}) for mdp in (TWO, alone))
    false = replace(other, objectives=("effort",), model=true.model, mdp=TWO)
    assert (true.change, false.change) == (F(1, 2), 0)
    assert false.violations() == ["what is weighed are not the components of the reward"]
    cut = replace(true.cuts[0], multiplier=inf)
    assert replace(true, cuts=(cut,), change=F(2)).violations()
    assert replace(true, kind="front").violations()


def test_limits_on_one_name_keep_their_own_closest_bounds() -> None:
    solution = solve(TWO, subject_to={"gain": [">= 9", "<= 4"]})
    assert solution.closest == {"gain >= 9": F(6), "gain <= 4": F(7)}
    assert solution.frame()["closest"].tolist() == [F(6), F(7)]


def test_a_proof_is_loaded_with_its_own_model_only(tmp_path: Path) -> None:
    front = tradeoff(TWO, ["gain", "effort"])
    front.save(path := tmp_path / "front.json")
    assert type(front).load(path, TWO).vertices == front.vertices
    with pytest.raises(ModelError, match="another model"):
        type(front).load(path, TWO.with_(discount="1/2"))


# ---- amounts in floats ---------------------------------------------------------------------------

PARTS = {"a": [0.1, 0.7, 0.0], "b": [0.2, 0.0, 0.0], "c": [0.3, 0.0, 0.0]}
REWARD = [0.1 + 0.2 + 0.3, 0.7, 0.0]


def with_floats(first: str = "a") -> MDP:
    """Amounts in floats, whose rounded sum is the reward: the objective is the reward itself."""
    parts = {first if name == "a" else name: amount for name, amount in PARTS.items()}
    rows = [[0, 1], [0, 1], [0, 1]]
    return MDP.from_pairs([0, 0, 1], [0, 1, 0], rows, REWARD, components=parts)


@pytest.mark.parametrize("first", ["a", "reward", "return"])
def test_the_optimum_under_limits_is_one_of_the_reward(first: str) -> None:
    """Also where a component is called as the reward is, or as the objective."""
    mdp = with_floats(first)
    assert mdp.component_names == (first, "b", "c")
    assert sum(map(F, (0.1, 0.2, 0.3))) != F(REWARD[0])
    free = solve(mdp, subject_to={first: "<= 9"})
    assert (free.start_value, free.violations()) == (certify(mdp).start_value, [])
    solution = solve(mdp, subject_to={first: "<= 1/2"})
    share = (F(1, 2) - F(0.1)) / (F(0.7) - F(0.1))
    assert solution.start_value == (1 - share) * F(REWARD[0]) + share * F(0.7)
    assert solution.violations() == []
    audit = check(mdp, [0, 0], subject_to={first: "<= 1/2"})
    assert audit.regret.at_start.value == solution.start_value - F(REWARD[0])


def test_fronts_and_weights_are_of_the_amounts_as_given() -> None:
    mdp = with_floats()
    front = tradeoff(mdp, ["a", "reward"])
    assert front.violations() == []
    assert front.vertices == [(F(0.7), F(0.7))]
    least_change = rationalize(mdp, [0, 0])
    assert least_change.violations() == []
    assert least_change.possible
    assert rationalize(mdp, [1, 0]).change == 0
