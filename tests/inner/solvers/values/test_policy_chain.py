"""The chain of a policy, beside plain fractions: its law, its graph, its equations, its limits."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction as F
from math import inf
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import Chances, given, random_policy, small_model

from exact_mdp import MDP, ModelError, SolverError, solve
from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.solvers.bounds.gains import UNIT, BoundedVector
from exact_mdp.solvers.claims import Status
from exact_mdp.solvers.values import policy_chain
from exact_mdp.solvers.values.policy_chain import (
    OfPolicy,
    PolicyChain,
    PolicyEquations,
    floats_first,
    is_too_inaccurate,
    policy_of,
    round_fractions,
    split_infinite_returns,
)

KINDS: list[dict[str, Any]] = [{}, {"falling": True}, {"leaving": False}, {"by_outcome": False}]


def chains(
    discount: object = 1, *, kinds: list[dict[str, Any]] = KINDS, seeds: int = 5
) -> Iterator[tuple[MDP, Chances, PolicyChain]]:
    """Models of every kind with a policy, mixed or pure, and its chain."""
    for seed in range(seeds):
        for kind in kinds:
            mdp = small_model(seed, discount, **kind)
            chances = random_policy(mdp, seed, pure=seed % 3 == 0)
            yield mdp, chances, PolicyChain.of(mdp, given(chances))


def law_of(mdp: MDP, chances: Chances) -> list[oracle.Row]:
    return oracle.mixed(oracle.rows_of(mdp), chances)


def ends_of(mdp: MDP) -> list[int]:
    return np.flatnonzero(mdp.terminal).tolist()


def near(point: BoundedVector, wanted: Any, room: float = 200) -> None:
    """Hold numbers to exact ones within their errors, which are a few units of the last digit."""
    size = max([abs(float(x)) for x in wanted], default=0.0) + 1
    for value, error, exact in zip(point.value, point.error, wanted, strict=True):
        assert abs(F(float(value)) - exact) <= F(float(error))
        assert error <= room * UNIT * size


# ---- what the policy takes -----------------------------------------------------------------------


def test_the_chances_of_pairs_are_those_given() -> None:
    for mdp, chances, chain in chains():
        wanted = [
            chances.get((int(s), int(a)), F(0))
            for s, a in zip(mdp.pair_state, mdp.pair_action, strict=True)
        ]
        assert chain.weights.tolist() == [float(chance) for chance in wanted]
        assert chain.pairs.tolist() == [pair for pair, chance in enumerate(wanted) if chance]
        assert chain.pure == (len(chances) == mdp.n_states)
        taken = max(sum(s == state for s, _ in chances) for state in range(mdp.n_states))
        # Each chance is a quotient, and a row is a sum of as many products.
        assert chain.roundings == 1 if chain.pure else 2 * taken <= chain.roundings <= 2 * taken + 2
        for state in range(mdp.n_states):
            exactly = {pair: wanted[pair] for pair in mdp.pairs_of(state) if wanted[pair]}
            assert chain.exact_weights(state) == exactly


def test_roundings_are_those_of_the_state_with_most_pairs() -> None:
    """Of one with three pairs between states in which the second of two pairs is taken.

    A weight is divided by a sum: n roundings for n pairs. A probability is rounded once, times the
    weight once more, and n - 1 times as it is added up.
    """
    rows: Any = [(s, a, [(1, 3, a)]) for s, count in ((0, 2), (1, 3), (2, 2)) for a in range(count)]
    mdp = MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])])
    third = F(1, 3)
    chain = PolicyChain.of(mdp, {0: {1: 1}, 1: {0: third, 1: third, 2: third}, 2: {1: 1}})
    assert 2 * 3 + 1 <= chain.roundings <= 2 * 3 + 2


def test_floats_that_hardly_sum_to_1_are_divided_by_their_exact_sum() -> None:
    mdp = small_model(3)
    share = np.random.default_rng(0).random(mdp.n_pairs)
    share /= np.add.reduceat(share, mdp.pair_offsets[:-1])[mdp.pair_state]
    share *= 1 + 1e-13
    chain = PolicyChain.of(mdp, share)
    assert chain.policy is None
    assert chain.read_as == "policy"
    for state in range(mdp.n_states):
        pairs = mdp.pairs_of(state)
        total = sum(F(float(share[pair])) for pair in pairs)
        exactly = {pair: F(float(share[pair])) / total for pair in pairs}
        assert chain.exact_weights(state) == exactly
        assert chain.weights[pairs] == pytest.approx(
            [*map(float, exactly.values())], rel=1e-15, abs=0
        )
    chances = {
        (s, int(mdp.pair_action[pair])): chance
        for s in range(mdp.n_states)
        for pair, chance in chain.exact_weights(s).items()
    }
    assert oracle.rows_of(chain.model) == law_of(mdp, chances)


def test_the_outcomes_are_those_of_the_pairs_taken() -> None:
    for mdp, chances, chain in chains():
        listed = [
            (s, chances[s, int(mdp.pair_action[pair])] * p, t, r)
            for pair in chain.pairs.tolist()
            for s in [int(mdp.pair_state[pair])]
            for p, t, r in mdp.table.row(pair)
        ]
        source, chance, _, gain = zip(*listed, strict=True)
        assert chain.source.tolist() == list(source)
        assert chain.probability == pytest.approx([*map(float, chance)], rel=4 * UNIT, abs=0)
        assert chain.gain.tolist() == [*map(float, gain)]
        sizes = [source.count(s) for s in range(mdp.n_states)]
        assert chain.outcomes.tolist() == sizes
        assert chain.sum_by_state(np.ones(len(source))).tolist() == sizes
        weight, below = chain.exact_outcomes
        assert [F(int(w), int(below[s])) for w, s in zip(weight, source, strict=True)] == [*chance]


def test_rewards_and_transitions_are_those_of_the_mixture() -> None:
    for mdp, chances, chain in chains():
        law = law_of(mdp, chances)
        earned, error = chain.reward
        near(BoundedVector(value=earned, error=error), [row[2] for row in law], 100)
        dense = chain.transition.toarray()
        assert chain.transition.has_sorted_indices
        for state, _, _, row in law:
            onward = {} if mdp.terminal[state] else row
            exactly = [float(onward.get(t, F(0))) for t in range(mdp.n_states)]
            assert dense[state] == pytest.approx(exactly, rel=chain.roundings * 2 * UNIT, abs=0)
            below = F(0) if chain.pure else chain.roundings * F(UNIT) * 4
            assert abs(F(float(dense[state].sum())) - bool(onward)) <= below + 8 * F(UNIT)


def test_an_error_of_a_reward_counts_every_rounding() -> None:
    """Rewards that nearly cancel between the actions, and between the outcomes of one."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        big = rng.normal(size=4) * 1e8
        p, q = rng.integers(1, 9, size=2).tolist()
        rows = [
            (0, a, [(F(p, 9 + p), 1, F(float(x))), (F(9, 9 + p), 1, F(float(-y)))])
            for a, (x, y) in enumerate(big.reshape(2, 2))
        ]
        mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])
        chances = {(0, 0): F(q, q + 3), (0, 1): F(3, q + 3), (1, 0): F(1)}
        chain = PolicyChain.of(mdp, given(chances))
        earned, error = chain.reward
        exact = law_of(mdp, chances)[0][2]
        assert abs(F(float(earned[0])) - exact) <= F(float(error[0]))
        size = float((chain.probability * np.abs(chain.gain))[chain.source == 0].sum())
        assert 4 * UNIT * size <= error[0] <= 30 * UNIT * size
        assert (earned[1], error[1]) == (0, 0)  # nothing that is 0 is rounded


def test_one_reward_for_each_pair_is_rounded_once() -> None:
    rows: Any = [(0, 0, [(F(1, 3), 1, F(1, 3)), (F(2, 3), 0, F(1, 3))]), (1, 0, [(1, 1, 0)])]
    for own in (rows, [*rows, (0, 1, [(1, 1, 0)])]):
        chain = PolicyChain.of(MDP.from_outcomes(own), [0, 0])
        earned, error = chain.reward
        assert earned.tolist() == [1 / 3, 0]
        assert UNIT / 3 <= error[0] <= UNIT / 3 + 2.0**-900
        assert error[1] == 0


def test_rewards_at_the_ends_of_the_range_of_floats() -> None:
    small, large = F(1, 3 * 10**320), F(2**1024 - 2**971)
    for given_rewards in ([small], [small, small], [small, 2 * small]):
        rows: Any = [(0, a, [(1, 1, r)]) for a, r in enumerate(given_rewards)]
        mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])
        earned, error = PolicyChain.of(mdp, "random").reward
        exact = sum(given_rewards) / len(given_rewards)
        assert abs(F(float(earned[0])) - exact) <= F(float(error[0])) <= F(1, 2**900)
    rows = [(0, a, [(1, 1, large)]) for a in range(20)]
    mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])])
    chain = PolicyChain.of(mdp, "random")
    assert chain.reward[0][0] == inf  # which is refused as it is solved for


def test_probabilities_of_many_digits_are_rounded_once() -> None:
    p = F(10**30 + 7, 3 * 10**30)
    rows: Any = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), {0: {0: p, 1: 1 - p}})
    assert chain.weights.dtype == np.float64
    assert chain.weights.tolist() == [float(p), float(1 - p), 1]
    assert chain.exact_weights(0) == {0: p, 1: 1 - p}


def test_the_model_of_a_chain_has_its_rows_and_outcomes() -> None:
    for discount in (1, F(9, 10)):
        for mdp, chances, chain in chains(discount):
            law = law_of(mdp, chances)
            rows = oracle.rows_of(chain.model)
            assert [(s, r, m) for s, _, r, m in rows] == [(s, r, m) for s, _, r, m in law]
            assert chain.model.discount_exact == discount
            assert chain.pure or chain.model.actions == ("mixed",)
            each = [chain.model.table.row(s) for s in range(mdp.n_states)]
            for state, outcomes in enumerate(each):
                wanted = [
                    (chance * p, t, r)
                    for (s, a), chance in chances.items()
                    if s == state
                    for p, t, r in mdp.table.row(mdp.pair(s, a))
                ]
                assert sorted(outcomes) == sorted(wanted)
                assert [t for _, t, _ in outcomes] == sorted(t for _, t, _ in outcomes)


def test_the_equations_in_integers_are_those_of_the_mixture() -> None:
    def rows_of(rows: BellmanRows) -> list[tuple[F, dict[int, F]]]:
        return [
            (
                F(int(rows.constant[s]), int(rows.scale[s])),
                {
                    int(rows.next[i]): F(int(rows.weight[i]), int(rows.scale[s]))
                    for i in range(rows.offsets[s], rows.offsets[s + 1])
                },
            )
            for s in range(len(rows.scale))
        ]

    for mdp, chances, chain in chains(F(9, 10)):
        law = law_of(mdp, chances)
        for asked, rate in ((None, F(9, 10)), (F(9, 10), F(9, 10)), (F(1, 2), F(1, 2))):
            wanted = [(r, {t: rate * p for t, p in row.items()}) for _, _, r, row in law]
            assert rows_of(chain.build_bellman_rows(asked)) == wanted
        assert chain.exactly.reward.tolist() == [r for _, _, r, _ in law]
        assert rows_of(chain.exactly.rows) == [(r, row) for _, _, r, row in law]


# ---- its graph -----------------------------------------------------------------------------------


def closed(law: list[oracle.Row]) -> list[set[int]]:
    """What each state leads to, itself included."""
    reach = [{s, *row} for s, _, _, row in law]
    for k in range(len(reach)):
        for each in reach:
            if k in each:
                each |= reach[k]
    return reach


def test_the_graph_says_what_is_reached_and_where_a_run_ends() -> None:
    kinds = [*KINDS[:2], {"leaving": False, "states": 6, "ends": 1}]
    for mdp, chances, chain in chains(kinds=kinds, seeds=25):
        law, ends = law_of(mdp, chances), set(ends_of(mdp))
        reach = closed(law)
        begin = {state for state, weight in mdp.start if weight}
        reached = set().union(*(reach[state] for state in begin))
        stuck = {s for s, onward in enumerate(reach) if not onward & ends}
        sure = {s for s, onward in enumerate(reach) if not onward & stuck}
        assert set(np.flatnonzero(chain.reached).tolist()) == reached
        assert set(np.flatnonzero(chain.stuck).tolist()) == stuck
        assert set(np.flatnonzero(chain.proper).tolist()) == sure
        assert np.array_equal(chain.reaches_goal, chain.proper)
        assert chain.ends_from_start == (not reached & stuck) == chain.reaches_goal_from_start
        if chain.order is not None:
            falls = [chain.order[t] < chain.order[s] for s, _, _, row in law for t in row if t != s]
            assert all(falls)


def test_a_model_without_an_end_is_stuck_everywhere() -> None:
    mdp = small_model(1, "9/10", ends=0, leaving=False)
    chain = PolicyChain.of(mdp, "random")
    assert chain.order is None
    assert chain.stuck.all()
    assert not chain.proper.any()
    assert not chain.ends_from_start


def test_a_state_of_chance_0_is_no_start() -> None:
    rows: Any = [(s, 0, [(1, s, 1)]) for s in range(2)] + [(2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, start={2: 1, 0: 0})
    assert PolicyChain.of(mdp, "random").reached.tolist() == [False, False, True]


def test_a_policy_that_takes_pairs() -> None:
    mdp = small_model(3)
    rng = np.random.default_rng(0)
    pairs = np.array([rng.choice(mdp.pairs_of(s)) for s in range(mdp.n_states)])
    assert PolicyChain.of_pairs(mdp, pairs).pairs.tolist() == pairs.tolist()
    assert PolicyChain.of_pairs(mdp, pairs).chosen.dtype == np.float64


def test_what_is_too_rare_for_floats_is_possible() -> None:
    rare = F(1, 10**400)
    rows: Any = [
        (0, 0, [(rare, 2, 1), (rare, 1, 1), (1 - 2 * rare, 0, 0)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
        (3, 0, [(1, 0, 1)]),
    ]
    chain = PolicyChain.of(MDP.from_outcomes(rows, start=3), "random")
    assert chain.transition.toarray()[0].tolist() == [1, 0, 0, 0]
    graph = chain.graph
    ahead = [set(graph.indices[slice(*graph.indptr[s : s + 2])].tolist()) for s in range(4)]
    assert ahead == [{0, 1, 2}, set(), set(), {0}]
    assert chain.proper.all()
    assert chain.reached.all()


def test_a_run_beside_the_goal_does_not_arrive() -> None:
    rows: Any = [
        (0, 0, [(F(1, 2), 1, 1), (F(1, 2), 2, 1)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
        (3, 0, [(1, 1, 5)]),
        (4, 0, [(1, 4, 1)]),
    ]
    labels = {"home": [False, True, False, False, False]}
    for start, arriving in ((0, False), (3, True), (1, True), (2, False)):
        mdp = MDP.from_outcomes(rows, labels=labels, start=start).until("home")
        chain = PolicyChain.of(mdp, "random")
        assert chain.proper.tolist() == [True] * 4 + [False]
        assert chain.reaches_goal.tolist() == [False, True, False, True, False]
        assert chain.reaches_goal_from_start == arriving
        ending, lost = split_infinite_returns(chain)
        if arriving:
            assert (ending, lost) == (chain, {})
        else:
            assert np.flatnonzero(lost[inf]).tolist() == [2, 4]
            assert ending.proper.all()


def test_classes_at_rest_neither_earn_nor_count() -> None:
    rows: Any = [
        (0, 0, [(F(1, 3), s, 1) for s in (1, 3, 5)]),
        *((s, 0, [(1, 3 - s, 0)]) for s in (1, 2)),  # at rest
        *((s, 0, [(1, 7 - s, s - 3)]) for s in (3, 4)),  # earns
        (5, 0, [(1, 5, 0)]),  # an end
    ]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    assert chain.stays_unrewarded.tolist() == [False, True, True, False, False, True]
    for event, resting in ((2, False), (0, True)):
        counting = MDP.from_outcomes(rows).with_(events=("seen",))
        bits = (counting.table.pair == event).astype(np.uint8)
        table = replace(counting.table, event=bits)
        own = PolicyChain.of(counting.with_(table=table), "random")
        assert own.stays_unrewarded.tolist()[1:3] == [resting] * 2
        assert own.stays_unrewarded.tolist()[3:] == [False, False, True]


def test_ends_go_on_for_ever_in_the_long_run() -> None:
    for mdp, chances, chain in chains(F(1, 2), seeds=3):
        law, moves = law_of(mdp, chances), chain.going_on.transition.toarray()
        for state, _, _, row in law:
            exactly = [float(row.get(t, F(0))) for t in range(mdp.n_states)]
            assert moves[state] == pytest.approx(exactly, rel=1e-14, abs=0)
        assert chain.going_on.mdp.discount == 1
        own = sorted(map(sorted, oracle.classes(law)))
        label = chain.classes.label
        found = [np.flatnonzero(label == k).tolist() for k in range(int(label.max()) + 1)]
        assert sorted(found) == own


# ---- its equations -------------------------------------------------------------------------------


@pytest.mark.parametrize("discount", [F(0), F(1, 2), F(99, 100), F(1)])
def test_values_and_visits_are_those_of_fractions(discount: F) -> None:
    for mdp, chances, chain in chains(discount, seeds=4):
        law, over = law_of(mdp, chances), ends_of(mdp)
        stopped = set(over) if discount < 1 else {*over, *np.flatnonzero(~chain.proper).tolist()}
        wanted = oracle.policy_values(law, discount, stopped)
        assert chain.exact_value.to_fractions().tolist() == wanted
        live = chain.discounted.live
        assert set(np.flatnonzero(~live).tolist()) == stopped
        earned, error = (np.where(live, each, 0.0) for each in chain.reward)
        near(chain.discounted.solve(earned, error), wanted, 2e5)
        inside = [{} if s in stopped else law[s][3] for s in range(mdp.n_states)]
        steps = oracle.policy_values(
            [(s, 0, F(1), x[3]) for s, x in enumerate(law)], discount, stopped
        )
        near(chain.discounted.solve(live.astype(float)), steps, 2e5)
        moves = [{t: discount * p for t, p in row.items()} for row in inside]
        often = oracle.visits(dict(mdp.start), moves)
        near(chain.discounted.visits, often, 2e5)
        assert (chain.discounted.visits.value >= 0).all()
        if chain.proper.all():
            assert chain.exact_visits.to_fractions().tolist() == often


def test_only_at_rate_1_do_equations_ask_for_an_end() -> None:
    for mdp, _, chain in chains(F(1, 2), kinds=[{"leaving": False, "ends": 1}], seeds=20):
        assert np.array_equal(chain.discounted.live, ~mdp.terminal)
        assert np.array_equal(chain.undiscounted.live, chain.proper & ~mdp.terminal)
        assert chain.build_equations(F(1, 4)).system.discount == 0.25
        assert chain.undiscounted.system.roundings == chain.roundings
        law = law_of(mdp, random_policy(mdp, 0, pure=True))
        own = PolicyChain.of(mdp, given(random_policy(mdp, 0, pure=True)))
        wanted = oracle.policy_values(law, F(1, 2), ends_of(mdp))
        assert own.exact_value.to_fractions().tolist() == wanted
        alone = PolicyChain.of(mdp.undiscounted, own.policy)
        stopped = {*np.flatnonzero(~own.proper).tolist(), *ends_of(mdp)}
        assert np.array_equal(alone.discounted.live, alone.undiscounted.live)
        wanted = oracle.policy_values(law, F(1), stopped)
        assert alone.exact_value.to_fractions().tolist() == wanted


def test_floats_do_without_rationals_where_they_can(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("solve_policy_equations", "compute_expected_visits"):
        monkeypatch.setattr(policy_chain, name, None)
    monkeypatch.setattr(
        policy_chain, "is_too_inaccurate", lambda point, _: point.error.max() > 1e-10
    )
    for mdp, chances, chain in chains(F(3, 4), seeds=4):
        law, over = law_of(mdp, chances), ends_of(mdp)
        moves = [
            {} if s in over else {t: p * 3 / 4 for t, p in row.items()} for s, _, _, row in law
        ]
        near(chain.discounted.visits, oracle.visits(dict(mdp.start), moves), 500)
        earned, error = chain.reward
        near(chain.discounted.solve(earned, error), oracle.policy_values(law, F(3, 4), over), 2000)


def test_errors_of_arrivals_are_those_of_the_visits_before_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An end is reached by one of 2^24 steps: by as much the visits' error is an arrival's."""
    monkeypatch.setattr(policy_chain, "is_too_inaccurate", lambda *_: False)
    rare = F(1, 2**24)
    rows: Any = [(0, 0, [(rare, 1, 1), (1 - rare, 0, 1)]), (1, 0, [(1, 1, 0)])]
    visits = PolicyChain.of(MDP.from_outcomes(rows), "random").undiscounted.visits
    assert abs(F(float(visits.value[0])) - 2**24) <= F(float(visits.error[0]))
    assert visits.error[0] > 2.0**-8  # in floats
    assert F(float(visits.error[1])) >= rare * F(float(visits.error[0]))


def test_rationals_give_what_floats_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of values and visits, and of the doubt about a constant."""

    def unbounded(*_: Any, **__: Any) -> Any:
        raise SolverError(Status.NO_BOUND)

    for mdp, chances, chain in chains(F(9, 10), seeds=4):
        law, over = law_of(mdp, chances), ends_of(mdp)
        equations = chain.discounted
        with monkeypatch.context() as patch:
            patch.setattr(type(equations.system), "solve", unbounded)
            constant = np.where(equations.live, np.arange(mdp.n_states) / 4, 0.0)
            exactly = [(s, 0, F(s, 4), x[3]) for s, x in enumerate(law)]
            near(equations.solve(constant), oracle.policy_values(exactly, F(9, 10), over), 2)
            doubt = np.where(equations.live, 0.125, 0.0)
            sure, unsure = equations.solve(constant), equations.solve(constant, doubt)
            wide = oracle.policy_values(
                [(s, 0, F(1, 8), x[3]) for s, x in enumerate(law)], F(9, 10), over
            )
            assert unsure.error - sure.error == pytest.approx([*map(float, wide)], rel=1e-5)
            assert all(F(float(x)) >= w for x, w in zip(unsure.error, wide, strict=True))
            moves = [
                {} if s in over else {t: F(9, 10) * p for t, p in x[3].items()}
                for s, x in enumerate(law)
            ]
            near(equations.visits, oracle.visits(dict(mdp.start), moves), 2)
            with pytest.raises(SolverError, match="beyond the range"):
                equations.solve(np.where(equations.live, inf, 0.0))


def test_a_chain_that_hardly_ends_is_solved_in_rationals() -> None:
    rare = F(1, 2**70)
    rows: Any = [(0, 0, [(rare, 1, 1), (1 - rare, 0, 1)]), (1, 0, [(1, 1, 0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    assert chain.undiscounted.solve(np.array([1.0, 0.0])).value.tolist() == [2.0**70, 0]
    assert chain.undiscounted.visits.value.tolist() == [2.0**70, 1]
    assert chain.exact_value.to_fractions().tolist() == [2**70, 0]


class Earning(OfPolicy):
    def __init__(self, chain: PolicyChain) -> None:
        self.chain = chain


def test_components_are_uses_times_amounts() -> None:
    """And their errors cover a doubt about the uses."""
    mdp = small_model(2)
    amounts = [[F(p, 3), F(7 - p, 11)] for p in range(mdp.n_pairs)]
    mdp = mdp.with_(components=dict(zip("ab", zip(*amounts, strict=True), strict=True)))
    chain = PolicyChain.of(mdp, "random")
    of = Earning(chain)
    used = np.random.default_rng(1).random(mdp.n_pairs) * 5
    doubt = used / 2**20
    total, error = of._sum_components(used, doubt)
    none = of._sum_components(used, 0 * doubt)[1]
    for part in range(2):
        exact = sum(F(float(u)) * x[part] for u, x in zip(used, amounts, strict=True))
        away = sum(F(float(u)) * abs(x[part]) for u, x in zip(doubt, amounts, strict=True))
        size = sum(F(float(u)) * abs(x[part]) for u, x in zip(used, amounts, strict=True))
        assert abs(F(float(total[part])) - exact) <= F(float(none[part]))
        rounded_often = len(chain.pairs) + chain.roundings  # products, and each use of a pair
        assert size * F(UNIT) * rounded_often <= F(float(none[part]))
        assert F(float(none[part])) <= size * F(UNIT) * (rounded_often + 8)
        assert away <= F(float(error[part])) <= away * F(1001, 1000)
    assert of.mdp is mdp
    assert of.policy is chain.policy
    assert of.read_as == "policy"


def test_errors_of_components_count_those_of_amounts_that_cancel() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        big = float(rng.normal() * 1e12)
        small = -big * 3 / 7
        rows: Any = [
            (0, 0, [(0.3, 1, {"a": big, "b": 1.0}), (0.7, 1, {"a": small, "b": 1.0})]),
            (1, 0, [(1.0, 1, {"a": 0.0, "b": 0.0})]),
        ]
        mdp = MDP.from_outcomes(rows)
        exact = (3 * F(big) + 7 * F(small)) / 10
        for used, doubt in ((1.0, 0.0), (0.0, 1.0)):
            of = Earning(PolicyChain.of(mdp, "random"))
            total, error = of._sum_components(np.array([used, 0.0]), np.array([doubt, 0.0]))
            assert abs(F(float(total[0])) - F(used) * exact) <= F(float(error[0]))
            assert error[0] >= UNIT * (0.3 * abs(big) + 0.7 * abs(small))


# ---- runs without an end -------------------------------------------------------------------------


def test_runs_that_go_on_for_ever_are_told_apart_by_their_gain() -> None:
    told = dict.fromkeys(["+", "-", "none", "refused"], 0)
    for seed in range(80):
        mdp = small_model(seed, leaving=False, ends=seed % 2)
        chances = random_policy(mdp, seed, pure=seed % 3 > 0)
        chain, law = PolicyChain.of(mdp, given(chances)), law_of(mdp, chances)
        gain, _ = oracle.gain_and_bias(law)
        inner = {s for each in oracle.classes(law) for s in each}
        busy = {s for s in inner if chain.reached[s]} - set(ends_of(mdp))
        busy -= set(np.flatnonzero(chain.stays_unrewarded).tolist())
        if any(gain[s] == 0 for s in busy):
            told["refused"] += 1
            with pytest.raises(ModelError, match="rewards cancel forever") as refused:
                split_infinite_returns(chain)
            assert f"state {min(s for s in busy if gain[s] == 0)}" in str(refused.value)
            continue
        ending, lost = split_infinite_returns(chain)
        if chain.reaches_goal_from_start:
            told["none"] += 1
            assert (ending, lost) == (chain, {})
            continue
        assert ending.reaches_goal_from_start
        assert {*lost} == {inf if gain[s] > 0 else -inf for s in busy}
        for sign, states in lost.items():
            told["+" if sign > 0 else "-"] += 1
            assert set(np.flatnonzero(states).tolist()) == {s for s in busy if sign * gain[s] > 0}
        stopped = set(ends_of(ending.mdp)) - set(ends_of(mdp))
        assert stopped == busy | (
            set(np.flatnonzero(chain.stays_unrewarded).tolist()) - set(ends_of(mdp))
        )
    assert min(told["+"], told["-"], told["none"]) > 10


@pytest.mark.parametrize("more, sign", [(0, None), (F(1, 10**30), inf), (-F(1, 10**30), -inf)])
def test_rewards_that_cancel_are_told_from_those_that_hardly_do(more: F, sign: float) -> None:
    rows: Any = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, -1 + F(more))])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    if sign is None:
        with pytest.raises(ModelError, match="rewards cancel forever"):
            split_infinite_returns(chain)
    else:
        ending, lost = split_infinite_returns(chain)
        assert {s: m.tolist() for s, m in lost.items()} == {sign: [True, True]}
        assert ending.mdp.terminal.all()
        assert ending.chosen is chain.chosen


def test_the_sign_of_a_gain_is_sure_beyond_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Floats tell it, also where others earn nothing; at its error from 0 a gain may be 0."""
    rows: Any = [(0, 0, [(F(1, 2), 1, 0), (F(1, 2), 2, 0)]), (1, 0, [(1, 1, 1)])]
    chain = PolicyChain.of(MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]), "random")
    with monkeypatch.context() as patch:
        patch.setattr(policy_chain, "long_run", None)
        assert split_infinite_returns(chain)[1][inf].tolist() == [False, True, False]
    point = BoundedVector(value=np.full(2, 2.0**-60), error=np.full(2, 2.0**-60))
    monkeypatch.setattr(policy_chain.FloatChain, "evaluate_chain", lambda _: (point, point))
    rows = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, -1)])]
    with pytest.raises(ModelError, match="rewards cancel forever"):
        split_infinite_returns(PolicyChain.of(MDP.from_outcomes(rows), "random"))


def test_below_discount_1_nothing_is_parted() -> None:
    chain = PolicyChain.of(small_model(0, "1/2", ends=0, leaving=False), "random")
    assert split_infinite_returns(chain) == (chain, {})


# ---- what is given -------------------------------------------------------------------------------


def test_a_policy_comes_in_many_forms() -> None:
    mdp = small_model(4, "1/2")
    chain = PolicyChain.of(mdp, "optimal")
    assert PolicyChain.of(mdp, chain) is chain
    best = solve(mdp)
    assert mdp.pair_action[chain.pairs].tolist() == best.policy.rule.tolist()
    with pytest.raises(ModelError, match="another model"):
        PolicyChain.of(small_model(4, "1/2"), chain)
    q = np.zeros((mdp.n_states, mdp.n_actions))
    q[np.arange(mdp.n_states), best.policy.rule] = 1
    for kind in ("q", "policy"):
        own = PolicyChain.of(mdp, q, kind=kind)
        assert own.read_as == kind
        assert own.pairs.tolist() == chain.pairs.tolist()
    whole = np.ones(mdp.n_pairs, dtype=np.int64)
    with pytest.raises(ModelError):
        PolicyChain.of(mdp, whole)  # whole numbers are no probabilities of pairs


def test_the_best_policy_is_best_by_the_criterion_that_is_asked() -> None:
    """In state 0 one action pays at once, the other for ever."""
    rows: Any = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 1)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    for asked, action in (("total", 0), ("average", 1)):
        kind: Any = asked
        assert policy_of(mdp, "optimal", criterion=kind).choices(mdp)[0] == action
    assert policy_of(mdp, [1, 0, 0]).choices(mdp)[0] == 1
    flat = [[1, 0], [1, 0], [1, 0]]
    for each in ("q", "policy"):
        assert policy_of(mdp, np.array(flat) / 1, kind=each).read_as == each


@pytest.mark.parametrize("wrong", [[0.5, 0.5 + 1e-8, 1], [-0.1, 1.1, 1], [0.5, 0.5, 0.9]])
def test_chances_of_pairs_are_refused_where_they_are_none(wrong: list[float]) -> None:
    rows: Any = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows)
    with pytest.raises(ModelError, match="sum to") as refused:
        PolicyChain.of(mdp, np.array(wrong))
    assert f"state {int(wrong[2] < 1)}" in str(refused.value)
    turned = MDP.from_outcomes(
        [(1 - s, a, [(1, 0, 5 * s) for _, _, _ in out]) for s, a, out in rows]
    )
    with pytest.raises(ModelError, match="state 1"):
        PolicyChain.of(turned, np.array([1, *(np.array(wrong[:2]) * (2 - wrong[2]) - 0.3)]))
    assert PolicyChain.of(mdp, np.array([0.0, 1, 1])).pairs.tolist() == [1, 2]
    assert PolicyChain.of(mdp, np.array([0.5, 0.5 + 1e-12, 1])).pairs.tolist() == [0, 1, 2]


def test_what_a_policy_leaves_open_is_asked_where_it_matters() -> None:
    rows: Any = [
        (0, 0, [(1, 2, 1)]),
        (0, 1, [(1, 1, 1)]),
        (1, 0, [(1, 1, 0)]),
        (1, 1, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    for policy, undecided in (
        ("optimal", [1]),
        (solve(mdp), [1]),
        ({0: 1}, [1]),
        ([1, 0, 0], []),
        (np.array([0.0, 1, 1, 0, 1]), []),
    ):
        chain, open_ = PolicyChain.held_fixed(mdp, policy)
        assert np.flatnonzero(open_).tolist() == undecided
        chain.require_said(open_, "here")  # all is over there
    rows[3] = (1, 1, [(1, 1, 3)])
    mdp = MDP.from_outcomes(rows, "1/2")
    every = np.array([False, True, False])
    for policy, refused in (([1, 0, 0], True), ([0, 0, 0], False)):
        chain = PolicyChain.of(mdp, policy)
        chain.require_said(~every & False, "here")
        if refused:
            with pytest.raises(ModelError, match="names no action") as error:
                chain.require_said(every, "here")
            assert "state 1, here" in str(error.value)
        else:
            chain.require_said(every, "here")  # it does not come there
    rows[2] = (1, 0, [(1, 1, 3)])
    alike = MDP.from_outcomes(rows, "1/2")
    PolicyChain.of(alike, [1, 0, 0]).require_said(every, "here")


# ---- floats first, then rationals ----------------------------------------------------------------


def test_poor_floats_have_less_than_half_of_their_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = small_model(0)
    value = np.array([-4.0, 1.0])
    for error, wanted in ((2.0**-24, False), (2.0**-23.9, True), (2.0**-25, False)):
        point = BoundedVector(value=value, error=np.array([0.0, error]))
        assert is_too_inaccurate(point, mdp) == wanted
    coarse = BoundedVector(value=value, error=value**2)
    for most, wanted in ((mdp.n_states, True), (mdp.n_states - 1, False)):
        monkeypatch.setattr(policy_chain, "FEW", most)
        assert is_too_inaccurate(coarse, mdp) == wanted


def test_large_chains_are_not_solved_in_rationals(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = small_model(0)
    monkeypatch.setattr(policy_chain, "MANY", mdp.n_states)
    with floats_first(mdp):
        raise SolverError(Status.NO_BOUND)
    monkeypatch.setattr(policy_chain, "MANY", mdp.n_states - 1)
    for detail in ("", "a reason"):
        with (
            pytest.raises(SolverError, match="rational arithmetic takes up to 6 states") as told,
            floats_first(mdp),
        ):
            raise SolverError(Status.NO_BOUND, detail)
        assert told.value.status is Status.TOO_LARGE
        assert (detail or "double precision cannot") in str(told.value)


def test_numbers_are_rounded_once() -> None:
    point = round_fractions([F(1, 3), F(0), F(-7, 2**80), F(1, 10**400)])
    assert point.value.tolist() == [1 / 3, 0, -7 / 2**80, 0]
    assert point.error[0] == UNIT / 3
    assert point.error[1] == 0
    assert point.error[2] == pytest.approx(7 / 2**133, rel=1e-12)
    assert 0 < point.error[3] <= 2.0**-900
    with pytest.raises(SolverError, match="beyond the range of floats"):
        round_fractions([F(10) ** 400])


def test_visits_of_a_chain_go_back_to_rationals_where_floats_are_poor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mdp = small_model(6, "1/2")
    chances = random_policy(mdp, 6)
    monkeypatch.setattr(policy_chain, "is_too_inaccurate", lambda *_: True)
    equations = PolicyChain.of(mdp, given(chances)).discounted
    assert isinstance(equations, PolicyEquations)
    law = law_of(mdp, chances)
    moves = [{} if mdp.terminal[s] else {t: p / 2 for t, p in row.items()} for s, _, _, row in law]
    near(equations.visits, oracle.visits(dict(mdp.start), moves), 1)
