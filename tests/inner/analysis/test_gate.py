"""Parts of an audit that floats do not reach: errors as great as allowed."""

from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest

from exact_mdp import MDP, SolverError, assert_policy_optimal, check, evaluate
from exact_mdp.analysis.gate import regret as regret_module
from exact_mdp.analysis.gate.forgiveness import per_use, widest
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.values.policy_chain import Equations, PolicyChain, policy_of


def test_a_verdict_is_shown_where_visits_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    def unbounded(*_: Any, **__: Any) -> Any:
        raise SolverError("no bound")

    monkeypatch.setattr(Equations, "visits", property(unbounded))
    mdp = MDP.from_arrays([np.full((3, 3), 1 / 3)] * 2, [[1.0, 0.0]] * 3, discount=0.9)
    audit = check(mdp, [0, 1, 0], exact_values=False)
    assert not audit.passed
    assert np.isnan([*audit.visits, audit.agreement_by_visits]).all()
    assert audit.agreement == pytest.approx(2 / 3)
    assert "loses 1 a visit; how often it is visited is not known" in str(audit)
    assert audit.frame(full=True).loc[1, "gap"] == pytest.approx(1)
    assert audit.plot() is not None
    with pytest.raises(AssertionError, match="the regret is"):
        assert_policy_optimal(mdp, [0, 1, 0])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("learned", [[1, 0], "random"])
def test_a_bounded_regret_keeps_the_errors_of_both_values(
    monkeypatch: pytest.MonkeyPatch, learned: Any, sign: int
) -> None:
    """Values as far off as their errors allow: the interval holds the exact regret all the same."""
    rows: Any = [(0, 0, [(1, 1, F(5))]), (0, 1, [(1, 1, F(1))]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    true = check(mdp, learned).regret.at_start.value
    chain = PolicyChain.of(mdp, policy_of(mdp, learned))
    own, best = evaluate(mdp, chain), regret_module.bounded_optimum(mdp)
    shift = sign * best.weight / 8
    far = replace(own, value=own.value - 2 * shift, error=own.error + 2 * abs(shift))
    monkeypatch.setattr(regret_module, "evaluate", lambda *_: far)
    off = replace(best, value=best.value + shift, low=-0.126, high=0.126)
    low, high = regret_module._bounded(mdp, chain, off).at_start.interval
    assert low <= true <= high
    assert high - low < 0.8  # no wider than twice both errors


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_no_use_of_a_pair_is_forgiven_more_than_the_widest(exact: bool, seed: int) -> None:
    """Of rewards that differ by orders of magnitude, beside exact rows and rows of floats."""
    rng = np.random.default_rng(seed)
    rows: Any = [[[F(1, 3)] * 3] * 3] * 2 if exact else rng.dirichlet(np.full(3, 0.5), size=(2, 3))
    rewards = rng.normal(size=(2, 3, 3)) * 10.0 ** rng.integers(-9, 9, size=(2, 3, 1))
    mdp = MDP.from_arrays(rows, rewards, discount="1/2")
    value = rng.normal(size=3) * 10.0 ** rng.integers(-9, 9)
    known = FixedPoint(value=value, error=np.abs(value) / 10.0 ** rng.integers(1, 16))
    assert per_use(mdp, known).max() <= widest(mdp, known)
