"""The mean of the worst episodes: all policies of the whole past are tried on small models."""

from collections.abc import Iterator
from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest

from exact_mdp import MDP, best_cvar

Law = dict[F, F]


def laws(rows: dict[int, list[list[tuple[F, int, F]]]], state: int, rate: F) -> Iterator[Law]:
    """Yield the law of the return of every policy, which may know the whole past."""
    if state not in rows:
        yield {F(0): F(1)}
        return
    for action in rows[state]:
        for after in product(*([*laws(rows, t, rate)] for _, t, _ in action)):
            law: Law = {}
            for (p, _, r), below in zip(action, after, strict=True):
                for x, q in below.items():
                    law[r + rate * x] = law.get(r + rate * x, F(0)) + p * q
            yield law


def worst_mean(law: Law, share: F) -> F:
    """The mean of the worst `share` of the episodes, by taking them in order."""
    left, total = share, F(0)
    for x, p in sorted(law.items()):
        total, left = total + min(p, left) * x, left - min(p, left)
    return total / share


@pytest.mark.parametrize("share", ["1/10", "1/3", "1"])
@pytest.mark.parametrize("seed", range(6))
def test_no_policy_of_the_whole_past_has_a_better_mean(seed: int, share: str) -> None:
    rng = np.random.default_rng(seed)
    rows: dict[int, list[list[tuple[F, int, F]]]] = {}
    for state in range(3):  # each action leads to two of the later states; 3 is the end
        rows[state] = [
            [(F(k, 4), int(t), F(int(rng.integers(-4, 5)))) for k, t in ((1, state + 1), (3, 3))]
            for _ in range(2)
        ]
    outcomes = [(s, a, row) for s, actions in rows.items() for a, row in enumerate(actions)]
    mdp = MDP.from_outcomes([*outcomes, (3, 0, [(1, 3, 0)])], 1)
    found = best_cvar(mdp, share)
    assert found.value == max(worst_mean(law, F(share)) for law in laws(rows, 0, F(1)))
    assert worst_mean(found.distribution(), F(share)) == found.value
    assert found.violations() == []
