"""What an audit says of a few models whose numbers are worked out by hand."""

import json
from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest

from exact_mdp import MDP, ModelError, SolverError, assert_policy_optimal, check
from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.data.interval import RegretInterval
from exact_mdp.analysis.gate.regret import policy_regret
from exact_mdp.solvers.values.policy_chain import PolicyChain, PolicyEquations


def test_a_verdict_is_shown_where_visits_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    def unbounded(*_: Any, **__: Any) -> Any:
        raise SolverError("no bound")

    monkeypatch.setattr(PolicyEquations, "visits", property(unbounded))
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


def audit_of(mdp: MDP, policy: Any, **asked: Any) -> Audit:
    return check(mdp, policy, **asked)


def choices(sense: str = "max") -> MDP:
    """Three states with two actions each, of which the second is worth 1, 2 and 3 more."""
    rows: Any = [
        (s, a, [(F(1, 2), (s + 1) % 3, 10 + a * (s + 1)), (F(1, 2), 3, 10 + a * (s + 1))])
        for s in range(3)
        for a in range(2)
    ]
    pay = 1 if sense == "max" else -1
    rows = [(s, a, [(p, t, pay * r) for p, t, r in law]) for s, a, law in rows]
    return MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], sense=sense)


def test_agreement_is_a_share_of_states_and_of_visits() -> None:
    for sense in ("max", "min"):
        audit = audit_of(choices(sense), [1, 0, 1, 0])
        assert audit.agreement == pytest.approx(2 / 3)
        often = [F(8, 7), F(4, 7), F(2, 7)]  # 1, 1/2, 1/4, each time once round
        assert audit.visits[:3] == pytest.approx([*map(float, often)])
        assert audit.agreement_by_visits == pytest.approx(float(1 - often[1] / sum(often)))
        assert audit.value.value == F(8, 7)  # 4/7 visits, each of which loses 2
        (only,) = audit.disagreements
        assert (only.state, only.cost) == (1, pytest.approx(8 / 7))
        sign = 1 if sense == "max" else -1
        best = sign * (10 * F(2) + often[0] + 2 * often[1] + 3 * often[2])
        assert audit.regret.optimal.value == best
        assert audit.relative_regret == pytest.approx(float(F(8, 7) / abs(best)))
        assert audit.error == 0
        assert audit.unclear == 0


def test_shares_of_what_is_lost_sum_to_1() -> None:
    audit = audit_of(choices(), [0, 0, 0, 0])
    frame = audit.frame(full=True)
    assert frame["share"].sum() == pytest.approx(1)
    assert frame["cost"].tolist() == pytest.approx([8 / 7, 8 / 7, 6 / 7])
    assert frame["share"].tolist() == pytest.approx([8 / 22, 8 / 22, 6 / 22])
    assert frame.index.tolist() == [1, 0, 2]  # of equal costs the greater gap comes first
    assert "expected_visits" not in audit.frame().columns
    assert "expected_visits" in frame.columns
    assert frame["optimal"].tolist() == ["1", "1", "1"]


def test_limits_decide() -> None:
    lost = F(8, 7)
    for limit, passed in ((lost, True), (lost - F(1, 10**9), False), (2, True)):
        audit = audit_of(choices(), [1, 0, 1, 0], max_regret=limit)
        assert audit.passed is passed
        assert not audit.undecided
    best = F(20) + F(8 + 8 + 6, 7)
    for share, passed in ((lost / best, True), (lost / best * F(999, 1000), False)):
        assert audit_of(choices(), [1, 0, 1, 0], max_relative_regret=share).passed is passed
    both = audit_of(choices(), [1, 0, 1, 0], max_regret=2, max_relative_regret="1/1000")
    assert [each.passed for each in both.verdicts] == [True, False]
    assert not both.passed
    assert audit_of(choices(), [1, 1, 1, 0]).passed
    assert not audit_of(choices(), [1, 0, 1, 0]).passed


def test_a_share_of_nothing_is_undefined() -> None:
    rows: Any = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, -2)]), (1, 0, [(1, 1, 0)])]
    audit = audit_of(MDP.from_outcomes(rows), [1, 0], max_relative_regret=5)
    assert audit.relative_regret is None
    assert not audit.passed
    assert "undefined" in audit.message()
    negative = [(0, 0, [(1, 1, -4)]), (0, 1, [(1, 1, -6)]), rows[2]]
    audit = audit_of(MDP.from_outcomes(negative), [1, 0], max_relative_regret="1/2")
    assert audit.relative_regret == 0.5
    assert audit.passed


def test_bounds_that_do_not_decide_do_not_pass() -> None:
    rows: Any = [
        (0, 0, [(F(1, 3), 0, 1), (F(2, 3), 1, 1)]),
        (0, 1, [(1, 1, 1)]),
        (1, 0, [(1, 1, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    exact = audit_of(mdp, [1, 0])
    assert exact.value.value == F(1, 2)
    for share in (False, True):
        asked: Any = {"max_relative_regret": F(1, 3)} if share else {"max_regret": F(1, 2)}
        audit = audit_of(mdp, [1, 0], exact_values=False, **asked)
        assert audit.undecided
        assert not audit.passed
        asked = {name: limit + F(1, 1000) for name, limit in asked.items()}
        assert audit_of(mdp, [1, 0], exact_values=False, **asked).passed
        asked = {name: limit - F(1, 500) for name, limit in asked.items()}
        audit = audit_of(mdp, [1, 0], exact_values=False, **asked)
        assert (audit.passed, audit.undecided) == (False, False)
        assert 0 < audit.error < 1e-9


def test_the_records_decide_where_an_interval_is_given() -> None:
    audit = audit_of(choices(), [1, 0, 1, 0])
    for low, high, limit, passed, undecided in (
        (0.0, 0.5, F(1, 2), True, False),
        (0.0, 0.5, F(1, 4), False, True),
        (0.4, 0.5, F(1, 4), False, False),
        (0.0, 0.0, None, True, False),
        (0.0, 0.1, None, False, True),
    ):
        interval = RegretInterval(
            low=low, high=high, confidence=0.9, by="robust", assumptions=(), found={}
        )
        own = replace(audit, interval=interval, max_regret=limit)
        assert (own.passed, own.undecided) == (passed, undecided)
        assert own.regret_interval == (low, high)
        assert own.claim is interval.claim
        assert "regret in [" in str(own)
        drawn = replace(interval, draws=np.array([0.0, 0.1, 0.3, 0.5]))
        open_ = replace(own, interval=drawn)
        if undecided:
            share = 0.5 if limit else 0.25
            assert f"kept with probability {share:.3g}" in open_.message()
    assert audit.regret_interval is None


def test_a_message_names_the_costliest_states() -> None:
    rows: Any = [(s, a, [(1, s + 1, a * (s + 1))]) for s in range(8) for a in range(2)]
    mdp = MDP.from_outcomes([*rows, (8, 0, [(1, 8, 0)])])
    audit = audit_of(mdp, [0] * 9)
    lines = audit.message().splitlines()
    named = [line for line in lines if "yours 0, optimal 1" in line]
    assert len(named) == 5
    assert named[0].startswith("  state 7: ")
    assert named[0].endswith("loses 8 x 1 visits = 8")
    assert "  and 3 more, 6 in all" in lines
    assert "not optimal in 8 of 8 states with a choice" in audit.message()
    glance = str(audit).splitlines()
    assert sum("yours 0" in line for line in glance) == 3
    assert "  and 5 more, 15 in all" in glance
    assert "8 disagreements" in str(audit)
    later = audit_of(mdp.with_(start=5), [0] * 9)
    assert later.never_reached == 5
    assert "  and 5 that it never visits, which cost nothing" in later.message()
    some = audit_of(mdp.with_(start=3), [0] * 9)  # as many states as are named
    assert "more," not in some.message()
    last = audit_of(mdp.with_(start=7), [0] * 7 + [1, 0])
    assert "  7 that it never visits, which cost nothing" in last.message()
    assert last.passed
    assert audit_of(mdp, [1] * 7 + [0, 0]).message().count("disagreement") == 0
    assert ", 1 disagreement" in str(audit_of(mdp, [1] * 7 + [0, 0]))
    assert "disagreements" not in str(audit_of(mdp, [1] * 7 + [0, 0]))


def test_where_runs_begin_is_told() -> None:
    mdp = choices()
    assert audit_of(mdp, [1, 1, 1, 0]).begins == "state 0"
    several = mdp.with_(start={0: "1/2", 2: "1/2"})
    assert audit_of(several, [1, 1, 1, 0]).begins == "2 states, each with its probability"
    assert "horizon 2" in audit_of(mdp, [1, 1, 1, 0], horizon=2).question
    assert "horizon" not in audit_of(mdp, [1, 1, 1, 0]).question


def test_a_report_says_the_same() -> None:
    audit = audit_of(choices(), [1, 0, 1, 0], max_regret=1)
    report = audit.report()
    facts = json.loads(report.json())
    assert facts["passed"] is False
    assert facts["regret"] == float(F(8, 7))
    assert facts["exact_regret"] == "8/7"
    assert facts["error_bound"] == 0
    assert facts["agreement"] == audit.agreement
    assert facts["agreement_by_visits"] == audit.agreement_by_visits
    assert facts["regret_by_state"]["state 1"] == audit.regret.by_state[1]
    assert facts["learned_value"] == float(audit.regret.learned.value)
    assert facts["optimal_value"] == float(audit.regret.optimal.value)
    assert facts["forgiven"] == 0
    assert facts["unclear"] == 0
    assert len(facts["disagreements"]) == 1
    assert report.passed is False
    assert len(report.tables["disagreements"].rows) == 1
    assert audit.measures == {
        "claim": "certified",
        "regret": float(F(8, 7)),
        "agreement": audit.agreement,
    }


def test_errors_of_the_table_that_was_learned() -> None:
    """Against Q* = V* - gap, of costs V* + gap."""
    for sense in ("max", "min"):
        mdp = choices(sense)
        sign = 1 if sense == "max" else -1
        lost = policy_regret(PolicyChain.of(mdp, [1, 1, 1, 0]))
        exact = lost.optimal_value[mdp.pair_state] - sign * lost.gap
        q = np.zeros((4, 2))
        q[mdp.pair_state, mdp.pair_action] = exact + 0.5
        audit = audit_of(mdp, q, kind="q")
        assert audit.q_error is not None
        assert audit.q_error.mean == pytest.approx(0.5)
        assert audit.q_error.largest == pytest.approx(0.5)
        assert audit.passed
        assert audit_of(mdp, [1, 1, 1, 0]).q_error is None


def test_a_regret_that_rests_on_bounds_in_part_has_no_certificate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two ways of the same worth: bounds leave them open, and rationals decide at the start."""
    monkeypatch.setattr("exact_mdp.analysis.gate.regret.EXACT_IN_TIME", 0)
    rows: Any = [(0, 0, [(1, 1, F(1, 3))]), (0, 1, [(1, 2, F(2, 3))])]
    rows += [(1, 0, [(1, 3, F(2, 3))]), (2, 0, [(1, 3, F(1, 3))]), (3, 0, [(1, 3, 0)])]
    audit = check(MDP.from_outcomes(rows).within(2), [[1, 0, 0, 0]] * 2)
    assert audit.passed
    assert audit.value.value == 0
    with pytest.raises(ModelError, match="exact, but bounds prove that some actions") as refused:
        audit.certificate  # noqa: B018
    assert "exact_values=True" in refused.value.fix
    assert check(audit.mdp, audit.policy, exact_values=True).certificate.regret == 0
