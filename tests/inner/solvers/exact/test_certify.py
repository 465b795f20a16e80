"""Certificates that are made: of which kind they are, and bounds around a solution."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from oracle import policies, policy_values, rows_of

from exact_mdp import (
    MDP,
    BoundedCertificate,
    ModelError,
    PolicyIteration,
    SolverError,
    Status,
    certify,
    fingerprint,
    solve,
)
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.exact import certify as module

END: Any = (1, 0, [(1, 1, 0)])
ENDING: Any = [(0, 0, [(1, 1, 3)]), (0, 1, [(1, 1, 1)]), END]
WAITING: Any = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, -1)]), END]


def parts(proof: Any) -> list[str]:
    names = ("g", "h", "w", "rank", "infinite", "order")
    return [name for name in names if getattr(proof, name) is not None]


def test_each_question_has_its_kind_of_proof() -> None:
    until = MDP.from_outcomes(WAITING, labels={"goal": {1}}).until("goal")
    surely = MDP.from_outcomes(ENDING, labels={"goal": {1}}).until("goal")
    for mdp, asked, levels in (
        (MDP.from_outcomes(ENDING), {}, ["h", "rank"]),
        (MDP.from_outcomes(ENDING, "1/2"), {}, ["h"]),
        (MDP.from_outcomes(WAITING, "1/2"), {}, ["h"]),
        (MDP.from_outcomes(WAITING), {}, ["g", "h", "w"]),
        (MDP.from_outcomes(ENDING), {"criterion": "average"}, ["g", "h", "w"]),
        (MDP.from_outcomes(ENDING, "1/2"), {"criterion": "average"}, ["g", "h", "w"]),
        (until, {}, ["h", "rank", "infinite", "order"]),
        (surely, {}, ["h", "rank"]),
    ):  # fmt: skip
        proof = certify(mdp, **asked)
        assert parts(proof) == levels
        assert proof.kind == asked.get("criterion", "total")
        assert proof.violations() == []
        assert proof.mdp is mdp
        assert proof.model == fingerprint(mdp)
    assert certify(MDP.from_outcomes(ENDING)).policy.tolist() == [0, 0]
    assert certify(MDP.from_outcomes(ENDING, sense="min")).policy.tolist() == [1, 0]


def test_what_does_not_apply_is_refused() -> None:
    mdp, endless = MDP.from_outcomes(ENDING), MDP.from_outcomes(WAITING)
    for call, said in (
        (lambda: certify(mdp, bounded=True, criterion="average"), "bounds prove a total reward"),
        (lambda: certify(endless, bounded=True), "bounds that a checker reads need every policy"),
        (lambda: certify(mdp, solution=solve(mdp)), "a solution applies only to bounds"),
    ):
        with pytest.raises(ModelError) as caught:
            call()
        assert said in caught.value.what
    wide: Any = [*ENDING, (2, 0, [(1, 1, 0)])]
    more: Any = [*ENDING[:2], (1, 0, [(1, 1, 0)]), (1, 1, [(1, 1, 0)])]
    for rows in (wide, more):
        with pytest.raises(ModelError, match="the solution belongs to another model"):
            certify(mdp, bounded=True, solution=solve(MDP.from_outcomes(rows)))


# ---- bounds --------------------------------------------------------------------------------------


def models() -> Iterator[MDP]:
    """Models that end, of either sense, at several discounts; some also never end."""
    rng = np.random.default_rng(0)
    for rate in ("0", "1/2", "9/10", "9999/10000", "1") * 4:
        for sense in ("max", "min"):
            size, rows = int(rng.integers(2, 5)), list[Any]()
            for s in range(size - 1):
                for a in sorted(rng.choice(4, rng.integers(1, 4), replace=False).tolist()):
                    weights = rng.integers(1, 6, 3).tolist()
                    targets = [int(rng.integers(s + 1, size)), *rng.integers(0, size, 2).tolist()]
                    reward = F(int(rng.integers(-9, 10)), 3)
                    each = zip(weights, targets, strict=True)
                    rows.append((s, a, [(F(w, sum(weights)), t, reward) for w, t in each]))
            rows.append((size - 1, 2, [(1, size - 1, 0)]))
            yield MDP.from_outcomes(rows, rate, sense=sense)


def values(mdp: MDP, actions: np.ndarray[Any, Any] | None = None) -> list[F]:
    """Return the values of a policy, or the best of all policies; more being better."""
    sign, end = 1 if mdp.sense == "max" else -1, {mdp.n_states - 1}
    rows = [(s, a, sign * r, law) for s, a, r, law in rows_of(mdp)]
    if actions is not None:
        rows = [row for row in rows if row[1] == actions[row[0]]]
    each = (policy_values(policy, mdp.discount_exact, end) for policy in policies(rows))
    return [max(column) for column in zip(*each, strict=True)]


def check(mdp: MDP, proof: BoundedCertificate) -> float:
    """Check that values lie between, and return how wide the bounds are."""
    low, high = proof.low.to_fractions().tolist(), proof.high.to_fractions().tolist()
    own, best = values(mdp, proof.policy), values(mdp)
    assert all(a <= b <= c <= d for a, b, c, d in zip(low, own, best, high, strict=True))
    assert low[-1] == high[-1] == 0
    assert proof.violations() == []
    assert (proof.mdp is mdp, proof.model, proof.sense) == (True, fingerprint(mdp), mdp.sense)
    assert (proof.rank is None) == (mdp.discount_exact < 1)
    return float(max(b - a for a, b in zip(low, high, strict=True)))


def test_values_lie_between_bounds_that_are_nearly_as_close_as_the_solution() -> None:
    for mdp in models():
        size = max(1.0, *(abs(float(x)) for x in values(mdp)))
        wide = check(mdp, certify(mdp, bounded=True))
        assert wide <= 2e-8 * size
        exact = solve(mdp, PolicyIteration())
        assert check(mdp, certify(mdp, bounded=True, solution=exact)) <= 1e-10 * size


def test_a_poor_solution_has_bounds_as_wide_as_it_is_poor() -> None:
    """The least c with V + c w above: the greatest gain over its margin, whose sign it may have."""
    rng = np.random.default_rng(1)
    for mdp in models():
        good = solve(mdp, PolicyIteration())
        for size in (1e-3, 1.0):
            off = np.where(mdp.terminal, 0.0, size * rng.normal(size=mdp.n_states))
            poor = replace(good, value=good.value + off)
            proof = certify(mdp, bounded=True, solution=poor)
            check(mdp, proof)
            sign, rate = 1 if mdp.sense == "max" else -1, mdp.discount
            weight, value = margin_weights(mdp.maximised).value, sign * poor.value
            up, down = [0.0], [0.0]
            for s, a, r, law in rows_of(mdp):
                if s == mdp.n_states - 1:
                    continue
                margin = weight[s] - rate * sum(float(p) * weight[t] for t, p in law.items())
                ahead = rate * sum(float(p) * value[t] for t, p in law.items())
                gain = (sign * float(r) + ahead - value[s]) / margin
                up.append(gain)
                if proof.policy[s] == a:
                    down.append(-gain)
            for level, step in ((proof.high, max(up)), (proof.low, -max(down))):
                wanted = value + step * np.where(mdp.terminal, 0.0, weight)
                np.testing.assert_allclose(level.to_floats(), wanted, rtol=1e-9, atol=1e-9 * size)


def test_the_first_step_is_large_enough_for_a_good_solution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Advantages are computed of the values, and once of either bound."""
    kept, calls = module.compute_advantages, list[int]()
    monkeypatch.setattr(
        module, "compute_advantages", lambda *a, **b: calls.append(1) or kept(*a, **b)
    )
    for mdp in models():
        solution = solve(mdp, PolicyIteration())
        calls.clear()
        certify(mdp, bounded=True, solution=solution)
        assert len(calls) == 3


def test_where_nothing_is_earned_bounds_are_0() -> None:
    """So it is where all has ended; and bounds of small values are as close as those of large."""
    nothing: Any = [(0, 0, [("1/2", 0, 0), ("1/2", 1, 0)]), (0, 1, [(1, 1, 0)]), END]
    for rows in (nothing, [(0, 0, [(1, 0, 0)])]):
        for rate in ("1/2", 1):
            proof = certify(MDP.from_outcomes(rows, rate), bounded=True)
            assert {*proof.low.top, *proof.high.top} == {0}
            assert proof.violations() == []
    small: Any = [(0, 0, [("1/2", 0, F(1, 10**9)), ("1/2", 1, F(1, 10**9))]), END]
    mdp = MDP.from_outcomes(small)
    assert check(mdp, certify(mdp, bounded=True)) <= 1e-22


def test_a_bound_holds_for_each_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not sure of the last pair alone, which the policy does not take, proves nothing."""
    kept, calls = module.compute_advantages, list[int]()

    def unsure(*given: Any, **more: Any) -> Any:
        calls.append(1)
        found = kept(*given, **more)
        doubt = (4 * np.abs(found.value).max() + 1) * (len(calls) > 1)
        return replace(found, error=found.error + np.array([0, doubt, 0]))

    monkeypatch.setattr(module, "compute_advantages", unsure)
    with pytest.raises(SolverError):
        certify(MDP.from_outcomes([*ENDING[:1], (0, 1, [(1, 1, 3)]), END]), bounded=True)
    assert len(calls) == 1 + 1 + 3


def test_bounds_that_floats_never_prove_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, calls = module.compute_advantages, list[int]()

    def unsure(*given: Any, **more: Any) -> Any:
        calls.append(1)
        found = kept(*given, **more)
        doubt = 4 * np.abs(found.value).max() + 1
        return replace(found, error=found.error + doubt) if len(calls) > 2 else found

    monkeypatch.setattr(module, "compute_advantages", unsure)
    with pytest.raises(SolverError) as caught:
        certify(MDP.from_outcomes(ENDING), bounded=True)
    assert caught.value.status is Status.NO_BOUND
    assert len(calls) == 2 + 3


def test_what_is_proven_is_what_is_asked() -> None:
    rows: Any = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 0, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    assert module.certify_and_check(mdp).start_value == 5
    assert module.certify_and_check(mdp, "average").start_value == 1
