"""Unknowns never pass: limits against certified and bounded regrets, and relative ones."""

from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from strategies import Rows, models

from exact_mdp.analysis import check
from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.io.load import save_model
from exact_mdp.solvers import Bounded, Certified, Claim


def two(first: object, second: object, *, discount: object = 1) -> MDP:
    rows = [(0, 0, [(1, 1, first)]), (0, 1, [(1, 1, second)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes(rows, discount)


@pytest.mark.parametrize(
    ("limits", "passed"),
    [
        ({}, False),
        ({"max_regret": 449}, False),
        ({"max_regret": 451}, False),
        ({"max_regret": 452}, True),
        ({"max_relative_regret": F(449, 900)}, False),
        ({"max_relative_regret": F(451, 900)}, False),
        ({"max_relative_regret": F(452, 900)}, True),
    ],
)
def test_the_upper_bound_has_to_keep_the_limit(limits: dict[str, object], passed: bool) -> None:
    """A regret of 450 ± 1.6 out of 900 is neither zero nor at most 451."""
    audit = check(two(900, 450), [1, 0], exact_values=False, **limits)
    wide = replace(
        audit.regret,
        at_start=Bounded(value=450.0, error=1.6),
        optimal=Bounded(value=900.0, error=0.0),
    )
    found = replace(audit, regret=wide)
    assert found.passed is passed
    if limits and limits != {"max_regret": 449} and not passed and "max_regret" in limits:
        assert "do not decide" in found.message()
        assert "--certify" in found.message()


def test_a_bounded_zero_is_no_zero() -> None:
    """Bounds around zero prove nothing, however narrow they are; what is open is said to be."""
    audit = check(two(900, 450), [0, 0], exact_values=False)
    for error in (1e-3, 1e-9, 1e-300):
        narrow = replace(audit.regret, at_start=Bounded(value=0.0, error=error))
        found = replace(audit, regret=narrow)
        assert (found.passed, found.undecided) == (False, True)
        assert "do not decide" in found.message()


@settings(max_examples=80)
@given(models(discounts=(F(1, 2), F(9, 10), F(1))))
def test_margins_prove_what_is_true(rows: Rows) -> None:
    """In bounds, too, a policy passes only where its exact regret is zero."""
    mdp = rows.model()
    first = mdp.pair_action[mdp.pair_offsets[:-1]]
    last = mdp.pair_action[mdp.pair_offsets[1:] - 1]
    for learned in (first, last, "random"):
        exact = check(mdp, learned)
        assert isinstance(exact.regret.at_start, Certified)
        audit = check(mdp, learned, exact_values=False)
        if audit.passed:
            assert exact.regret.at_start.value == 0
        if audit.claim is Claim.CERTIFIED:
            assert exact.regret.at_start.value == 0
        listed = {each.state for each in exact.disagreements}
        found = {each.state for each in audit.disagreements}
        assert found <= listed
        assert len(listed - found) <= audit.unclear


def test_an_optimum_with_margins_is_proven_without_rational_arithmetic() -> None:
    """Every action is better than the others by more than the errors: the regret is exactly 0."""
    audit = check(two(900, 450, discount="9/10"), [0, 0], exact_values=False)
    assert (audit.passed, audit.claim) == (True, Claim.CERTIFIED)
    assert audit.regret.at_start == Certified(value=F(0))
    # Two actions with the same row and reward are equally good, whatever the bounds.
    for learned in ([0, 0], [1, 0], "random"):
        assert check(two(F(1, 3), F(1, 3)), learned, exact_values=False).passed
    # Equal by other means: the bounds leave it open, and rational arithmetic does.
    rows = [(0, 0, [(1, 2, F(2, 3))]), (0, 1, [(1, 1, F(1, 3))]), (1, 0, [(1, 2, F(1, 3))])]
    tie = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
    left_open = check(tie, [1, 0, 0], exact_values=False)
    assert (left_open.passed, left_open.undecided, left_open.unclear) == (False, True, 1)
    assert "the bounds leave it open" in left_open.message()
    assert check(tie, [1, 0, 0]).passed


def test_what_bounds_leave_open_goes_to_rational_arithmetic(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the model is too large for it, the verdict is open, fails, and says what to do."""
    size = 70  # a cycle that is bounded unless asked for more
    rows = [(s, 0, [(1, (s + 1) % size, F(1, 3))]) for s in range(size)]
    rows += [(0, 1, [(F(1, 2), 1, 0), (F(1, 2), 1, F(2, 3))])]
    mdp = MDP.from_outcomes(rows, "9/10")
    learned = [1, *[0] * (size - 1)]
    audit = check(mdp, learned)
    assert (audit.passed, audit.claim) == (True, Claim.CERTIFIED)
    worse = MDP.from_outcomes([*rows[:-1], (0, 1, [(1, 1, F(1, 3) - F(1, 10**30))])], "9/10")
    audit = check(worse, learned)
    assert (audit.passed, audit.claim) == (False, Claim.CERTIFIED)
    assert [each.state for each in audit.disagreements] == [0]
    monkeypatch.setattr("exact_mdp.analysis.gate.check.LAST_CYCLE", 10)
    audit = check(worse, learned)
    assert (audit.passed, audit.undecided) == (False, True)
    assert "exact_values=True" in audit.message()


@pytest.mark.parametrize("limit", [float("nan"), -1, -1e-300, float("inf"), "nan", "-1/3", "inf"])
def test_limits_that_are_none_are_refused(limit: object, tmp_path: Path) -> None:
    """A limit is a number of at least 0."""
    for name in ("max_regret", "max_relative_regret"):
        with pytest.raises(ModelError) as error:
            check(two(1, 0), [0, 0], **{name: limit})
        assert error.value.where == name
        save_model(two(1, 0), tmp_path / "m.npz")
        option = f"--{name.replace('_', '-')}={limit}"
        done = run("check", tmp_path / "m.npz", "always:0", option)
        assert (done.status, done.out) == (2, "")


@pytest.mark.parametrize("exact_values", [None, True, False])
def test_a_relative_regret_of_nothing_is_undefined(
    exact_values: bool | None, tmp_path: Path
) -> None:
    """At an optimum of 0 it is neither 0 nor infinite, and does not pass."""
    mdp = two(0, -1)
    for learned in ([0, 0], [1, 0]):
        audit = check(mdp, learned, max_relative_regret=1000, exact_values=exact_values)
        assert (audit.passed, audit.relative_regret) == (False, None)
        assert "undefined" in audit.message()
    assert check(mdp, [0, 0], max_regret=0).passed
    save_model(mdp, tmp_path / "m.npz")
    np.save(tmp_path / "q.npy", [[2.0, 0.0], [0.0, 0.0]])
    done = run("check", tmp_path / "m.npz", tmp_path / "q.npy", "--json")
    assert (done.status, done.result["relative_regret"]) == (0, None)
    assert done.result["forgiven"] == 0
    done = run("check", tmp_path / "m.npz", tmp_path / "q.npy", "--max-relative-regret", "5")
    assert done.status == 1
    assert "undefined" in done.out


def test_mixed_policies_are_certified() -> None:
    """A mixture passes where all that it does is optimal, exactly."""
    audit = check(two(F(1, 3), F(1, 3)), "random")
    assert (audit.passed, audit.claim, audit.regret.at_start.value) == (True, "certified", 0)
    audit = check(two(F(1, 3), F(1, 3) - F(1, 10**40)), "random")
    assert (audit.passed, audit.regret.at_start.value) == (False, F(1, 2 * 10**40))
