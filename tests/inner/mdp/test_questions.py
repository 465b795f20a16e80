"""Questions, against sums over all runs: horizons, what is reached, what is earned until then."""

from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest
from oracle import rows_of

from exact_mdp import MDP, Policy, certify, evaluate


def drawn(seed: int, sense: str = "max", discount: str = "3/4") -> MDP:
    """Three states of one or two pairs, rewards by outcome, a start in two states."""
    rng = np.random.default_rng(seed)
    rows = []
    for s in range(3):
        for a in range(1 + int(rng.integers(0, 2))):
            weights = rng.multinomial(4, [1 / 3] * 3)
            rows.append((s, a, [(F(int(k), 4), t, int(rng.integers(-3, 4)))
                                for t, k in enumerate(weights) if k]))  # fmt: skip
    mdp = MDP.from_outcomes(rows, discount, sense=sense, start={0: "1/3", 2: "2/3"})
    return mdp.with_(labels={"there": [2]})


def best_of(mdp: MDP, steps: int, last: list[F]) -> list[F]:
    """The recursion of a horizon, written out."""
    best = max if mdp.sense == "max" else min
    value = last
    for _ in range(steps):
        value = [
            best(r + mdp.discount_exact * sum(p * value[t] for t, p in law.items())
                 for s, _, r, law in rows_of(mdp) if s == state)
            for state in range(3)
        ]  # fmt: skip
    return value


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("discount", ["1", "3/4", "0"])
@pytest.mark.parametrize("seed", range(5))
def test_a_horizon_is_its_recursion(seed: int, discount: str, sense: str) -> None:
    mdp = drawn(seed, sense, discount)
    for steps, last in product((1, 2, 3), ([F(0)] * 3, [F(5), F(-2, 3), F(1)])):
        terminal = None if not any(last) else last
        unrolled = mdp.within(steps, terminal_value=terminal)
        value = best_of(mdp, steps, last)
        assert certify(unrolled).start_value == value[0] / 3 + 2 * value[2] / 3
        assert list(certify(unrolled).value[:3]) == value


@pytest.mark.parametrize("seed", range(8))
def test_what_is_reached_is_the_sum_over_runs(seed: int) -> None:
    """The probability of coming there within 4 steps, by the best of all choices at each step."""
    mdp = drawn(seed, discount="1")
    reached = [F(0), F(0), F(1)]
    for _ in range(4):
        reached = [F(1) if s == 2 else max(sum(p * reached[t] for t, p in law.items())
                   for u, _, _, law in rows_of(mdp) if u == s) for s in range(3)]  # fmt: skip
    question = mdp.reaching("there").within(4)
    assert certify(question).start_value == reached[0] / 3 + 2 * reached[2] / 3


@pytest.mark.parametrize("seed", range(8))
def test_what_is_earned_until_then_leaves_out_what_comes_after(seed: int) -> None:
    mdp = drawn(seed)
    value = [F(0)] * 3
    question = mdp.until("there").within(5)
    for _ in range(5):
        value = [F(0) if s == 2 else max(r + F(3, 4) * sum(p * value[t] for t, p in law.items())
                 for u, _, r, law in rows_of(mdp) if u == s) for s in range(3)]  # fmt: skip
    assert certify(question).start_value == value[0] / 3 + 2 * value[2] / 3


@pytest.mark.parametrize("seed", range(4))
def test_a_policy_of_the_model_is_one_of_its_horizon(seed: int) -> None:
    mdp = drawn(seed)
    steps = 3
    rule = Policy.of(mdp, "random")
    value = [F(0)] * 3
    rows = rows_of(mdp)
    for _ in range(steps):
        value = [
            sum((r + F(3, 4) * sum(p * value[t] for t, p in law.items())) / len(own)
                for _, _, r, law in own)
            for own in ([row for row in rows if row[0] == s] for s in range(3))
        ]  # fmt: skip
    found = evaluate(mdp.within(steps), rule).start
    assert abs(F(found.value) - (value[0] / 3 + 2 * value[2] / 3)) <= F(found.error) + F(1, 10**15)
