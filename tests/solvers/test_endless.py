"""Totals at discount 1 against the enumeration of all policies: optima, goals, and the gate."""

from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from math import inf, isnan

import numpy as np
import pandas as pd
import pytest
from answers import holds, near
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import gridworld
from oracle import best_total, policies, reaching, total
from strategies import Pairs, Row, any_models, model_of

from exact_mdp import (
    MDP,
    SOLVERS,
    ModelError,
    PrecisionWarning,
    certify,
    check,
    evaluate,
    return_distribution,
    simulate,
    solve,
)


@settings(max_examples=200)
@given(
    model=any_models(5), missed=st.sampled_from([inf, -inf]), sense=st.sampled_from(["max", "min"])
)
def test_a_goal_that_is_missed(model: Pairs, missed: float, sense: str) -> None:
    size, pairs = model
    sign = 1 if sense == "max" else -1
    pairs = ((0, 0, F(0), {0: F(1)}), *((s, a, sign * r, law) for s, a, r, law in pairs if s))
    mdp = model_of(size, pairs, F(1), start=size - 1)
    goal = np.arange(size) == 0
    mdp = replace(mdp, goal=goal, unreached=missed, sense=sense)
    value = reaching(pairs, missed, sign)
    try:
        optimum = certify(mdp)
    except ModelError as error:
        assert "fall without end before the goal" in str(error)  # noqa: PT017
        assert rising(pairs, value, sign)[-1] > sign * value[-1]
        with pytest.raises(ModelError, match="fall without end before the goal"):
            solve(mdp)
        return
    assert optimum.violations() == []
    if missed == -sign * inf:  # no policy has a bound that is not attained, and all come close
        most = rising(pairs, value, sign)
        for s, x in enumerate(optimum.value.tolist()):
            if x == sign * inf:
                assert most[s] > sign * value[s]
                value[s] = x
            elif value[s] != missed:
                assert most[s] <= sign * value[s] + 1e-9
    assert optimum.value.tolist() == value
    holds(solution := solve(mdp), value)
    assert solution.error_bound < 1e-6


def test_no_action_is_optimal_that_may_miss_the_goal() -> None:
    """Not for the same costs on the way to it, nor where costs may fall for ever."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [("1/2", 1, 1), ("1/2", 2, 1)]), (1, 0, [(1, 1, 0)])]
    rows += [(2, 0, [(1, 2, 0)]), (3, 0, [(1, 3, -1)]), (3, 1, [("1/2", 3, -1), ("1/2", 2, 0)])]
    rows.append((3, 2, [(1, 1, 0)]))
    goal = [False, True, False, False]
    optimum = certify(MDP.from_outcomes(rows, sense="min", labels={"goal": goal}).until("goal"))
    assert optimum.value.tolist() == [1, 0, inf, -inf]
    assert optimum.optimal_pairs.tolist() == [True, False, True, True, True, False, False]
    assert optimum.gaps.tolist() == [None] * 4  # what is lost is infinite


def rising(pairs: tuple[Row, ...], value: list, sign: int) -> list[float]:
    """The most that is earned in many steps, with the best stationary policy to follow."""
    inside = {s for s, x in enumerate(value) if abs(x) < inf}
    steps = [
        (s, float(sign * r), {t: float(p) for t, p in row.items()})
        for s, _, r, row in pairs
        if s in inside and inside.issuperset(row)
    ]
    most = [float(sign * x) if s in inside else -inf for s, x in enumerate(value)]
    for _ in range(2000):
        ahead = most.copy()
        for s, r, row in steps:
            ahead[s] = max(ahead[s], r + sum(p * most[t] for t, p in row.items()))
        if ahead == most:
            break
        most = ahead
    return most


def test_a_bandit_with_dead_ends() -> None:
    # Ghallab, Nau and Traverso, Automated Planning and Acting, figure 6.1, as in markkho/msdm,
    # tests/domains, DeadEndBandit: pull the odd one of three letters; bbb and ccc end it, aaa not.
    states = ["".join(word) for word in product("abc", repeat=3)]
    number = {word: i for i, word in enumerate(states)}
    rows = []
    for word, s in number.items():
        if len({*word}) == 1:
            rows.append((s, 0, [(1, s, -1 if word == "aaa" else 0)]))
            continue
        for place in range(3):
            if word.count(word[place]) == 1:
                after = [word[:place] + letter + word[place + 1 :] for letter in "abc"]
                rows.append((s, place, [(F(1, 3), number[each], -1) for each in after]))
    mdp = MDP.from_outcomes(rows, start={number["abc"]: 1}, states=states)
    optimum = certify(mdp)
    known = {"abc": F(-9, 2), "bab": -3, "ccb": -3, "bbb": 0, "aaa": -inf, "aab": -inf}
    assert {word: optimum.value[number[word]] for word in known} == known
    assert optimum.violations() == []
    holds(solve(mdp), optimum.value)


# ---- planted faults ------------------------------------------------------------------------------


def test_a_warning_names_the_line_that_asked() -> None:
    """Values within a tolerance that double precision cannot reach."""
    last = 39
    rows = [(s, 0, [("1/2", s + 1, 0), ("1/2", 0, 0)]) for s in range(last)]
    rows += [
        (last, 0, [("1/2", last + 1, 1), ("1/2", last + 2, 0)]),
        (last + 1, 0, [(1, last + 1, 0)]),
    ]
    home = (last + 2, 0, [(1, last + 2, 0)])
    mdp = MDP.from_outcomes([*rows, home])
    waiting = MDP.from_outcomes([*rows, home, (last + 2, 1, [(1, 0, 0)])])
    for model in (mdp, waiting):
        with pytest.warns(PrecisionWarning) as caught:
            solve(model)
        assert {each.filename for each in caught} == {__file__}
    with pytest.warns(PrecisionWarning):
        exec("solve(mdp)", {"solve": solve, "mdp": mdp})  # where nothing has a name
    with pytest.raises(ModelError, match="need every policy to end") as caught:
        certify(waiting, bounded=True)
    assert "leave out bounded=True" in caught.value.fix


@pytest.mark.parametrize(
    "solver", ["auto", *(name for name in SOLVERS if name != "backward-induction")]
)
def test_a_circle_that_loses_less_than_the_tolerance_is_left(solver: str) -> None:
    """Round and round costs 2 ** -37 a time, and the tolerance is a thousand times that."""
    loss = F(2) ** -37
    rows = [
        (0, 0, [(1, 1, 0)]),
        (1, 0, [(1, 2, 0)]),
        (1, 1, [(F(1, 3), s, 0) for s in (0, 2, 3)]),
        (2, 0, [(1, 0, -loss)]),
        (3, 0, [(1, 3, 0)]),
    ]
    holds(solve(MDP.from_outcomes(rows, 1), solver), [-loss, -loss, -2 * loss, F(0)])


# ---- policies ------------------------------------------------------------------------------------


@given(model=any_models(5), data=st.data())
def test_values_of_policies(model: Pairs, data: st.DataObject) -> None:
    size, pairs = model
    mdp = model_of(size, pairs, F(1))
    chosen = data.draw(st.sampled_from(list(policies(pairs))[:20]))
    value = total(chosen)
    evaluation = evaluate(mdp, np.array([action for _, action, _, _ in chosen]))
    near([evaluation.mean], [evaluation.start.error], value[:1])
    for number, exact in zip(evaluation.value, value, strict=True):
        assert isnan(number) or number == exact or abs(number - exact) < 1e-9


def resting() -> MDP:
    """A coin until tails, at 1 a toss; then to and fro for ever between two states, for nothing."""
    toss = [("1/2", 0, 1), ("1/2", 1, 1)]
    around = [(1, 0, [(1, 2, 0)]), (2, 0, [(1, 1, 0)]), (2, 1, [(1, 2, -1)]), (2, 2, [(1, 2, 1)])]
    return MDP.from_outcomes([(0, 0, toss), *around])


def test_a_policy_comes_to_rest() -> None:
    mdp = resting()
    evaluation = evaluate(mdp, [0, 0, 0])
    assert evaluation.mean == pytest.approx(2)
    assert evaluation.sd == pytest.approx(2**0.5)
    assert (evaluation.ends, evaluation.steps, evaluation.quantiles[0.5]) == (False, inf, 1)
    listed = return_distribution(mdp, [0, 0, 0])
    assert listed.cdf(3) == pytest.approx(7 / 8)
    assert listed.remaining < 1e-11
    drawn = simulate(mdp, [0, 0, 0], n=2000, rng=1)
    assert abs(drawn.mean - 2) < 5 * drawn.standard_error


# ---- what is lost, and where ---------------------------------------------------------------------


@settings(max_examples=40)
@given(model=any_models(4), data=st.data())
def test_what_is_lost_adds_up_where_it_is_lost(model: Pairs, data: st.DataObject) -> None:
    size, pairs = model
    mdp = model_of(size, pairs, F(1))
    # A third of a float, three times: rows that sum to 1 nearly.
    floats = MDP.from_outcomes(
        [(s, a, [(float(p), t, float(r)) for t, p in row.items()]) for s, a, r, row in pairs],
        start=dict(mdp.start),
    )
    chosen = [data.draw(st.sampled_from([a for t, a, *_ in pairs if t == s])) for s in range(size)]
    right = best_total(pairs)[0], total([row for row in pairs if row[1] == chosen[row[0]]])[0]
    for tried in (mdp, floats):
        try:
            audit = check(tried, np.array(chosen))
        except ModelError as error:
            assert "nothing can be compared" in str(error)  # noqa: PT017
            assert right[0] == right[1] != 0
            continue
        lost = audit.regret.at_start.value
        if tried is mdp:
            assert lost == right[0] - right[1]
            assert audit.passed == (lost == 0)
        if np.isfinite(float(audit.regret.optimal.value)):
            assert check(tried, "optimal").regret.at_start.value == 0
        costs = [each.cost for each in audit.disagreements]
        if 0 < lost < inf:
            assert sum(costs) == pytest.approx(float(lost), rel=1e-9)
        assert (lost == 0) == (sum(costs) == 0)


def test_rows_that_do_not_quite_sum_to_1_mean_the_same_to_the_optimum_and_to_the_policy() -> None:
    def outcomes(state: int, action: str) -> list[tuple[object, int, float]]:
        if action == "wait":
            return [(1, 0, 0)]
        reward = 1 - 5e-7 * (action == "bad")
        return [(0.999 + 8e-10, 0, reward), (0.001, 1, reward)]

    mdp = MDP.from_function(0, lambda s: [] if s else ["good", "bad", "wait"], outcomes)
    audit = check(mdp, {0: "bad"}, max_regret=0)
    assert not audit.passed
    (only,) = audit.disagreements
    assert audit.regret.at_start.value == (1 - F(1 - 5e-7)) * 1000
    assert (only.learned, only.optimal) == ("bad", ("good",))  # waiting earns nothing
    assert only.cost == pytest.approx(float(audit.regret.at_start.value))
    best = certify(mdp).start_value
    for evaluation in (evaluate(mdp, "optimal"), evaluate(mdp, {0: "good"})):
        assert abs(F(evaluation.mean) - best) <= F(evaluation.start.error)


def test_who_waits_is_blamed_where_the_way_out_is() -> None:
    rows = {"s": [(1, "t", 1)], ("t", "wait"): [(1, "u", 0)], ("t", "go"): [(1, "end", 1)]}
    rows["u"] = [(1, "t", 0)]
    mdp = MDP.from_function(
        "s",
        lambda s: ["wait", "go"] if s != "end" else [],
        lambda s, a: rows.get((s, a)) or rows[s],
    )
    audit = check(mdp, {"s": "go", "t": "wait", "u": "go"})
    assert [(e.label, e.learned, e.optimal, e.cost) for e in audit.disagreements] == [
        ("state t", "wait", ("go",), 1.0)
    ]
    assert audit.visits[0] == 1
    assert "state t: yours wait, optimal go; waits forever and loses 1" in str(audit)


def test_resting_is_an_end_in_a_model_of_records_as_in_any_other() -> None:
    """Rows that were counted do not stand in the way: it ends as the same model without counts."""
    rows = [(1, "a", "go", 1, "b"), *[(1, "b", "stay", 0, "b")] * 2, (2, "a", "end", 3, None)]
    columns = ["episode", "state", "action", "reward", "next_state"]
    counted = MDP.from_transitions(pd.DataFrame(rows, columns=columns))
    policy = {"a": {"go": "1/4", "end": "3/4"}, "b": "stay"}
    for mdp in (counted, counted.with_(table=counted.table)):
        evaluation = evaluate(mdp, policy)
        assert evaluation.mean == pytest.approx(2.5)
        assert evaluation.sd == pytest.approx(3**0.5 / 2)
        assert evaluation.quantiles == {0.05: 1.0, 0.25: 1.0, 0.5: 3.0, 0.75: 3.0, 0.95: 3.0}


@pytest.mark.parametrize(("action", "mean"), [(1, -inf), (2, inf)])
def test_a_policy_goes_on_for_ever(action: int, mean: float) -> None:
    mdp, policy = resting(), [0, 0, action]
    evaluation = evaluate(mdp, policy)
    assert evaluation.mean == mean
    assert evaluation.components == {"reward": mean}
    assert isnan(evaluation.sd)
    assert {*evaluation.quantiles.values()} == {mean}
    assert return_distribution(mdp, policy).values == (mean,)
    drawn = simulate(mdp, policy, n=3, rng=0)
    assert (drawn.mean, drawn.never_ends) == (mean, 1)


def test_who_gives_up_an_infinite_value_loses_it() -> None:
    mdp = MDP.from_function(
        "x",
        lambda s: ["loop", "leave"] if s == "x" else [],
        lambda s, a: [(1, "x", 1)] if a == "loop" else [(1, "end", 0)],
    )
    (only,) = check(mdp, {"x": "leave"}).disagreements
    assert (only.gap, only.cost, only.expected_visits) == (inf, inf, 1.0)


def test_only_pairs_that_lose_much_are_left_out_of_the_float_model() -> None:
    """A slippery grid, -1 a step: near ties stay in, whose loss loose bounds could not bear out."""
    mdp = gridworld(8).with_(discount=1)
    holds(solution := solve(mdp), certify(mdp).value)
    assert solution.error_bound < 1e-6
