"""Policies that are found in rational arithmetic, beside all policies."""

from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from oracle import policies, policy_values, solve_exact
from random_rows import ending_models, maximised

from exact_mdp import MDP
from exact_mdp.solvers.exact import optimise as module
from exact_mdp.solvers.exact.certificate import exact_rows
from exact_mdp.solvers.exact.levels import Step
from exact_mdp.solvers.exact.linear import evaluate_exactly
from exact_mdp.solvers.exact.optimise import (
    improve_in_floats,
    iterate_policies,
    optimise_exactly,
)


def test_values_are_the_best_of_all_policies() -> None:
    for mdp in ending_models(3):
        rows, equations = maximised(mdp), exact_rows(mdp)
        best, actions = solve_exact(mdp.n_states, rows, mdp.discount_exact)
        for first in (None, mdp.pair_offsets[1:] - 1):
            pairs, (value,), sign = optimise_exactly(equations, first)
            assert value.to_fractions().tolist() == best
            assert sign.dtype == np.int64
            for (s, a, *_), own in zip(rows, sign.tolist(), strict=True):
                if not mdp.terminal[s]:
                    assert own == (0 if a in actions[s] else -1)
            assert [int(mdp.pair_state[pair]) for pair in pairs] == [*range(mdp.n_states)]
            assert all(
                int(mdp.pair_action[pair]) in actions[s] or mdp.terminal[s]
                for s, pair in enumerate(pairs.tolist())
            )


def test_one_amount_after_the_other_settles_ties() -> None:
    """Of policies that earn the most of the first, the most of the second."""
    rng = np.random.default_rng(4)
    for mdp in ending_models(5):
        equations, end = exact_rows(mdp), {mdp.n_states - 1}
        scale = equations.scale.tolist()
        amounts = [rng.integers(-1, 2, mdp.n_pairs).astype(object) for _ in range(2)]
        _, values, _ = optimise_exactly(equations, amounts=amounts)
        each = list[tuple[tuple[F, ...], ...]]()
        rows = maximised(mdp)
        place = {row[:2]: number for number, row in enumerate(rows)}
        for policy in policies(rows):
            own = [[(s, a, F(int(x[place[s, a]]), int(scale[s])), law) for s, a, _, law in policy]
                   for x in amounts]  # fmt: skip
            totals = [policy_values(chain, mdp.discount_exact, end) for chain in own]
            each.append(tuple(zip(*totals, strict=True)))
        best = [max(column) for column in zip(*each, strict=True)]
        found = [level.to_fractions().tolist() for level in values]
        assert [*zip(*found, strict=True)] == best


def test_floats_suggest_a_policy_that_ends() -> None:
    for mdp in ending_models(6):
        equations = exact_rows(mdp)
        _, actions = solve_exact(mdp.n_states, maximised(mdp), mdp.discount_exact)
        pairs = improve_in_floats(equations, mdp.pair_offsets[:-1])
        for s, pair in enumerate(pairs.tolist()):
            assert mdp.pair_state[pair] == s
            assert mdp.terminal[s] or int(mdp.pair_action[pair]) in actions[s]
        again = improve_in_floats(equations, pairs)
        assert again.tolist() == pairs.tolist()


@pytest.mark.parametrize(
    "reward, stay, kept",
    [
        (F(1), F(1) - F(1, 2**80), True),  # 1 in floats: its equations are singular
        (F(1), F(1, 2), False),
        (F(10) ** 300, F(1, 2), False),
    ],
)
def test_where_floats_fail_the_first_policy_stays(reward: F, stay: F, kept: bool) -> None:
    law = [(stay, 0, reward), (1 - stay, 1, reward)] if stay else [(1, 1, reward)]
    rows: Any = [(0, 0, law), (0, 1, [(p, t, 2 * r) for p, t, r in law]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows)
    pairs = improve_in_floats(exact_rows(mdp), np.array([0, 2]))
    assert pairs.tolist() == ([0, 2] if kept else [1, 2])
    best, (value,), _ = optimise_exactly(exact_rows(mdp))
    assert value.to_fractions()[0] == 2 * reward / (1 - stay)
    assert best.tolist() == [1, 2]


def test_numbers_beyond_the_floats_suggest_nothing() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])])
    rows = exact_rows(mdp)
    for size, pairs in ((10**400, [0, 2]), (10**300, [1, 2])):
        large = replace(rows, constant=rows.constant.astype(object) * size)
        assert improve_in_floats(large, np.array([0, 2])).tolist() == pairs
        best, (value,), _ = optimise_exactly(large)
        assert (best.tolist(), value.top[0]) == ([1, 2], 2 * size)


def test_what_floats_gain_by_rounding_is_no_gain() -> None:
    """Two ways that are as good, up to 2⁻⁶⁰ of what is added: the first one stays."""
    rows: Any = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 1 + F(1, 2**52))]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows)
    assert improve_in_floats(exact_rows(mdp), np.array([0, 2])).tolist() == [0, 2]
    pairs, *_ = optimise_exactly(exact_rows(mdp))
    assert pairs.tolist() == [1, 2]
    more: Any = [rows[0], (0, 1, [(1, 1, 1 + F(1, 2**30))]), rows[2]]
    assert improve_in_floats(exact_rows(MDP.from_outcomes(more)), np.array([0, 2])).tolist() == [
        1,
        2,
    ]


END: Any = (1, 0, [(1, 1, 0)])


def test_a_state_takes_the_first_pair_with_the_greatest_advantage() -> None:
    mdp = MDP.from_outcomes([*((0, a, [(1, 1, r)]) for a, r in enumerate((0, 1, 3, 3, 2))), END])
    rows, policies = exact_rows(mdp), list[list[int]]()

    def evaluate(pairs: np.ndarray[Any, Any]) -> list[Step]:
        policies.append(pairs.tolist())
        (value,) = evaluate_exactly(rows, pairs)
        return [(value, rows.constant.tolist(), [1] * mdp.n_pairs)]

    iterate_policies(rows, np.array([0, 5]), evaluate)
    assert policies == [[0, 5], [2, 5]]


def test_floats_suggest_a_policy_for_the_first_amount(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is the best, so that it is the only one that is evaluated exactly."""
    mdp = MDP.from_outcomes([*((0, a, [(1, 1, r)]) for a, r in enumerate((3, 2, 1))), END])
    tried, kept = list[list[int]](), module.evaluate_exactly

    def evaluate(rows: Any, pairs: Any, amounts: Any) -> Any:
        tried.append(pairs.tolist())
        return kept(rows, pairs, amounts)

    monkeypatch.setattr(module, "evaluate_exactly", evaluate)
    optimise_exactly(exact_rows(mdp), amounts=[np.array([1, 2, 5, 0], dtype=object)])
    assert tried == [[2, 3]]


@pytest.mark.parametrize("gain, taken", [(1.5, 0), (2.5, 1)])
def test_a_gain_in_floats_is_more_than_a_part_of_what_is_added(gain: float, taken: int) -> None:
    """2^-40 of r + γ P |V| + |V|: of a reward alone, and of values that come later."""
    more, first = 1 + F(gain) / 2**40, np.array([0, 2])
    here = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, more)]), END])
    assert improve_in_floats(exact_rows(here), first)[0] == taken
    stay = [[("7/8", s, r), ("1/8", 3, r)] for s, r in ((1, more), (2, F(1)))]  # 8 steps
    rows: Any = [(0, 0, [(1, 2, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, stay[0]), (2, 0, stay[1]),
                 (3, 0, [(1, 3, 0)])]  # fmt: skip
    later = MDP.from_outcomes(rows)
    assert improve_in_floats(exact_rows(later), later.pair_offsets[:-1])[0] == taken


def test_a_gain_that_is_just_as_large_counts() -> None:
    rows: Any = [(0, 0, [(1, 2, 1)]), (0, 1, [(1, 2, 1 + F(1, 2**37))]), (1, 0, [(1, 2, 4)]),
                 (2, 0, [(1, 2, 0)])]  # fmt: skip
    mdp = MDP.from_outcomes(rows)  # 2^-40 of 4 + 4
    assert improve_in_floats(exact_rows(mdp), np.array([0, 2, 3])).tolist() == [1, 2, 3]


def test_a_policy_that_never_ends_is_not_suggested() -> None:
    """By rounding, floats solve the equations of a class that no run leaves."""
    rows: Any = [(2, 0, [(1, 2, 0)])]
    for s in (1, 0):
        stay = (s, 1, [("1/3", 0, 1), ("2/3", 1, 1)])
        rows = [(s, 0, [(1, 2, 0)]), stay, *rows]
    mdp = MDP.from_outcomes(rows)
    first = np.array([0, 2, 4])
    assert improve_in_floats(exact_rows(mdp), first).tolist() == first.tolist()
