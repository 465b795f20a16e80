"""Totals, rewards per step and limits that an audit is about, beside fractions and all policies."""

from fractions import Fraction as F
from itertools import product
from math import inf, isnan
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import given, random_policy, small_model

from exact_mdp import MDP
from exact_mdp.analysis.gate import criteria as module
from exact_mdp.analysis.gate.criteria import (
    Average,
    Total,
    UnderLimits,
    Verdict,
    action_of,
    find_policy_disagreements,
    format_alternatives,
    format_claimed_number,
)
from exact_mdp.analysis.gate.regret import policy_regret
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import Bounded, Certified, SolverError, Status
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.values.policy_chain import PolicyChain, PolicyEquations


def test_a_verdict_says_what_was_found() -> None:
    for decision, passed, words in (
        (True, True, "passed: the regret is zero: it is 0"),
        (False, False, "failed: the regret is not zero: it is 0"),
        (None, False, "failed: the regret is not known to be zero: it is 0"),
    ):
        verdict = Verdict("the regret", "zero", decision, "it is 0")
        assert verdict.passed is passed
        assert str(verdict) == words
        assert verdict.name == "the regret is zero"
    assert format_claimed_number(Certified(value=F(1, 3))) == "0.3333333333 (certified)"
    assert format_claimed_number(Bounded(value=1.0, error=0.5)) == "1 ± 0.5 (bounded)"


def test_rewards_per_step_that_are_lost() -> None:
    for seed in range(16):
        mdp = small_model(seed, "1/2", leaving=False, ends=seed % 2, states=3)
        mdp = mdp.with_(sense="min" if seed % 3 == 0 else "max")
        chances = random_policy(mdp, seed, pure=seed % 4 == 0)
        rows = [(s, a, mdp.sense.sign * r, row) for s, a, r, row in oracle.rows_of(mdp)]
        best, bias = oracle.best_average(rows)
        chain = oracle.mixed(rows, chances)
        own, _ = oracle.gain_and_bias(chain)
        about = Average(chain=PolicyChain.of(mdp, given(chances)))
        lost = about.compute_regret(True)
        wanted = sum((p * (best[s] - own[s]) for s, p in mdp.start), F(0))
        assert lost.at_start == Certified(value=wanted)
        assert lost.optimal.value == mdp.sense.sign * sum(p * best[s] for s, p in mdp.start)
        assert lost.learned.value == mdp.sense.sign * sum(p * own[s] for s, p in mdp.start)
        assert lost.by_state.tolist() == [float(b - o) for b, o in zip(best, own, strict=True)]
        inner = {s for each in oracle.classes(chain) for s in each}
        for pair, (s, _, _, row) in enumerate(rows):
            first = best[s] - oracle.mean(row, best)
            assert lost.gap[pair] >= float(first) * (1 - 1e-15)
            if s not in inner:
                assert lost.gap[pair] == float(first)
        # Costs sum to the regret: visits on the way, shares of time where the policy stays.
        visits, wrong = about.find_disagreements(lost)
        star = oracle.limit(chain)
        share = [sum((p * star[s][t] for s, p in mdp.start), F(0)) for t in range(mdp.n_states)]
        moves = [{} if s in inner else row for s, _, _, row in chain]
        often = oracle.visits(dict(mdp.start), moves)
        met = [share[s] if s in inner else often[s] for s in range(mdp.n_states)]
        assert visits == pytest.approx([*map(float, met)], rel=1e-12)
        assert sum(each.cost for each in wrong) == pytest.approx(float(wanted), rel=1e-9, abs=1e-9)
        bounded = about.compute_regret(False)
        low, high = bounded.at_start.interval
        assert low <= wanted <= high <= wanted + F(1, 10**6)
        assert bounded.optimal_value == pytest.approx(
            [mdp.sense.sign * float(x) for x in best], abs=1e-6
        )
        assert bounded.by_state == pytest.approx(lost.by_state, abs=1e-6)
        assert (bounded.by_state >= 0).all()
        assert np.asarray(bounded.optimal_pairs).all()  # none is proven to lose
        assert np.asarray(bounded.unclear).sum() == mdp.n_pairs - mdp.n_states
        assert about.sums == "reward per step"
        assert len(bias) == mdp.n_states


def test_exact_models_are_forgiven_nothing_and_floats_little() -> None:
    rows: Any = [
        (0, 0, [(0.3, 0, 0.1), (0.7, 1, 0.2)]),
        (0, 1, [(0.3, 0, 0.1 + 1e-17), (0.7, 1, 0.2)]),
        (0, 2, [(0.3, 0, 0.1), (0.7, 1, 0.2 - 1e-9)]),
        (1, 0, [(0.5, 0, 0.7), (0.5, 1, 0.3)]),
    ]
    mdp = MDP.from_outcomes(rows, 0.5)
    for action, right in ((0, True), (1, True), (2, False)):
        lost = Average(chain=PolicyChain.of(mdp, [action, 0])).compute_regret(True)
        assert 0 < lost.forgiven < F(1, 10**15)
        assert lost.optimal_pairs.tolist() == [True, True, False, True]
        assert lost.keeps_limit(lost.forgiven) is right
    exact = small_model(1, "1/2", leaving=False)
    assert Average(chain=PolicyChain.of(exact, "random")).compute_regret(True).forgiven == 0


def limited(seed: int, sense: str = "max") -> MDP:
    """Two choices in a row, with rewards and costs of their own."""
    rng = np.random.default_rng(seed)
    rows: Any = []
    for s in range(2):
        for a in range(3):
            law = [(F(1, 3), s + 1, 0), (F(2, 3), 2, 0)] if s == 0 else [(1, 2, 0)]
            pay, cost = (int(x) for x in rng.integers(0, 7, size=2))
            rows.append((s, a, [(p, t, {"pay": pay, "cost": cost}) for p, t, _ in law]))
    rows.append((2, 0, [(1, 2, {"pay": 0, "cost": 0})]))
    return MDP.from_outcomes(rows, "1/2", sense=sense)


def totals(mdp: MDP, pairs: Any, name: str) -> F:
    """What a policy earns of a component, or of the reward."""
    rate, names = mdp.discount_exact, mdp.component_names
    top, below = mdp.table.expected_components_exact()
    rows = oracle.rows_of(mdp, pairs)
    if name != "reward":
        part = names.index(name)
        rows = [
            (s, a, F(int(top[pair, part]), int(below[pair])), law)
            for pair, (s, a, _, law) in zip(pairs, rows, strict=True)
        ]
    return oracle.policy_values(rows, rate, {2})[0]


def best_mixture(points: list[tuple[F, F]], bound: F, sign: int) -> F | None:
    """The greatest (or least) first number of mixtures of two points, the second within a bound."""
    found = [r for r, c in points if c <= bound]
    for (r, c), (q, d) in product(points, repeat=2):
        if c < bound < d:
            share = (bound - c) / (d - c)
            found.append(r + share * (q - r))
    return (max if sign > 0 else min)(found, default=None)


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_policy_under_limits_is_against_the_best_mixture(sense: str) -> None:
    for seed in range(4):
        mdp = limited(seed, sense)
        every = [*product(*(mdp.pairs_of(s) for s in range(3)))]
        points = [(totals(mdp, each, "reward"), totals(mdp, each, "cost")) for each in every]
        bound = sorted(c for _, c in points)[len(points) // 3] + F(1, 7)
        best = best_mixture(points, bound, mdp.sense.sign)
        assert best is not None
        for each, (reward, cost) in list(zip(every, points, strict=True))[::4]:
            chain = PolicyChain.of(mdp, mdp.pair_action[list(each)])
            about = UnderLimits.of(chain, {"cost": f"<= {bound}"})
            lost = about.compute_regret(None)
            assert about.feasible
            assert about.earned == reward
            assert about.totals == {"cost": cost}
            (limit,), (price,) = about.best.limits, about.best.price
            assert about.keeps_limit(limit) == (cost <= bound)
            assert about.room == price * (bound - cost)
            assert lost.optimal.value == best
            assert lost.learned.value == reward
            assert isinstance(lost.optimum, Certificate)
            assert lost.at_start.value == mdp.sense.sign * (best - reward)
            assert lost.forgiven == 0
            visits, wrong = about.find_disagreements(lost)
            # What is lost is what states cost in the priced model, less the room left.
            whole = sum(item.cost for item in wrong)
            assert whole + float(about.room) == pytest.approx(float(lost.at_start.value))
            assert visits[0] == 1
            (verdict,) = about.list_verdicts()
            assert verdict.subject == "the policy"
            assert verdict.limit == f"within the limit {limit}"
            assert verdict.passed == (cost <= bound)
            facts = about.list_facts()
            assert facts["kept"].value == [cost <= bound]
            assert facts["totals"].value == {"cost": cost}
            assert facts["feasible"] is True
            assert facts["room"].value == about.room
            assert facts["room"].text.endswith(": the value of the room left under the limits")
            assert facts["prices"].value == {"cost": about.best.prices["cost"]}
            table = about.list_tables()["limits of the policy"]
            assert ("NO" in str(table.rows)) == (cost > bound)


def test_limits_that_none_keeps_leave_nothing_to_compare_with() -> None:
    mdp = limited(0)
    every = [*product(*(mdp.pairs_of(s) for s in range(3)))]
    least = min(totals(mdp, each, "cost") for each in every)
    about = UnderLimits.of(PolicyChain.of(mdp, [0, 0, 0]), {"cost": f"<= {least - F(1, 9)}"})
    assert not about.feasible
    lost = about.compute_regret(None)
    assert isnan(lost.optimal.value)
    assert isnan(lost.at_start.value)
    assert np.isnan(lost.by_state).all()
    assert np.isnan(lost.optimal_value).all()
    *_, last = about.list_verdicts()
    assert last.decision is False
    assert last.told == (
        "there is not a policy that keeps all limits: none does (proven); the closest that can be "
        f"kept: cost <= {least}"
    )
    facts = about.list_facts()
    assert facts["room"] is None
    assert facts["prices"].value is None
    assert facts["closest"].value == {"cost": least}
    assert about.find_disagreements(lost)[0][0] == 1


def test_a_total_has_no_limits() -> None:
    mdp = small_model(0, 1)
    about = Total(chain=PolicyChain.of(mdp, "random"))
    assert about.sums == "discount 1"
    assert Total(chain=PolicyChain.of(small_model(0, "1/2"), "random")).sums == "discount 0.5"
    assert about.feasible
    assert [*about.list_verdicts()] == []
    assert about.list_tables() == {}
    assert set(about.list_facts().values()) == {None}
    assert about.plain
    assert not Average.plain
    assert not UnderLimits.plain
    assert about.compute_regret(True).at_start.value >= 0
    assert about.compute_regret(True).at_start.value < inf
    assert isinstance(about.compute_regret(True).at_start, Certified)
    assert isinstance(about.compute_regret(False).at_start, Bounded)


def test_large_cycles_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = small_model(2, "1/2", leaving=False, ends=0)
    about = Average(chain=PolicyChain.of(mdp, "random"))
    assert isinstance(about.compute_regret(None).at_start, Certified)
    monkeypatch.setattr(module, "LAST_CYCLE", 0)
    assert isinstance(about.compute_regret(None).at_start, Bounded)


def test_on_the_way_round_an_action_loses_what_it_earns_less() -> None:
    rows: Any = [(s, a, [(1, (s + 1) % 3, a * (s + 1))]) for s in range(3) for a in range(2)]
    mdp = MDP.from_outcomes(rows, "1/2")
    lost = Average(chain=PolicyChain.of(mdp, [0, 1, 0])).compute_regret(True)
    assert lost.gap.tolist() == [1, 0, 2, 0, 3, 0]
    assert lost.optimal_pairs.tolist() == [False, True] * 3
    assert lost.at_start.value == F(4, 3)


def test_each_row_is_forgiven_the_rounding_of_its_own_numbers() -> None:
    """0.1 may be off by 2^-57, and so may the float after it, which is 2^-56 more."""
    high = float(np.nextafter(0.1, 1))
    for pays in ((high, 0.1), (0.1, high)):
        rows: Any = [(0, a, [(1, 1, pay)]) for a, pay in enumerate(pays)]
        mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 0, 0)])], 0.5)
        for action in range(2):
            lost = Average(chain=PolicyChain.of(mdp, [action, 0])).compute_regret(True)
            assert lost.optimal_pairs.all()
            # Both policies take a number of this size in half of the steps.
            assert lost.forgiven >= F(1, 2**57)
            assert float(lost.forgiven) == pytest.approx(2.0**-57, rel=1e-5, abs=0)
            assert lost.at_start.value == (0 if pays[action] == high else F(1, 2**57))
            assert lost.keeps_limit(lost.forgiven)


def test_rewards_on_the_way_are_not_part_of_a_gain() -> None:
    """How 0.3 and 0.7 are rounded moves the gain, and how 1e6 is earned once does not."""
    rows: Any = [(0, a, [(0.3, 1, pay), (0.7, 2, pay)]) for a, pay in enumerate((1e6 + 0.1, 2e6))]
    rows += [(s, a, [(1, s, pay)]) for s, pay in ((1, 8), (2, 4)) for a in range(2)]
    lost = Average(chain=PolicyChain.of(MDP.from_outcomes(rows, 0.5), [0, 0, 0])).compute_regret(
        True
    )
    assert lost.at_start.value == 0
    assert lost.optimal_pairs.all()
    assert 0 < lost.forgiven < F(1, 10**14)


def test_near_ties_that_lose_more_than_rounding_explains_are_wrong() -> None:
    """The best policy is seldom in state 0, where 2^20 may be off by 2^-33; this one stays."""
    rows: Any = [
        (0, 0, [(1.0, 1, 2.0**20)]),
        (0, 1, [(1.0, 0, -(2.0**-35))]),
        (1, 0, [(2.0**-7, 0, -(2.0**13)), (1 - 2.0**-7, 1, -(2.0**13))]),
    ]
    mdp = MDP.from_outcomes(rows, 0.5)
    lost = Average(chain=PolicyChain.of(mdp, [1, 0])).compute_regret(True)
    assert lost.optimal.value == 0
    assert lost.at_start.value == F(1, 2**35)
    assert lost.forgiven < F(1, 2**35)
    assert lost.optimal_pairs.tolist() == [True, False, True]
    best = Average(chain=PolicyChain.of(mdp, [0, 0])).compute_regret(True)
    assert best.optimal_pairs.all()


def test_a_limit_is_kept_by_what_reaches_it() -> None:
    rows: Any = [
        (0, a, [(p, 1, {"pay": 0.7 + 0.1 * a, "cost": a / 3}) for p in (0.3, 0.7)])
        for a in range(3)
    ]
    mdp = MDP.from_outcomes([*rows, (1, 0, [(1.0, 1, {"pay": 0.0, "cost": 0.0})])])
    third = F(1 / 3)
    for action, kept in ((0, True), (1, True), (2, False)):
        about = UnderLimits.of(PolicyChain.of(mdp, [action, 0]), {"cost": f"<= {third}"})
        assert [about.keeps_limit(limit) for limit in about.best.limits] == [kept]
        assert about.compute_regret(None).forgiven == 0  # floats or not
        (verdict,) = about.list_verdicts()
        assert verdict.text == f"its total is {float(action * third):.10g} (certified)"
    least = UnderLimits.of(PolicyChain.of(mdp, [0, 0]), {"cost": f">= {third}"})
    assert not least.keeps_limit(least.best.limits[0])
    none = UnderLimits.of(PolicyChain.of(mdp, [0, 0]), {"cost": ">= 1"})
    *_, last = none.list_verdicts()
    assert last.text.endswith("cost >= 0.6666666667")


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("discount", [F(1, 2), F(1)])
def test_each_state_costs_its_gap_as_often_as_it_is_visited(discount: F, exact: bool) -> None:
    for seed in range(8):
        mdp = small_model(seed, discount, states=4).with_(sense="min" if seed % 2 else "max")
        chances = random_policy(mdp, seed, pure=seed % 3 == 0)
        chain = PolicyChain.of(mdp, given(chances))
        lost = policy_regret(chain, exact=exact)
        visits, wrong = find_policy_disagreements(chain, lost)
        rows = [(s, a, mdp.sense.sign * r, row) for s, a, r, row in oracle.rows_of(mdp)]
        best, optimal = oracle.solve_exact(mdp.n_states, rows, discount)
        law = oracle.mixed(rows, chances)
        moves = [
            {} if mdp.terminal[s] else {t: discount * p for t, p in row.items()}
            for s, _, _, row in law
        ]
        often = oracle.visits(dict(mdp.start), moves)
        assert visits == pytest.approx([*map(float, often)], rel=1e-11)
        gap = [F(0)] * mdp.n_states
        for (s, a), chance in chances.items():
            _, _, r, row = rows[mdp.pair(s, a)]
            gap[s] += chance * (best[s] - r - discount * oracle.mean(row, best))
        assert {each.state for each in wrong} == {s for s, g in enumerate(gap) if g}
        for each in wrong:
            s = each.state
            assert each.gap == pytest.approx(float(gap[s]), rel=1e-9)
            assert each.expected_visits == pytest.approx(float(often[s]), rel=1e-9)
            assert each.cost == pytest.approx(float(often[s] * gap[s]), rel=1e-9)
            assert each.label == mdp.space.label(s)
            assert [*each.optimal] == [mdp.actions[a] for a in sorted(optimal[s])]
            assert each.learned == action_of(chain, s)
        order = [(-each.cost, -each.gap, each.state) for each in wrong]
        assert order == sorted(order)
        total = sum(each.cost for each in wrong)
        assert total == pytest.approx(float(lost.at_start.value), rel=1e-9, abs=1e-9)


def test_waiting_for_ever_is_charged_to_those_who_wait() -> None:
    """In state 1 one may stay forever, or leave and earn 4; half of all runs come there."""
    rows: Any = [
        (0, 0, [(F(1, 2), 1, 0), (F(1, 2), 2, 1)]),
        (1, 0, [(1, 1, 0)]),
        (1, 1, [(1, 2, 4)]),
        (2, 0, [(1, 2, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    chain = PolicyChain.of(mdp, [0, 0, 0])
    lost = policy_regret(chain)
    visits, (only,) = find_policy_disagreements(chain, lost)
    assert lost.at_start.value == 2
    assert visits[:2].tolist() == [1, inf]
    assert (only.state, only.gap, only.cost, only.expected_visits) == (1, 4, 2, inf)
    assert only.optimal == ("1",)
    seldom = PolicyChain.of(mdp.with_(start={0: F(1, 8), 2: F(7, 8)}), [0, 0, 0])
    _, (only,) = find_policy_disagreements(seldom, policy_regret(seldom))
    assert (only.gap, only.cost) == (4, 0.25)
    elsewhere = PolicyChain.of(mdp.with_(start=2), [0, 0, 0])
    visits, (only,) = find_policy_disagreements(elsewhere, policy_regret(elsewhere))
    assert (only.cost, only.expected_visits) == (0, 0)


def small_regrets() -> tuple[PolicyChain, Any, Any, Any]:
    """Return a chain, its regret exactly and in floats, and the visits that it is made of."""
    mdp = small_model(1, "1/2")
    chain = PolicyChain.of(mdp, given(random_policy(mdp, 1)))
    exact, bounded = (policy_regret(chain, exact=each) for each in (True, False))
    return chain, exact, bounded, find_policy_disagreements(chain, exact)[0]


def test_visits_are_found_in_rationals_where_floats_have_few_digits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain, exact, bounded, wanted = small_regrets()

    def unbounded(_: Any) -> Any:
        raise SolverError(Status.NO_BOUND)

    monkeypatch.setattr(PolicyEquations, "visits", property(unbounded))
    visits, _ = find_policy_disagreements(chain, exact)
    assert visits == pytest.approx(wanted, rel=1e-14)
    assert np.isnan(find_policy_disagreements(chain, bounded)[0][chain.reached]).all()


def test_visits_in_floats_count_if_they_are_right_to_2_to_the_40(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain, exact, bounded, wanted = small_regrets()
    near = wanted + np.where(wanted == wanted.max(), 2 - wanted.max(), 0.0)  # the greatest is 2
    for error, kept in ((2.0**-39, True), (2.0**-38.5, False)):
        visits = BoundedVector(value=near, error=np.full(len(near), error))
        monkeypatch.setattr(PolicyEquations, "visits", property(lambda _, visits=visits: visits))
        found = find_policy_disagreements(chain, exact)[0]
        assert found == pytest.approx(near if kept else wanted, rel=1e-14)
        assert find_policy_disagreements(chain, bounded)[0].tolist() == near.tolist()


def test_what_is_not_met_costs_nothing_and_comes_in_order_of_its_gap() -> None:
    """Gaps may be infinite there, and of actions that are not taken."""
    rows: Any = [(s, a, [(1, 6, s % 3 * a)]) for s in range(5) for a in (0, 1)]
    rows += [(5, 0, [(1, 5, 1)]), (5, 1, [(1, 6, 0)]), (5, 2, [(1, 5, 1)])]
    rows += [(6, 0, [(1, 6, 0)]), (7, 0, [(1, 7, -1)]), (4, 2, [(1, 7, 0)])]
    mdp = MDP.from_outcomes(rows, start=6)
    for last, first in (([1, 1, 1], [(5, inf), (2, 2), (1, 1)]), ([2, 0, 0], [(4, inf), (2, 2)])):
        chain = PolicyChain.of(mdp, [0, 0, 0, 0, last[0], last[1], 0, 0])
        _, wrong = find_policy_disagreements(chain, policy_regret(chain))
        assert [(each.state, each.gap) for each in wrong][: len(first)] == first
        assert [each.cost for each in wrong] == [0] * len(wrong)
        assert {each.expected_visits for each in wrong} == {0}
    one = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 0)])], "1/2")
    alone = PolicyChain.of(one, [1])
    _, (only,) = find_policy_disagreements(alone, policy_regret(alone))
    assert (only.gap, only.expected_visits, only.cost) == (1, 2, 2)


def test_names_of_actions_in_a_state() -> None:
    rows: Any = [(0, a, [(1, 1, a)]) for a in range(6)] + [(1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, actions=[*"abcdef"])

    def taken(*shares: int) -> str:
        chances = {"abcdef"[k]: F(share, sum(shares)) for k, share in enumerate(shares) if share}
        return action_of(PolicyChain.of(mdp, {0: chances}), 0)

    assert taken(0, 0, 1, 0, 0, 0) == "c"
    assert taken(1, 0, 3, 0, 0, 0) == "0.25 a, 0.75 c"
    assert taken(1, 1, 2, 0, 0, 4) == "0.125 a, 0.125 b, 0.25 c, 0.5 f"
    assert taken(1, 1, 1, 1, 1, 1) == "any of 6"
    assert taken(1, 1, 1, 1, 1, 0) == "any of 5"
    assert taken(1, 2, 3, 4, 6, 0) == "0.375 e, 0.25 d, 0.1875 c, 2 others"
    assert format_alternatives(["a"]) == "a"
    assert format_alternatives([*"abcd"]) == "a or b or c or d"
    assert format_alternatives([*"abcde"]) == "a or b or c or 2 others"
