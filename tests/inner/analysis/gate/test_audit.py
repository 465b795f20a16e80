"""What an audit says of a few models whose numbers are worked out by hand."""

import json
from dataclasses import replace
from fractions import Fraction as F
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_models import small_model

from exact_mdp import (
    MDP,
    Column,
    ModelError,
    Policy,
    SolverError,
    StateSpace,
    assert_policy_optimal,
    check,
)
from exact_mdp.analysis.gate import audit as module
from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.criteria import Disagreement
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
        repr(audit.certificate)
    assert "exact_values=True" in refused.value.fix
    assert check(audit.mdp, audit.policy, exact_values=True).certificate.regret == 0


def read_facts(audit: Audit, **asked: Any) -> tuple[dict[str, Any], dict[str, str]]:
    """Return what a report says to machines, and what it says to people."""
    report = audit.report(**asked)
    return json.loads(report.json()), report.lines()


def test_a_report_has_its_lines_in_the_order_in_which_people_read_them() -> None:
    audit = audit_of(choices("min"), [0, 0, 1, 0], max_regret=1, max_relative_regret="1/100")
    told = [
        "the regret is not at most 1: it is 2.285714286 (certified)",
        "the relative regret is not at most 0.01: it is 0.0987654 (certified)",
    ]
    assert [*read_facts(audit)[1].items()] == [
        ("passed", "no: FAILED"),
        ("checks", "; ".join(told)),
        ("regret", "2.285714286 (certified)"),  # 8/7 visits lose 1, and 4/7 lose 2
        ("relative regret", "0.0987654321"),
        ("optimal value", "-23.14285714 (certified)"),
        ("learned value", "-20.85714286 (certified)"),
        ("agreement", "33.3% of the states with a choice, 14.3% of the visits to them"),
    ]
    lines = audit.message().splitlines()
    assert lines[:3] == [
        "read as a policy, discount 1, costs to minimise, start state 0",
        *(f"failed: {each}" for each in told),
    ]
    assert audit.report().notes == []
    (table,) = audit.report().shown_tables()
    assert table.note == module.COLUMNS
    assert table.cells() == [
        ["state 1", "0", "1", "1.14286", "0.571429", "50.0%"],
        ["state 0", "0", "1", "1.14286", "1.14286", "50.0%"],
    ]


def test_without_a_limit_a_loss_below_1_fails() -> None:
    rows: Any = [(0, 0, [(1, 1, F(1, 2))]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    for action, passed in ((0, True), (1, False)):
        audit = audit_of(MDP.from_outcomes(rows), [action, 0])
        assert audit.passed is passed
        # One state has a choice, and it is visited once.
        assert (audit.agreement, audit.agreement_by_visits) == (passed, passed)
        wrong = audit.report().tables["disagreements"].rows
        assert [row["share"] for row in wrong] == ([] if passed else [1])
    none = audit_of(MDP.from_outcomes(rows[::2]), [0, 0])
    assert (none.agreement, none.agreement_by_visits) == (1, 1)
    assert none.report().lines()["agreement"].startswith("100.0% of the states")


def test_rounding_of_given_floats_is_forgiven_and_said() -> None:
    high = float(np.nextafter(0.1, 1))
    rows: Any = [(0, 0, [(1, 1, 0.1)]), (0, 1, [(1, 1, high)]), (1, 0, [(1, 1, 0.0)])]
    audit = audit_of(MDP.from_outcomes(rows), [0, 0])
    assert audit.value.value == F(high) - F(0.1)
    assert audit.value.value <= audit.forgiven < F(1, 10**16)
    (verdict,) = audit.verdicts
    assert verdict.passed
    assert verdict.name == "the regret is zero up to the rounding of the given floats"
    assert verdict.text == (
        "it is 1.387778781e-17 (certified); rounding can move it by up to "
        f"{float(audit.forgiven):.2g}"
    )
    assert not audit_of(MDP.from_outcomes(rows), [0, 0], max_regret=0).passed


def test_infinite_losses_have_no_share() -> None:
    end: Any = (1, 0, [(1, 1, 0)])
    for rows, action, ratio, said, text in (
        ([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)])], 1, None, None, "infinite"),
        ([(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 5)])], 0, np.inf, "inf", "inf"),
        ([(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, -1)])], 1, None, None, "0, or may be"),
    ):
        audit = audit_of(MDP.from_outcomes([*rows, end]), [action, 0])
        facts, lines = read_facts(audit)
        assert audit.relative_regret == ratio
        assert facts["relative_regret"] == said
        assert lines["relative regret"].endswith(text)
        finite = np.isfinite(float(audit.value.value))
        listed = audit.report().tables["disagreements"].rows
        assert [row["share"] for row in listed] == ([1] if finite else [None])


def test_states_that_are_never_reached_have_no_share() -> None:
    audit = audit_of(choices().with_(start=3), [0, 1, 0, 0])
    assert audit.passed
    assert audit.never_reached == 2
    assert audit.frame()["share"].tolist() == [None, None]
    facts, lines = read_facts(audit)
    assert lines["agreement"] == (
        "33.3% of the states with a choice, 100.0% of the visits to them; 2 wrong states are never "
        "reached from state 3, and cost nothing: mdp.with_(start=…), or --start, begins elsewhere"
    )
    assert len(facts["disagreements"]) == 2
    assert audit.report().shown_tables() == []  # what costs nothing is not in the table


def turning() -> MDP:
    """Three states in turn, of which the second action earns 1, 2 and 3 more."""
    rows: Any = [(s, a, [(1, (s + 1) % 3, a * (s + 1))]) for s in range(3) for a in range(2)]
    return MDP.from_outcomes(rows, "1/2")


def test_what_bounds_leave_open_is_counted() -> None:
    """Bounds of an average prove no gap: an action is open where the optimum takes another."""
    for actions, count in (([1, 1, 1], 0), ([0, 1, 1], 1), ([1, 0, 0], 2), ([0, 0, 0], 3)):
        audit = audit_of(turning(), actions, criterion="average", exact_values=False)
        assert audit.unclear == count
        assert audit.agreement == 1
        facts, lines = read_facts(audit)
        assert facts["unclear"] == count
        assert lines.get("unclear") == (str(count) if count else None)
        said = f"in {count} more the bounds leave it open"
        assert (said in audit.message().splitlines()) is (count > 0)
    assert audit.undecided is False
    left = audit_of(turning(), [1, 1, 1], criterion="average", exact_values=False)
    assert left.undecided
    assert left.verdicts[0].text.endswith(f", {module.UNDECIDED}")
    assert module.UNDECIDED not in audit.message()


def limited() -> MDP:
    """One choice of three, which earn 0, 2 and 4 and cost as much as their number."""
    rows: Any = [(0, a, [(1, 1, {"pay": a, "cost": a})]) for a in range(3)]
    return MDP.from_outcomes([*rows, (1, 0, [(1, 1, {"pay": 0, "cost": 0})])])


def test_a_certificate_proves_a_regret_in_the_model() -> None:
    for sense in ("max", "min"):
        audit = audit_of(choices(sense), [1, 0, 1, 0])
        assert audit.certificate.regret == F(8, 7)
        assert audit.certificate.optimum.kind != "average"
    average = audit_of(turning(), [0, 0, 1], criterion="average")
    assert average.certificate.regret == 1
    assert average.certificate.value.start_value == 1
    interval = RegretInterval(
        low=0.0, high=1.0, confidence=0.9, by="robust", assumptions=(), found={}
    )
    for refused, words in (
        (replace(audit, interval=interval), "rests on an interval from records"),
        (audit_of(limited(), [1, 0], subject_to={"cost": "<= 1"}), "the optimum without limits"),
        (audit_of(choices(), [1, 0, 1, 0], exact_values=False), "bounded, not exact"),
    ):
        with pytest.raises(ModelError, match=words):
            _ = refused.certificate


def test_limits_that_none_keeps_are_told() -> None:
    kept = audit_of(limited(), [1, 0], subject_to={"cost": "<= 1"})
    facts, lines = read_facts(kept)
    assert (facts["relative_regret"], lines["relative regret"]) == (0, "0")
    assert lines["regret"] == "0 (certified)"
    assert lines["passed"] == "yes"
    none = audit_of(limited(), [1, 0], subject_to={"cost": "<= -1"})
    facts, lines = read_facts(none)
    assert [*lines] == ["passed", "checks", "learned value", "agreement", "feasible", "limits"]
    assert lines["agreement"] == "undefined: there is no optimum to agree with"
    assert facts["relative_regret"] is None
    assert none.disagreements == ()
    assert none.message().endswith("there is no optimum to compare with; learned 2")
    assert str(none).endswith("failed: no policy keeps cost <= -1")


def test_errors_of_a_table_are_weighted_by_visits() -> None:
    """Q(s, 1) is s + 1 too much where visits are as 4 : 2 : 1, and is what the policy takes."""
    mdp = choices()
    lost = policy_regret(PolicyChain.of(mdp, [1, 1, 1, 0]))
    q = np.zeros((4, 2))
    q[mdp.pair_state, mdp.pair_action] = lost.optimal_value[mdp.pair_state] - lost.gap
    q[:3, 1] += [1, 2, 3]
    q[:3, 0] -= 100
    audit = audit_of(mdp, q, kind="q")
    assert audit.q_error is not None
    assert audit.q_error.visited == pytest.approx(float(np.sqrt((4 * 1 + 2 * 4 + 1 * 9) / 7)))
    assert audit.q_error.largest == pytest.approx(100)
    assert read_facts(audit)[0]["q_error"]["visited"] == audit.q_error.visited
    # Of states that are visited forever only what is taken there has a weight.
    rows: Any = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, -1)]), (1, 0, [(1, 1, 0)])]
    waits = audit_of(MDP.from_outcomes(rows), np.array([[3.0, -9.0], [0.0, 0.0]]), kind="q")
    assert waits.q_error is not None
    assert waits.q_error.visited == 3


def in_beds(rows: Any = None, discount: Any = 1) -> tuple[MDP, Policy]:
    """Two kinds in two beds, one of which a policy that reads the kind cannot tell apart.

    For kind 0 the best action depends on the bed, and earns 4 or 2; for kind 1 it is 0, earns 1,
    and is not what the policy takes.
    """
    pay = [(4, 0), (0, 2), (1, 0), (1, 0)]
    rows = rows or [(s, a, [(1, 4, pay[s][a])]) for s in range(4) for a in range(2)]
    columns = (Column(name="kind", size=2), Column(name="bed", size=2))
    mdp = MDP.from_outcomes(
        [*rows, (4, 0, [(1, 4, 0)])], discount, start=dict.fromkeys(range(4), "1/4")
    )
    space = StateSpace(columns=columns[:1])
    mdp = mdp.with_(space=StateSpace(columns=columns, extra=("end",)))
    return mdp, Policy(space=space, actions=mdp.actions, rule=np.eye(2))


def test_what_cannot_be_seen_is_told_from_what_was_not_learned() -> None:
    """Of the optimum, (4 + 2 + 1 + 1) / 4, a policy that reads the kind has 6 / 4, this one 1."""
    audit = audit_of(*in_beds())
    assert audit.value.value == 1
    told = (
        "the best policy that reads kind alone has 1.5 (proven): 0.5 is lost because it cannot see "
        "bed, 0.5 because of what was learned"
    )
    assert audit.message().splitlines()[-1] == told
    assert told not in audit.message(explain=False)
    facts, lines = read_facts(audit)
    assert lines["representation"] == told
    assert facts["representation"]["best_value"] == 1.5
    assert facts["rows"] == [{"row": "kind 1", "learned": "1", "best": "0", "gain": 0.5}]
    assert [table.title for table in audit.report().shown_tables()] == [
        "where it is not optimal, the costliest first",
        "rows of the policy, each changed alone",
    ]
    assert audit.report().shown_tables()[1].cells() == [["kind 1", "1", "0", "0.5"]]
    assert audit.report().notes == []
    facts, lines = read_facts(audit, explain=False)
    assert (facts["representation"], facts["rows"]) == (None, None)
    assert "representation" not in lines
    assert audit.report(explain=False).notes == []
    assert "because it cannot see" not in str(audit)
    whole = audit_of(audit.mdp, [0, 1, 0, 0, 0])
    assert whole.representation is None
    assert module.UNEXPLAINED not in whole.message()


def test_what_cannot_be_split_is_said() -> None:
    """Every policy that reads the kind alone loses forever, in one bed of each kind."""
    rows = [(s, s % 2, [(1, 4, s)]) for s in range(4)]
    rows += [(s, 1 - s % 2, [(1, s, -1)]) for s in range(4)]
    mdp, _ = in_beds(rows)
    own = Policy(
        space=StateSpace(columns=mdp.space.columns[:1]),
        actions=mdp.actions,
        rule=np.array([[1.0, 0.0]] * 2),
    )
    audit = audit_of(mdp, own)
    assert not audit.passed
    assert audit.representation is None
    assert module.UNEXPLAINED in audit.message().splitlines()
    assert module.UNEXPLAINED not in audit.message(explain=False)
    assert audit.report().notes == [module.UNEXPLAINED]
    assert audit.report(explain=False).notes == []


def test_an_interval_is_in_the_report() -> None:
    interval = RegretInterval(
        low=0.25, high=0.5, confidence=0.9, by="robust", assumptions=("the sun shines",), found={}
    )
    audit = replace(audit_of(choices(), [1, 0, 1, 0], max_regret=1), interval=interval)
    facts, lines = read_facts(audit)
    told = "it is in [0.25, 0.5] at 90 % confidence, robust; 1.142857143 (certified) in the "
    assert lines["checks"] == f"the regret is at most 1: {told}estimated model"
    assert facts["regret_interval"] == [0.25, 0.5]
    assert [*lines][:3] == ["passed", "checks", "regret interval"]
    assert audit.report().notes == ["assumed: the sun shines"]
    assert audit.measures["regret_interval"] == "[0.25, 0.5] at 90 % confidence, robust"


def test_a_time_limit_that_is_left_out_is_noted() -> None:
    mdp = choices().with_(time_limit=7)
    total = "the environment stops after 7 steps; this answer is for episodes without a limit"
    for criterion, advice in (("total", ": horizon=7"), ("average", "")):
        audit = audit_of(mdp, [1, 1, 1, 0], criterion=criterion)
        assert audit.report().notes == [total + advice]
        assert str(audit).splitlines()[-1] == audit.message().splitlines()[-1] == total + advice


def test_a_question_says_how_the_policy_was_read() -> None:
    values = np.array([[0.0, 1], [0, 1], [0, 1], [0, 0]])
    for kind, source in (("q", "a Q-table: its greedy policy"), ("policy", "a policy")):
        audit = audit_of(choices(), values if kind == "q" else [1, 1, 1, 0], kind=kind)
        assert audit.read_as == kind
        assert audit.question == f"read as {source}, discount 1, start state 0"


def test_regrets_of_up_to_1000_states_are_listed() -> None:
    for size in (1000, 1001):
        rows: Any = [(s, 0, [(1, size - 1, 0)]) for s in range(1, size)]
        rows += [(0, 0, [(1, size - 1, 0)]), (0, 1, [(1, size - 1, 1)])]
        audit = audit_of(MDP.from_outcomes(rows), [0] * size, exact_values=False)
        listed = audit.report().facts["regret_by_state"].value
        assert (listed is not None) is (size == 1000)
        assert listed is None or (len(listed), listed["state 0"]) == (1000, 1)


def test_a_table_shows_the_first_ten() -> None:
    rows: Any = [(s, a, [(1, s + 1, a)]) for s in range(11) for a in range(2)]
    audit = audit_of(MDP.from_outcomes([*rows, (11, 0, [(1, 11, 0)])]), [0] * 12)
    (table,) = audit.report().shown_tables()
    assert (len(table.rows), len(table.values())) == (11, 10)


def last_actions(mdp: MDP) -> dict[int, int]:
    """The last action of each state with a choice, by state."""
    own = {state: mdp.pairs_of(state) for state in range(mdp.n_states)}
    return {state: int(mdp.pair_action[p[-1]]) for state, p in own.items() if len(p) > 1}


@pytest.mark.parametrize("seed", range(6))
def test_cells_gather_the_times(seed: int) -> None:
    """The losses of a cell are those of its states at all times, and nothing is left out."""
    plain = small_model(seed, ends=1)
    mdp = plain.within(5)
    audit = check(mdp, last_actions(plain), max_regret=99)
    assert audit.cells
    by_label: dict[str, list[Disagreement]] = {}
    for each in audit.disagreements:
        by_label.setdefault(each.label.partition(", ")[2], []).append(each)
    assert {cell["state"] for cell in audit.cells} == by_label.keys()
    for cell in audit.cells:
        own = by_label[cell["state"]]
        assert cell["times"] == len(own)
        assert cell["cost"] == pytest.approx(sum(each.cost for each in own))
        assert cell["expected_visits"] == pytest.approx(sum(each.expected_visits for each in own))
        assert {*cell["optimal"]} == {action for each in own for action in each.optimal}
    costs = [cell["cost"] for cell in audit.cells]
    assert costs == sorted(costs, reverse=True)
    assert sum(costs) == pytest.approx(float(audit), abs=1e-12)
    report, most = audit.report(), len(audit.cells)
    table = report.tables["cells"]
    assert [row["state"] for row in table.rows] == [cell["state"] for cell in audit.cells]
    assert table.first == 10
    shown = {name: report.facts[name] for name in ("cells", "disagreements")}
    assert [len(each.value) for each in shown.values()] == [most, len(audit.disagreements)]
    assert [each.text for each in shown.values()] == [None, None]
    assert len(audit._describe_costliest(most)) == most
    assert len(audit._describe_costliest(most - 1)) == most


def test_a_relative_regret_is_not_shown_without_an_optimum() -> None:
    for feasible, text in ((False, None), (True, 0.5)):
        audit: Any = SimpleNamespace(relative_regret=0.5, feasible=feasible)
        shown = module.Audit._show_relative_regret(audit)
        assert (shown.value, shown.text) == (0.5, text)


def test_a_policy_that_reads_the_time_has_no_cells() -> None:
    plain = small_model(3, ends=1)
    mdp = plain.within(3)
    assert check(mdp, "optimal").cells == []
    timed = check(mdp, np.zeros((3, 6), dtype=int), max_regret=99)
    assert timed.disagreements
    assert timed.cells == []
    assert check(small_model(3, "1/2"), "random", max_regret=99).cells == []
    cells = check(mdp, last_actions(plain), max_regret=99)
    assert " times; loses " in str(cells)
    assert "cannot see time" in str(cells)
