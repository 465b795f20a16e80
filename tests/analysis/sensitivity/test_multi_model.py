"""One policy for several models: against brute force, and the bounds of the literature."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import distributions, model_of

from exact_mdp.analysis.sensitivity.multi_model import multi_model, restricted
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.solvers import evaluate, solve


@st.composite
def families(draw: st.DrawFn) -> list[MDP]:
    """Models of 4 states with the same actions in each; state 0 ends where there is no discount."""
    discount = draw(st.sampled_from([Fraction(9, 10), Fraction(1)]))
    actions = [1, *(draw(st.integers(1, 3)) for _ in range(3))]
    models = []
    for _ in range(draw(st.integers(1, 3))):
        rows = [(0, 0, Fraction(0), {0: Fraction(1)})]
        for state in range(1, 4):
            for action in range(actions[state]):
                through = draw(st.integers(0, state - 1))
                law = draw(distributions(range(4), through=through))
                rows.append((state, action, Fraction(draw(st.integers(-4, 4))), law))
        models.append(model_of(4, rows, discount, start=3))
    return models


def weighted(models: list[MDP], weights: np.ndarray, actions: tuple[int, ...]) -> float:
    return float(
        sum(w * evaluate(m, list(actions)).mean for w, m in zip(weights, models, strict=True))
    )


@settings(max_examples=8)
@given(families(), st.lists(st.integers(0, 5), min_size=3, max_size=3))
def test_the_best_policy_by_brute_force(models: list[MDP], numbers: list[int]) -> None:
    weights = np.array(numbers[: len(models)], dtype=float)
    if not weights.sum():
        weights[:] = 1.0
    found = multi_model(models, weights)
    share = weights / weights.sum()
    first = models[0]
    offered = [[first.pair_action[p] for p in first.pairs_of(s)] for s in range(4)]
    best = max(weighted(models, share, actions) for actions in product(*offered))
    size = 1 + abs(best)
    assert found.value.value == pytest.approx(best, abs=1e-7 * size)
    assert best <= found.upper + 1e-9 * size
    assert found.gap <= 1e-7 * size
    assert found.value.value <= found.wait_and_see.value + 1e-9 * size
    assert found.value.value == pytest.approx(
        weighted(models, share, tuple(found.policy.tolist())), abs=1e-9 * size
    )
    for each in found.found_by.values():
        assert each.value <= found.value.value + 1e-9 * size


def test_without_branching_the_bound_is_wait_and_see() -> None:
    scenarios = [
        Scenario.load("yuan2025").with_(parameters={"base.anger": f"{k}/20"}) for k in (1, 6)
    ]
    models = [scenario.compile() for scenario in scenarios]
    found = multi_model(models, parts=1)
    assert found.upper == pytest.approx(found.wait_and_see.value, abs=1e-9)
    assert found.value.interval[0] <= found.upper
    assert {"mean-value policy", "weight-select-update", "improved"} <= set(found.found_by)


def test_status_policies_of_the_care_model_by_brute_force() -> None:
    """Two statuses matter where the others are frozen: all 16 policies over them are tried."""
    small = Scenario.load("tea")
    name = small.parameters[0].name
    models = [small.with_(parameters={name: value}).compile() for value in ("1/20", "1/2", "9/10")]
    found = multi_model(models, [1, 2, 1], columns=["status"])
    mdp = models[0]
    status = mdp.space.values("status")
    free = ~mdp.forced
    for key in np.unique(status[free]):
        assert len(set(found.policy[free & (status == key)].tolist())) == 1
    share = np.array([0.25, 0.5, 0.25])
    keys = np.unique(status[free]).tolist()
    assert len(keys) <= 8
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.integers(0, 3, max(keys) + 1)
        policy = np.where(free, actions[np.maximum(status, 0)], found.policy)
        value = weighted(models, share, tuple(policy.tolist()))
        assert value <= found.upper + 1e-9
    assert found.gap < 1e-6


def test_one_model_is_its_own_optimum() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1]).compile()
    found = multi_model([mdp, mdp.with_(name="again")], [3, 0])
    assert found.value.value == pytest.approx(solve(mdp).start_value, abs=1e-9)
    assert found.parts == 1
    assert (found.frame()["regret (reward)"].abs() < 1e-9).all()


@pytest.mark.parametrize("weights", [[1], [1, -1], [0, 0], [1, float("nan")], [1, float("inf")]])
def test_what_are_no_weights_is_refused(weights: list[float]) -> None:
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])
    with pytest.raises(ModelError):
        multi_model([mdp, mdp], weights)


def test_models_that_do_not_match_are_refused() -> None:
    one = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])
    two = MDP.from_arrays([[[0, 1], [0, 1]]] * 2, [1, 0])
    with pytest.raises(ModelError, match="model 1"):
        multi_model([one, two])
    with pytest.raises(ModelError, match="no model"):
        multi_model([])


def test_a_restricted_model_keeps_its_rows() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1]).compile()
    pairs = np.flatnonzero((mdp.pair_action == 1) | mdp.forced[mdp.pair_state])
    part = restricted(mdp, pairs)
    assert solve(part).start_value == pytest.approx(evaluate(mdp, "always:supportive").mean)
