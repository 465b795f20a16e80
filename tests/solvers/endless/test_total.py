"""The total reward at discount 1 against the enumeration of all policies, and what proves it."""

from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from math import inf

import numpy as np
import pytest
from answers import holds
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import gridworld
from oracle import reaching
from strategies import Pairs, Row, any_models, model_of

from exact_mdp import MDP, ModelError, PrecisionWarning, certify, solve


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


def test_only_pairs_that_lose_much_are_left_out_of_the_float_model() -> None:
    """A slippery grid, -1 a step: near ties stay in, whose loss loose bounds could not bear out."""
    mdp = gridworld(8).with_(discount=1)
    holds(solution := solve(mdp), certify(mdp).value)
    assert solution.error_bound < 1e-6


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


@pytest.mark.parametrize("solver", [None, "value-iteration", "gauss-seidel", "linear-program"])
def test_a_circle_that_loses_less_than_the_tolerance_is_left(solver: str | None) -> None:
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
