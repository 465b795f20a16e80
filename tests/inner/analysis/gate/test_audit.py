"""Parts of an audit that floats do not reach: errors as great as allowed."""

from typing import Any

import numpy as np
import pytest

from exact_mdp import MDP, SolverError, assert_policy_optimal, check
from exact_mdp.solvers.values.policy_chain import Equations


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
