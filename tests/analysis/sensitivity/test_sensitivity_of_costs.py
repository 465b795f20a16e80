"""Draws and boxes of a model of costs: what they find of its negation, with the sign turned."""

from __future__ import annotations

import numpy as np

from exact_mdp import MDP, Parametric, moving, psa, sobol

# A short way that may fail, and a long one: the costs of failing decide which is better.
COSTS = MDP.from_outcomes(
    [
        (0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]),
        (0, 1, [("3/4", 1, 4), ("1/4", 0, 4)]),
        (1, 0, [(1, 3, 0)]),
        (2, 0, [(1, 1, 7)]),
        (2, 1, [("1/3", 1, 5), ("2/3", 0, 5)]),
        (3, 0, [(1, 3, 0)]),
    ],
    sense="min",
)


def family(mdp: MDP) -> Parametric:
    return moving(mdp, {"short": [(0, 1)], "long": [(1, 1)], "back": [(4, 1)]})


BOTH = family(COSTS), family(COSTS.negated())
SPANS = {"short": ("1/4", "3/4"), "long": ("1/2", "9/10"), "back": ("1/10", "9/10")}


def test_probabilistic_analysis() -> None:
    costs, rewards = (psa(each, 60, rng=1, policy=[1, 0, 0, 0]) for each in BOTH)
    assert (costs.optimal == -rewards.optimal).all()
    assert (costs.values == -rewards.values).all()
    assert (costs.counts == rewards.counts).all()
    assert (costs.lost == rewards.lost).all()
    assert costs.start.value == -rewards.start.value > 0
    assert [each.name for each in costs.candidates] == [each.name for each in rewards.candidates]
    assert (costs.regret() == rewards.regret()).all()
    assert (costs.regret() > 0).any()
    assert costs.evpi() == rewards.evpi()
    assert costs.evpi_of_candidates() == rewards.evpi_of_candidates()
    assert costs.evppi() == rewards.evppi()
    assert costs.value.value == -rewards.value.value


def test_shares_of_variance() -> None:
    names = list(SPANS)
    how = {"names": names, "ranges": SPANS, "policy": [1, 0, 0, 0], "rng": 1}
    costs, rewards = (sobol(each, n=4, **how) for each in BOTH)
    assert costs.optimal.mean == -rewards.optimal.mean
    for output in ("optimal", "fixed", "regret"):
        assert np.allclose(costs.of(output).total, rewards.of(output).total)
    assert costs.regret.mean == rewards.regret.mean > 0
