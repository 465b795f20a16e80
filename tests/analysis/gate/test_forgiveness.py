"""What the rounding of floats forgives: all that a solver proposes, and no loss beyond it."""

from fractions import Fraction
from itertools import pairwise
from random import Random
from typing import Any

import numpy as np
import pytest

from exact_mdp import MDP, ModelError, check, solve


def model_of_fractions(rng: Random) -> MDP:
    """Actions that are equal but for their roundings, and action 3, which earns 1e-9 less."""
    states, parts = rng.randint(1, 5), rng.choice([3, 6, 7, 10])
    rows: list[Any] = [(states, 0, [(1, states, 0)])]
    for state in range(states):
        cuts = [0, *sorted(rng.randint(0, parts) for _ in range(2)), parts]
        law = [((high - low) / parts, rng.randint(0, states)) for low, high in pairwise(cuts)]
        earned = rng.randint(-3, 3) / parts
        for action in range(3):
            law = rng.sample([each for each in law if each[0]], k=sum(p > 0 for p, _ in law))
            (p, target), cut = law[0], rng.choice([1, 3, 10])
            rows.append((state, action, [(q, t, earned) for q, t in law[1:]]))
            rows[-1][2].extend([(p / cut, target, earned)] * cut)
        rows.append((state, 3, [(q, t, earned - 1e-9) for q, t in law]))
    if rng.random() < 0.5:  # some policies never end
        rows.append((states, 1, [(1, 0, -1 / parts)]))
    return MDP.from_outcomes(rows, rng.choice([1, 1, 0.9, 1 / 3, 0.99]))


@pytest.mark.parametrize("seed", range(100))
def test_what_solve_returns_passes(seed: int) -> None:
    """Rows of floats miss 1, which breaks ties; who loses more than that explains still fails."""
    rng = Random(seed)
    mdp = model_of_fractions(rng)
    policy = solve(mdp).policy
    try:
        audit = check(mdp, policy)
    except ModelError:  # infinite totals are not compared
        return
    assert audit.passed, audit
    worse = [3, *policy[1:]]
    assert not check(mdp, worse).passed
    assert not check(mdp, worse, exact_values=False).passed


@pytest.mark.parametrize("wait", [0.0, None])
def test_rounding_is_forgiven_on_the_way_to_where_a_policy_stays(wait: float | None) -> None:
    """Waiting for ever for nothing, or going round a cycle that earns nothing on the whole."""
    for paid, passed in ((0.3, True), (0.1 + 0.2, True), (0.3 - 2.0**-52, False)):
        rows: list[Any] = [(0, 0, [(1, 2, paid)]), (0, 1, [(1, 1, 0.1)]), (1, 0, [(1, 2, 0.2)])]
        if wait is None:
            rows += [(s, 0, [(0.5, 2, r), (0.5, 3, r)]) for s, r in ((2, 0.7), (3, -0.7))]
        else:
            rows += [(2, 0, [(1, 2, wait)]), (2, 1, [(1, 3, -0.5)]), (3, 0, [(1, 3, 0)])]
        mdp = MDP.from_outcomes(rows)
        one, other = check(mdp, [0] * 4), check(mdp, [1, 0, 0, 0])
        rounding = (np.spacing(paid) + np.spacing(0.1) + np.spacing(0.2)) / 2
        assert (one.passed, other.passed) == (passed, paid <= 0.1 + 0.2)
        assert float(one.forgiven) == pytest.approx(rounding, rel=1e-6)
        assert not passed or check(mdp, solve(mdp)).passed


def test_numbers_that_are_no_floats_are_not_forgiven() -> None:
    """Rewards are exact here beside rows of floats, then rows beside rewards of floats."""
    tiny = Fraction(1, 10**18)
    split: list[Any] = [(0.1, 1, "1"), (0.9, 2, "1")]
    better = [(p, t, 1 + tiny) for p, t, _ in split]
    ends = [(1, 0, [(1, 3, 1)]), (2, 0, [(1, 3, 1)]), (3, 0, [(1, 3, 0)])]
    rewards = MDP.from_outcomes([(0, 0, split), (0, 1, better), *ends])
    row = [(Fraction(1, 3) + tiny * k, Fraction(2, 3) - tiny * k) for k in (0, 1)]
    rows = MDP.from_outcomes(
        [(0, k, [(p, 1, 0.0), (q, 2, 0.0)]) for k, (p, q) in enumerate(row)]
        + [(s, 0, [(1, 3, float(s == 1))]) for s in (1, 2, 3)]
    )
    for mdp in (rewards, rows):
        assert mdp.floats
        assert not check(mdp, [0] * 4).passed
        assert check(mdp, [1, 0, 0, 0]).passed


def test_floats_that_were_added_up_stay_floats() -> None:
    """Two thirds that lead to one state are exact in the table, and rounded all the same."""
    third, ends = 1 / 3, [(s, 0, [(1, 3, s)]) for s in (1, 2, 3)]
    law = [(third, 1, 0), (third, 1, 0), (third, 2, 0)]
    mdp = MDP.from_outcomes([(0, 0, law), (0, 1, [(1, 1, 0)]), *ends], "1/2")
    assert (mdp.float_probabilities, mdp.float_rewards) == (True, False)
    moved = np.spacing(third) / 2 / 2
    assert float(check(mdp, [1, 0, 0, 0]).forgiven) == pytest.approx(moved, rel=1e-6)


@pytest.mark.parametrize("method", ["value-iteration", "policy-iteration", "linear-program"])
def test_every_method_takes_the_better_of_two_near_actions(method: str) -> None:
    stay = [[0, 0.3, 0.7], [0, 1, 0], [0, 0, 1]]
    more = [[0, 0.3 + 1e-12, 0.7 - 1e-12], [0, 1, 0], [0, 0, 1]]
    for costs, best in ((False, 1), (True, 0)):
        rewards = [[0, 0], [1e6, 1e6], [0, 0]]
        mdp = MDP.from_arrays([stay, more], rewards, discount=0.9, sense="min" if costs else "max")
        solution = solve(mdp, method)
        assert solution.policy[0] == best
        assert check(mdp, solution.policy).passed
