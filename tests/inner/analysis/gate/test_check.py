"""An audit is a criterion times an evidence: what is asked for is what is done."""

from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from records import POLICY, estimated, recorded, staged_policy
from small_models import small_model

from exact_mdp import MDP, ModelError, Posterior, Robust, SolverError, assert_policy_optimal, check
from exact_mdp.analysis.gate import check as module
from exact_mdp.analysis.gate.criteria import Average, Total, UnderLimits
from exact_mdp.solvers.claims import Bounded, Certified, Status

ROWS: Any = [
    (0, 0, [(1, 1, {"pay": 5, "cost": 3})]),
    (0, 1, [(1, 2, {"pay": 1, "cost": 0})]),
    (1, 0, [(1, 1, {"pay": 0, "cost": 0})]),
    (2, 0, [(1, 1, {"pay": 2, "cost": 0})]),
]


def model() -> MDP:
    return MDP.from_outcomes(ROWS, "1/2")


def test_the_criterion_is_the_one_that_is_asked_for() -> None:
    mdp = model()
    assert type(check(mdp, [0, 0, 0]).criterion) is Total
    assert type(check(mdp, [0, 0, 0], criterion="average").criterion) is Average
    limited = check(mdp, [1, 0, 0], subject_to={"cost": "<= 1"})
    assert type(limited.criterion) is UnderLimits
    assert check(mdp, [0, 0, 0]).regret.at_start.value == 0
    assert check(mdp, [1, 0, 0]).regret.at_start.value == 6


def test_a_policy_that_is_named_belongs_to_the_criterion() -> None:
    """5 at once are worth more than 1 in each step at discount 1/2, but not in the long run."""
    rows: Any = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 2, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 1)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    assert check(mdp, "optimal").chain.pairs.tolist() == [0, 2, 3]
    average = check(mdp, "optimal", criterion="average")
    assert average.chain.pairs.tolist() == [1, 2, 3]
    assert average.regret.at_start.value == 0


def test_an_unknown_kind_of_interval_is_refused() -> None:
    mdp = estimated(recorded(np.random.default_rng(0), 20))
    kind: Any = "bootstrap"
    with pytest.raises(ModelError, match="unknown kind of interval 'bootstrap'") as refused:
        check(mdp, POLICY, confidence=0.9, by=kind)
    assert refused.value.where == "by"


def test_options_that_do_not_go_together_are_refused() -> None:
    mdp = model()
    refused: list[tuple[dict[str, Any], str]] = [
        ({"by": "posterior"}, "no confidence"),
        ({"confidence": 0.9, "subject_to": {"cost": "<= 1"}}, "leave out subject_to, or"),
        ({"confidence": 0.9, "criterion": "average"}, "leave out criterion, or"),
        ({"confidence": 0.9, "max_relative_regret": 1}, "leave out max_relative_regret, or"),
        ({"criterion": "average", "subject_to": {"cost": "<= 1"}}, "limits apply to total"),
        ({"criterion": "average", "horizon": 3}, "horizon"),
        ({"confidence": 0.9, "by": "magic"}, "magic"),
        ({"confidence": 0.9, "by": 3}, "not a kind of interval"),
        ({"max_regret": -1}, "max_regret is -1"),
        ({"max_relative_regret": -1}, "max_relative_regret is -1"),
    ]
    for asked, words in refused:
        with pytest.raises(ModelError, match=words):
            check(mdp, [0, 0, 0], **asked)


def test_limits_go_where_they_belong() -> None:
    audit = check(model(), [1, 0, 0], max_regret=7, max_relative_regret="1/10")
    assert (audit.max_regret, audit.max_relative_regret) == (7, F(1, 10))
    assert check(model(), [1, 0, 0]).max_regret is None


def test_the_claim_is_as_asked_and_bounds_that_do_not_decide_are_followed() -> None:
    rows: Any = [
        (0, 0, [(F(1, 3), 0, 1), (F(2, 3), 1, 1)]),
        (0, 1, [(1, 1, 1)]),
        (1, 0, [(1, 1, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    for exactly, kind in ((True, Certified), (False, Bounded), (None, Certified)):
        audit = check(mdp, [1, 0], max_regret="1/2", exact_values=exactly)
        assert isinstance(audit.regret.at_start, kind)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("exact_mdp.analysis.gate.regret.is_cheap_to_certify", lambda _: False)
        assert isinstance(check(mdp, [1, 0], max_regret=1).value, Bounded)
        assert isinstance(check(mdp, [1, 0], max_regret="1/2").value, Certified)
        patch.setattr(module, "LAST_CYCLE", 0)
        assert check(mdp, [1, 0], max_regret="1/2").undecided


def test_rational_arithmetic_follows_where_floats_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    own = Total.compute_regret

    def failing(self: Total, exact: bool | None) -> Any:
        if exact is not True:
            raise SolverError(Status.NO_BOUND)
        return own(self, exact)

    monkeypatch.setattr(Total, "compute_regret", failing)
    assert check(model(), [1, 0, 0]).value == Certified(value=F(6))
    with pytest.raises(SolverError):
        check(model(), [1, 0, 0], exact_values=False)
    monkeypatch.setattr(module, "LAST_CYCLE", 0)
    with pytest.raises(SolverError):
        check(model(), [1, 0, 0])


def test_the_evidence_is_asked_with_the_policy_and_the_confidence() -> None:
    mdp = estimated(recorded(np.random.default_rng(0), 100))
    audit = check(mdp, POLICY, confidence="9/10", by=Robust(rewards=(0, 1)))
    assert audit.interval is not None
    direct = Robust(rewards=(0, 1)).interval(mdp, audit.chain.weights, F(9, 10))
    assert (audit.interval.low, audit.interval.high) == (direct.low, direct.high)
    assert audit.interval.confidence == 0.9
    assert check(mdp, POLICY).interval is None
    drawn = check(mdp, POLICY, confidence="1/2", by="posterior").interval
    assert drawn is not None
    assert drawn.by == "posterior"
    own = Posterior().interval(mdp, audit.chain.weights, F(1, 2))
    assert drawn.high == own.high
    staged = check(mdp, staged_policy(mdp), confidence=0.9, by=Robust(rewards=(0, 1)), horizon=3)
    assert staged.interval is not None
    assert staged.interval.high <= 1 + 0.9 + 0.81 + 1e-5


def test_a_horizon_and_a_kind_of_table_are_passed_on() -> None:
    mdp = small_model(0)
    assert check(mdp, "random", horizon=2).mdp.space.untimed is not None
    assert check(mdp, "random").mdp is mdp
    q = np.zeros((mdp.n_states, mdp.n_actions))
    q[:, 0] = 1
    for kind in ("q", "policy"):
        flat = np.zeros_like(q)
        flat[np.arange(mdp.n_states), mdp.pair_action[mdp.pair_offsets[:-1]]] = 1
        assert check(mdp, flat, kind=kind).read_as == kind
    assert check(mdp, "optimal").passed
    assert check(mdp.with_(discount="1/2"), "optimal", criterion="average").passed


def test_an_assertion_fails_where_a_limit_does_not_hold() -> None:
    assert assert_policy_optimal(model(), [0, 0, 0]).passed
    with pytest.raises(AssertionError, match="the regret is not zero"):
        assert_policy_optimal(model(), [1, 0, 0])
    assert assert_policy_optimal(model(), [1, 0, 0], 6).passed
    with pytest.raises(AssertionError, match="at most 5"):
        assert_policy_optimal(model(), [1, 0, 0], 5)
    assert assert_policy_optimal(model(), [1, 0, 0], max_relative_regret=6).passed
