"""Levels that are found: beside all policies, with proofs that the checker accepts."""

from collections.abc import Iterator
from fractions import Fraction as F
from functools import partial
from math import inf
from typing import Any

import numpy as np
import pytest
from model_contents import negated
from oracle import (
    Row,
    best_average,
    best_total,
    gain_and_bias,
    policies,
    until,
)
from random_rows import ending_models, maximised, random_rows

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.solvers.exact import find
from exact_mdp.solvers.exact.certificate import Certificate, exact_rows
from exact_mdp.solvers.exact.optimise import optimise_exactly
from exact_mdp.solvers.solution import answer_maximised

# ---- gain and bias -------------------------------------------------------------------------------


def endless(seed: int) -> Iterator[MDP]:
    rng = np.random.default_rng(seed)
    for _ in range(16):
        for sense in ("max", "min"):
            rows = random_rows(rng, size=int(rng.integers(1, 5)), end=bool(rng.random() < 0.5))
            yield MDP.from_outcomes(rows, sense=sense)


def test_averages_are_the_greatest_of_all_policies() -> None:
    for mdp in endless(0):
        proof = answer_maximised(mdp, partial(find.prove_gain_and_bias, kind="average"))
        assert (proof.kind, proof.violations()) == ("average", [])
        gain, bias = best_average(rows := maximised(mdp))
        assert proof.g is not None
        assert (*proof.g.to_fractions(),) == gain
        assert (*proof.h.to_fractions(),) == bias
        pairs, levels = find.best_average(mdp.maximised)
        own = [rows[pair] for pair in pairs.tolist()]
        assert gain_and_bias(own) == (gain, bias)
        assert (*levels[0].to_fractions(),) == gain
        assert (*levels[1].to_fractions(),) == bias
        first = bellman_rows(mdp.maximised).pair_offsets[:-1]
        _, discounted = find.best_average(
            mdp.maximised.with_(discount="1/2")
        )  # which counts for nothing
        assert [level.to_fractions().tolist() for level in discounted] == [
            level.to_fractions().tolist() for level in levels
        ]
        again, levels = find.optimise_expansion(exact_rows(mdp, average=True), first)
        assert gain_and_bias([rows[pair] for pair in again.tolist()]) == (gain, bias)
        assert (*levels[1].to_fractions(),) == bias


def test_the_search_for_averages_begins_anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Floats only suggest where to begin."""

    def fails(*_: Any, **__: Any) -> Any:
        raise find.SolverError(None, "")

    monkeypatch.setattr(find.AveragePolicyIteration, "run", fails)
    for mdp in [*endless(1)][:20]:
        gain, bias = best_average(maximised(mdp))
        _, levels = find.best_average(mdp.maximised)
        assert (*levels[0].to_fractions(),) == gain
        assert (*levels[1].to_fractions(),) == bias


def test_totals_are_the_limits_of_all_policies() -> None:
    refused = 0
    for mdp in endless(2):
        best = best_total(maximised(mdp))
        try:
            proof = answer_maximised(mdp, partial(find.prove_gain_and_bias, kind="total"))
        except ModelError:
            refused += 1
            continue
        assert proof.violations() == []
        sign = 1 if mdp.sense == "max" else -1
        assert proof.value.tolist() == [sign * x for x in best]
        assert proof.start_value == proof.value[0]
    assert refused == 0  # runs begin in one state


# ---- a goal --------------------------------------------------------------------------------------


def to_goal(seed: int) -> Iterator[MDP]:
    """Models whose last state is the goal, which runs may miss, of either sense."""
    rng = np.random.default_rng(seed)
    for _ in range(60):
        size = int(rng.integers(2, 5))
        rows = random_rows(rng, size=size, end=True)
        start = {int(rng.integers(0, size)): 1}
        mdp = MDP.from_outcomes(rows, labels={"goal": {size - 1}}, start=start)
        yield (mdp if rng.random() < 0.5 else negated(mdp)).until("goal")


def of_all_policies(mdp: MDP) -> list[F | float]:
    """The most that a policy of one action in each state earns; runs that miss are worth ±∞."""
    missed = mdp.maximised.unreached
    target = [s == mdp.n_states - 1 for s in range(mdp.n_states)]
    each = [[missed if x == inf else x for x in until(policy, target)]
            for policy in policies(maximised(mdp))]  # fmt: skip
    return [max(column) for column in zip(*each, strict=True)]


def gains_for_ever(mdp: MDP) -> set[int]:
    """States that surely arrive if they like, and can go round for a gain before."""
    target = [s == mdp.n_states - 1 for s in range(mdp.n_states)]
    rows = maximised(mdp)
    sure = {s for policy in policies(rows) for s, x in enumerate(until(policy, target)) if x < inf}
    inside = [row for row in rows if row[0] in sure and {*row[3]} <= sure]
    others: list[Row] = [(s, 0, F(0), {s: F(1)}) for s in range(mdp.n_states) if s not in sure]
    gain, _ = best_average([*inside, *others])
    return {s for s in sure if gain[s] > 0}


def test_totals_until_a_goal_are_the_best_of_all_policies() -> None:
    kinds = set[tuple[float, int]]()
    for mdp in to_goal(7):
        ((start, _),) = mdp.start
        above = gains_for_ever(mdp) if mdp.maximised.unreached == -inf else set()
        try:
            proof = answer_maximised(mdp, find.prove_goal_total)
        except ModelError:  # costs fall without end before the goal
            assert start in above
            continue
        assert proof.violations() == []
        assert proof.infinite is not None
        sign = 1 if mdp.sense == "max" else -1
        for s, (x, best) in enumerate(zip(proof.value, of_all_policies(mdp), strict=True)):
            assert sign * x == (inf if s in above else best)
            kinds.add((mdp.maximised.unreached, int(proof.infinite[s])))
        assert start not in above
        assert proof.start_value == proof.value[int(start)]
    assert kinds == {(inf, 0), (inf, 1), (-inf, 0), (-inf, 1), (-inf, -1)}


def by_hand(pairs: list[Any], goal: int, start: int) -> Certificate:
    """A proof for costs -r until a goal, whose runs may miss it."""
    mdp = MDP.from_outcomes(pairs, labels={"goal": {goal}}, start={start: 1})
    proof: Certificate = answer_maximised(negated(mdp).until("goal"), find.prove_goal_total)
    assert proof.violations() == []
    return proof


def test_a_gain_of_1_in_each_step_is_infinite() -> None:
    pairs: Any = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)]),
                  (2, 0, [(1, 1, -3)])]  # fmt: skip
    assert by_hand(pairs, goal=1, start=2).value.tolist() == [-inf, 0, 3]


def test_the_search_begins_with_pairs_that_cannot_miss_the_goal() -> None:
    """Of state 0 the first pair may be lost, the second stays, and the third arrives."""
    lost: Any = [("1/2", 1, 0), ("1/2", 2, 0)]
    pairs: Any = [(0, 0, lost), (0, 1, [(1, 0, -1)]), (0, 2, [(1, 1, -1)]), (1, 0, [(1, 1, 0)]),
                  (2, 0, [(1, 2, 0)])]  # fmt: skip
    assert by_hand(pairs, goal=1, start=0).value.tolist() == [1, 0, inf]


def test_ranks_of_infinite_values_fall_along_pairs_that_cannot_miss_the_goal() -> None:
    """From state 0 one pair may be lost at once, the safe way leads through state 1."""
    lost: Any = [("1/2", 2, 0), ("1/2", 4, 0)]
    pairs: Any = [(0, 0, [(1, 0, 1)]), (0, 1, lost), (0, 2, [(1, 1, 0)]), (1, 0, [(1, 0, 0)]),
                  (1, 1, [(1, 2, 0)]), (2, 0, [(1, 2, 0)]), (3, 0, [(1, 2, 0)]),
                  (4, 0, [(1, 4, 0)])]  # fmt: skip
    proof = by_hand(pairs, goal=2, start=3)
    assert proof.value.tolist() == [-inf, -inf, 0, 0, inf]
    assert proof.rank is not None
    assert proof.rank[[0, 1]].tolist() == [2, 1]


def test_costs_that_fall_for_ever_are_named() -> None:
    rows: Any = [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 1, 1)]), (1, 1, [(1, 2, 0)]), (2, 0, [(1, 2, 0)])]
    mdp = negated(MDP.from_outcomes(rows, labels={"goal": {2}})).until("goal")
    with pytest.raises(ModelError, match="costs fall without end") as caught:
        find.no_falling(mdp, np.array([True, True, False]))
    assert "state 0" in caught.value.where
    find.no_falling(mdp, np.array([False, True, True]))


# ---- what a certificate says ---------------------------------------------------------------------


def test_starts_have_one_infinity_at_most() -> None:
    rows: Any = [(s, 0, [(1, s, 0)]) for s in range(3)]
    mdp = MDP.from_outcomes(rows)
    for start, sign, wanted in (
        ({0: 1}, [1, -1, 0], 1), ({1: 1}, [1, -1, 0], -1), ({2: 1}, [1, -1, 0], 0),
        ({0: "1/2", 2: "1/2"}, [1, -1, 0], 1), ({0: "1/2", 1: "1/2"}, [-1, -1, 0], -1),
        ({0: "1/2", 1: "1/2"}, [1, -1, 0], None),
    ):  # fmt: skip
        given = mdp.with_(start=start)
        if wanted is None:
            with pytest.raises(ModelError, match="is \\+∞ from one state of the start and -∞"):
                find.one_sign(given, np.array(sign))
        else:
            assert find.one_sign(given, np.array(sign)) == wanted


def test_an_optimum_is_unique_where_the_states_met_have_one_optimal_pair() -> None:
    rng = np.random.default_rng(8)
    answers = set[bool]()
    for mdp in [*endless(9), *ending_models(10)]:
        rows = maximised(mdp)
        optimal = rng.random(mdp.n_pairs) < 0.6
        optimal[mdp.pair_offsets[:-1]] |= ~np.logical_or.reduceat(optimal, mdp.pair_offsets[:-1])
        met, waiting = {0}, [0]
        for s in waiting:
            for pair in mdp.pairs_of(s):
                if optimal[pair]:
                    fresh = {*rows[pair][3]} - met
                    met |= fresh
                    waiting += fresh
        ends = {s for s in range(mdp.n_states)
                if all(r == 0 and {*law} == {s} for t, _, r, law in rows if t == s)}  # fmt: skip
        wanted = all(sum(optimal[[*mdp.pairs_of(s)]]) == 1 for s in met - ends)
        if mdp.discount_exact:  # at discount 0 what comes later does not count
            assert find.one_optimum(mdp, optimal) is wanted
            answers.add(wanted)
    assert answers == {True, False}


def test_it_does_not_matter_what_is_done_at_an_end() -> None:
    go, stay, pay = (0, 0, [(1, 1, 0)]), (1, 0, [(1, 1, 0)]), (1, 1, [(1, 1, -1)])
    half: Any = (1, 1, [("1/2", 1, 0), ("1/2", 0, 0)])
    for other, unique in (((1, 1, [(1, 1, 0)]), True), (pay, False), (half, False)):
        mdp = MDP.from_outcomes([go, stay, other])
        assert find.one_optimum(mdp, np.array([True, True, True])) is unique
        assert find.one_optimum(mdp, np.array([True, True, False]))


def test_certificates_have_the_start_value_of_their_levels() -> None:
    rows: Any = [(0, 0, [(1, 2, 3)]), (1, 0, [(1, 2, 5)]), (1, 2, [(1, 2, 5)]), (2, 0, [(1, 2, 0)])]
    for sense, sign in (("max", 1), ("min", -1)):
        mdp = MDP.from_outcomes(rows, "1/2", start=["1/4", "3/4", 0], sense=sense)
        pairs, (value,), optimal = optimise_exactly(exact_rows(mdp))
        build = partial(find.build_certificate, pairs=pairs, h=value)
        proof = answer_maximised(mdp, partial(build, optimal=optimal == 0))
        assert type(proof) is Certificate
        assert proof.start_value == F(3, 4) + F(15, 4)
        assert value.to_fractions().tolist() == [3 * sign, 5 * sign, 0]
        assert (proof.kind, proof.sense, proof.unique) == ("total", sense, False)
        assert proof.policy.tolist() == [0, 0, 0]
        assert proof.violations() == answer_maximised(mdp, build).violations() == []
