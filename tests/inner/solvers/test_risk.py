"""The mean of the worst episodes: all policies of the whole past are tried on small models."""

from collections.abc import Iterator
from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest

from exact_mdp import MDP, ModelError, best_cvar

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


def random_model(rng: np.random.Generator, sense: str) -> MDP:
    """A model of six states and an end: each action leads up to three states further."""
    rows = []
    for state in range(6):
        for action in range(2):
            ahead = sorted({min(state + int(step), 6) for step in rng.integers(1, 4, 3)})
            weights = rng.integers(1, 8, len(ahead))
            chances = [F(int(w), int(weights.sum())) for w in weights]
            gains = [F(int(gain), 4) for gain in rng.integers(-9, 10, len(ahead))]
            rows.append((state, action, list(zip(chances, ahead, gains, strict=True))))
    start = {0: F(1, 3), 1: F(2, 3)}
    return MDP.from_outcomes([*rows, (6, 0, [(1, 6, 0)])], 1, start=start, sense=sense)


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("share", ["1/20", "1/3", "1"])
def test_floats_bound_the_exact_mean_of_the_worst_episodes(share: str, sense: str) -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        mdp = random_model(rng, sense)
        exactly, found = best_cvar(mdp, share, exact=True), best_cvar(mdp, share, exact=False)
        assert (exactly.claim, found.claim, exactly.error) == ("certified", "bounded", 0)
        assert 0 < found.error < 1e-9
        assert abs(F(found.value) - exactly.value) <= F(found.error)
        facts = found.report().facts
        assert (facts["claim"].value, facts["error_bound"]) == ("bounded", found.error)
        assert "error_bound" not in exactly.report().facts
        # The policy that is found has this value, and this mean, up to the bound.
        law = found.distribution()
        assert sum(law.values()) == pytest.approx(1, abs=1e-12)
        signed = {(x if sense == "max" else -x): F(p) for x, p in law.items()}
        own = worst_mean(signed, F(share)) * (1 if sense == "max" else -1)
        assert float(own) == pytest.approx(found.value, abs=1e-9)
        assert float(sum(x * p for x, p in law.items())) == pytest.approx(found.mean, abs=1e-9)


def test_bounded_numbers_have_no_proof() -> None:
    found = best_cvar(random_model(np.random.default_rng(1), "max"), "1/2", exact=False)
    assert "bounded" in repr(found)
    with pytest.raises(ModelError, match="no certificate"):
        found.violations()
