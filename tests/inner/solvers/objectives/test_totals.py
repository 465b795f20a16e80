"""Policies by several totals at once: each is evaluated alone, and all of them are tried."""

from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np
import pytest
from oracle import mixed, policy_values, rows_of, visits
from small_models import given, random_policy, small_model

from exact_mdp import MDP, ModelError
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.totals import (
    OccupancyMeasure,
    evaluate_objectives,
    find_extreme_policy,
    flow_of,
    flow_under,
    solve_weighted,
)


def drawn(seed: int, discount: str) -> MDP:
    """Three states of two pairs each, and an end; two components and a start in two states."""
    rng = np.random.default_rng(seed)
    rows = [(s, a, [(F(int(k), 6), t, 0) for t, k in enumerate(weights) if k])
            for s in range(3) for a in range(2)
            for weights in [rng.multinomial(5, [0.25] * 4) + np.eye(4, dtype=int)[3]]]  # fmt: skip
    parts = {name: [*map(int, rng.integers(-4, 5, 6)), 0] for name in ("a", "b")}
    mdp = MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], discount, components=parts)
    return mdp.with_(start={0: "1/3", 1: "2/3"})


def all_totals(mdp: MDP, of: Objectives) -> dict[tuple[int, ...], list[list[F]]]:
    """The values of each objective under each deterministic policy, by its pairs."""
    totals = {}
    scale = of.rows.scale[mdp.pair_state].tolist()
    for pairs in product(*(mdp.pairs_of(s) for s in range(4))):
        rows = rows_of(mdp, pairs)
        ended = {3} if mdp.discount_exact == 1 else set()
        totals[pairs] = [
            policy_values([(s, a, F(int(own[l]), int(scale[l])), law)
                           for l, (s, a, _, law) in zip(pairs, rows, strict=True)],
                          mdp.discount_exact, ended)
            for own in of.amounts
        ]  # fmt: skip
    return totals


@pytest.mark.parametrize("discount", ["1", "3/4"])
@pytest.mark.parametrize("seed", range(8))
def test_optima_for_weights_are_those_of_all_policies(seed: int, discount: str) -> None:
    mdp = drawn(seed, discount)
    of = Objectives(mdp, ["a", "b"])
    each, start = all_totals(mdp, of), dict(mdp.start)
    for pairs, values in each.items():
        found = evaluate_objectives(of, np.array(pairs))
        assert [list(level.to_fractions()) for level in found.values] == values
        mean = tuple(sum(p * own[s] for s, p in start.items()) for own in values)
        assert found.total == mean
        flow = flow_under(of, np.array(pairs))
        assert flow.compute_totals(of) == mean
    for weights in ([F(1), F(0)], [F(1, 3), F(2)], [F(1), F(1)]):
        best = [max(sum(w * own[s] for w, own in zip(weights, values, strict=True))
                    for values in each.values()) for s in range(4)]  # fmt: skip
        pairs, level = solve_weighted(of, weights)
        assert list(level.to_fractions()) == best
        found = find_extreme_policy(of, weights)
        assert found.is_optimal(of, weights)
        for s in range(4):
            own = [level.to_fractions()[s] for level in found.values]
            assert sum(w * x for w, x in zip(weights, own, strict=True)) == best[s]
        worst = min(
            each, key=lambda p: sum(w * own[0] for w, own in zip(weights, each[p], strict=True))
        )
        assert evaluate_objectives(of, np.array(worst)).is_optimal(of, weights) == all(
            sum(w * own[s] for w, own in zip(weights, each[worst], strict=True)) == best[s]
            for s in range(4)
        )


def test_a_flow_gives_the_chances_of_a_policy() -> None:
    mdp = drawn(0, "1")
    of = Objectives(mdp, ["a"])
    flow = OccupancyMeasure.of({1: F(1, 2), 0: F(3, 2), 4: F(5)})
    assert flow.to_numbers() == {0: F(3, 2), 1: F(1, 2), 4: F(5)}
    assert flow.compute_action_probabilities(of) == {0: {0: F(3, 4), 1: F(1, 4)}, 2: {4: F(1)}}


@pytest.mark.parametrize("kind", [{}, {"falling": True}])
def test_flows_of_a_policy_are_the_visits_of_its_pairs(kind: dict[str, Any]) -> None:
    for seed in range(6):
        mdp = small_model(seed, 1, **kind)
        chances = random_policy(mdp, seed, pure=seed % 3 == 0)
        of, law = Objectives(mdp, ["reward"]), mixed(rows_of(mdp), chances)
        moves = [{} if mdp.terminal[s] else row for s, _, _, row in law]
        often = visits(dict(mdp.start), moves)
        wanted = {
            mdp.pair(s, a): often[s] * chance
            for (s, a), chance in chances.items()
            if often[s] and not mdp.terminal[s]
        }
        flow = flow_of(of, given(chances))
        assert flow.to_numbers() == wanted
        start = policy_values(law, F(1), np.flatnonzero(mdp.terminal).tolist())
        assert flow.compute_totals(of) == (sum(p * start[s] for s, p in mdp.start),)


def test_a_flow_ends_where_no_objective_is_earned_any_more() -> None:
    rows: Any = [
        (0, 0, [(1, 1, {"a": 1, "b": 2})]),
        (1, 0, [(1, 1, {"a": 3, "b": 0})]),
        (2, 0, [(1, 2, {"a": 0, "b": 0})]),
    ]
    of = Objectives(MDP.from_outcomes(rows), ["b"])
    assert flow_of(of, "random").to_numbers() == {0: 1}


def test_a_flow_ends_where_a_policy_stays_and_nothing_is_counted() -> None:
    """Half of all runs come from state 0 to a ring, in which only an event happens."""
    rows: Any = [
        (0, 0, [(F(1, 2), 1, -1), (F(1, 2), 3, -1)]),
        (0, 1, [(1, 4, -1)]),
        (1, 0, [(1, 2, 0)]),
        (2, 0, [(1, 1, 0)]),
        (2, 1, [(1, 3, -3)]),
        (3, 0, [(1, 3, 0)]),
        (4, 0, [(1, 4, -1)]),  # loses forever
        (4, 1, [(1, 3, -1)]),
    ]
    mdp = MDP.from_outcomes(rows, labels={"goal": [False, False, False, True, False]})
    bits = (mdp.table.pair == 2).astype(np.uint8)
    mdp = mdp.with_(table=replace(mdp.table, event=bits), events=("seen",))
    leaves, stays, loses = [0, 0, 1, 0, 0], [0, 0, 0, 0, 0], [1, 0, 1, 0, 0]
    of, until = Objectives(mdp, ["reward"]), Objectives(mdp.negated().until("goal"), ["reward"])
    assert of.reduced
    assert until.reduced
    assert flow_of(of, stays).compute_totals(of) == (-1,)
    for each in (of, until):
        assert flow_of(each, leaves).compute_totals(each) == (F(-5, 2),)
    # To stay in the ring is to miss the goal.
    for each, policy, place in ((of, loses, 4), (until, loses, 4), (until, stays, 1)):
        with pytest.raises(ModelError, match="its totals are not finite") as refused:
            flow_of(each, policy)
        assert f"state {place}" in str(refused.value)
