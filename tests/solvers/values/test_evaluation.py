"""Mean, spread, components, steps, visits and events of a policy, against exact arithmetic."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from math import inf
from random import Random
from typing import Any

import numpy as np
import pytest
from answers import near, within
from care_oracle import READINGS
from hypothesis import given
from policy_cases import Case, care, careful, cases, directive, policy_of, state_of, uniform

from exact_mdp import (
    MDP,
    Claim,
    Evaluation,
    ModelError,
    SolverError,
    Status,
    certify,
    evaluate,
    return_distribution,
    solve,
)

POLICIES = (careful, uniform, directive)
SAMPLE = [
    dict(zip(READINGS, options, strict=True))
    for options in Random(5).sample(list(product(*READINGS.values())), 12)
]


# How the equations of a chain are solved, whatever the chain.
WAYS: dict[str, dict[str, float]] = {
    "usual": {},
    "band": {"FEW": 0, "SPARSE": 0, "CHEAP": 1e18},
    "sweeps": {"FEW": 0, "SPARSE": 0, "CHEAP": 0, "NARROW": 0},
    "bicgstab": {"FEW": 0, "SPARSE": 0, "CHEAP": 0, "NARROW": 0, "SWEEPS": 1},
    "last resort": {"FEW": 0, "SPARSE": 0, "CHEAP": 0, "NARROW": 0, "SWEEPS": 1, "STEPS": 0},
}


@contextmanager
def solved_by(way: dict[str, float]) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name, limit in way.items():
            patch.setattr(f"exact_mdp.solvers.bounds.linear.{name}", limit)
        yield


@pytest.mark.parametrize("way", WAYS)
@given(cases())
def test_every_number_lies_within_its_error_bound(way: str, case: Case) -> None:
    with solved_by(WAYS[way]):
        try:
            evaluation = evaluate(case.model, case.weights)
        except ModelError as error:
            assert case.discount == 1
            assert not case.ends
            assert "discount 1" in str(error)  # noqa: PT017
            return
    assert evaluation.ends == case.ends
    if not case.ends:
        assert evaluation.steps == inf
        if case.discount == 1:
            return
    for s in range(case.n_states):
        if s in case.live or s in case.terminal:
            near(evaluation.value[[s]], evaluation.error[[s]], [case.value[s]])
        else:
            with suppress(ModelError):  # no limit
                alone = evaluate(case.model.with_(start=s), case.weights).mean
                assert np.isnan(evaluation.value[s]) or evaluation.value[s] == pytest.approx(alone)
    numbers = evaluation.numbers
    assert within(numbers["mean"], case.mean(case.value))
    assert within(numbers["variance"], case.total_variance)
    least, most = numbers["sd"].interval
    assert max(F(least), 0) ** 2 <= case.total_variance <= F(most) ** 2
    assert within(numbers["event.hit"], case.hit)
    assert numbers["event.miss"].value == 0.0
    assert numbers["event.miss"].error < 1e-200
    assert not case.ends or within(numbers["steps"], case.steps)
    # The bounds mean something: they are near what double precision can do.
    size = max(abs(r) for row in case.rows.values() for _, _, r, _ in row)
    longest = 1 + sum(abs(x) for x in case.value) + size
    assert evaluation.start.error <= 1e-9 * longest * max(
        1, evaluation.steps if case.ends else 10_000
    )
    are_visits(case, evaluation)


def are_visits(case: Case, evaluation: Evaluation) -> None:
    """Discounted, and until the end."""
    discounted = case.visits(case.discount, case.live)
    wanted = np.array([float(discounted[s]) for s in range(case.n_states)])
    rest = 0.0 if case.discount == 1 else float(1 / (1 - case.discount))
    wanted[sorted(case.terminal)] *= rest
    own = np.add.reduceat(evaluation.occupancy, evaluation.mdp.pair_offsets[:-1])
    np.testing.assert_allclose(own, wanted, rtol=1e-7, atol=1e-9)
    if case.discount < 1 and not case.floats:
        assert evaluation.occupancy.sum() == pytest.approx(rest)
    if not case.ends:
        assert evaluation.visits.tolist() == evaluation._discounted.value.tolist()
        return
    exact = case.visits(F(1), case.ending - case.terminal)
    wanted = [float(exact[s]) for s in range(case.n_states)]
    np.testing.assert_allclose(evaluation.visits, wanted, rtol=1e-7, atol=1e-9)
    over = evaluation.mdp.terminal
    assert evaluation.visits[over].sum() == pytest.approx(1)
    assert evaluation.visits[~over].sum() == pytest.approx(evaluation.steps)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("stay", ["9/10", 1 - F(1, 10**400)])
def test_a_number_beyond_the_floats_is_refused(stay: Any, way: str) -> None:
    rows = [(0, 0, [(stay, 0, 5 * 10**307), (1 - F(stay), 1, 0)]), (1, 0, [(1, 1, 0)])]
    with solved_by(WAYS[way]), pytest.raises(SolverError, match="beyond the range of floats"):
        evaluate(MDP.from_outcomes(rows), [0, 0])


def test_factors_that_would_be_too_large_are_refused() -> None:
    """Of a walk on a square, from whose edge it falls off."""
    side, limits = 70, {"PATIENT": 5, "MOST_ENTRIES": 10_000}
    rows = [(side**2, 0, [(1, side**2, 0)])]
    for x, y in np.ndindex(side, side):
        steps = [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]
        ahead = [u * side + v if {u, v} <= {*range(side)} else side**2 for u, v in steps]
        rows.append((x * side + y, 0, [(0.25, t, 1) for t in ahead]))
    with (
        solved_by(WAYS["last resort"] | limits),
        pytest.raises(SolverError, match=r"4,901 equations .* number the states") as caught,
    ):
        evaluate(MDP.from_outcomes(rows), [0] * (side**2 + 1))
    assert caught.value.status is Status.TOO_LARGE


@pytest.mark.parametrize("discount", [F(1), F(19, 20)])
@pytest.mark.parametrize("number", range(len(SAMPLE)))
def test_the_care_model_is_the_oracles(number: int, discount: F) -> None:
    """A policy's numbers and returns; the optimal values and actions of all states."""
    readings, policy = SAMPLE[number], POLICIES[number % 3]
    mdp, oracle = care(readings, [1, 1], discount)
    evaluation, wanted = evaluate(mdp, policy_of(mdp, policy)), oracle.evaluate(policy)
    numbers = evaluation.numbers
    for name in ("mean", "variance", "steps"):
        assert within(numbers[name], wanted[name]), name
    assert within(numbers["event.skip"], wanted["skip_probability"])
    assert evaluation.skip_probability == evaluation.event_probability["skip"]
    assert list(evaluation.components) == list(wanted["components"])
    for name, exact in wanted["components"].items():
        # The model's component of a pair is itself rounded once.
        assert within(numbers[f"component.{name}"], exact), name
    assert sum(evaluation.components.values()) == pytest.approx(evaluation.mean, abs=1e-10)
    assert evaluation.claim is Claim.BOUNDED
    assert evaluation.start.error < 1e-10
    best = certify(mdp)
    for place in range(mdp.n_states):
        state, pairs = state_of(mdp, place), mdp.pairs_of(place)
        assert best.value[place] == oracle.value(state)
        names = {mdp.actions[mdp.pair_action[pair]] for pair in pairs if best.optimal_pairs[pair]}
        assert len(pairs) == 1 or names == oracle.optimal_actions(state)
    if discount == 1:
        listed = return_distribution(mdp, policy_of(mdp, policy), exact=True)
        assert dict(zip(listed.values, listed.exact or (), strict=True)) == wanted["distribution"]
        law = return_distribution(mdp, policy_of(mdp, policy))
        assert law.values == listed.values
        near(law.probabilities, law.error, [wanted["distribution"][x] for x in law.values])
        assert (law.relative_error < 1e-12, law.remaining) == (True, 0)


def two_rewards() -> MDP:
    """To the same next state with 1/2 or with -1: the reward says what the state does not."""
    rows = [(0, 0, [("1/2", 1, "1/2"), ("1/2", 1, -1)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes(rows)


def test_a_large_mean_does_not_drown_a_small_spread() -> None:
    rows = [
        (0, 0, [(1, 1, 10**9)]),
        (1, 0, [("1/2", 2, "1/1000"), ("1/2", 2, "-1/1000")]),
        (2, 0, [(1, 2, 0)]),
    ]
    evaluation = evaluate(MDP.from_outcomes(rows), "random")
    assert evaluation.sd == pytest.approx(1e-3, rel=1e-3)


def test_parts_of_what_is_earned_for_ever_are_infinite_or_finite() -> None:
    """Each part is a total of its own: 1 - 1 + 1 - … is worth 1/2."""
    rows = [(0, 0, [(1, 1, 5)]), (1, 0, [(1, 2, -1)]), (2, 0, [(1, 1, 0)])]
    parts = {"once": [5, 0, 0], "turns": [0, 1, -1]}
    evaluation = evaluate(MDP.from_outcomes(rows, components=parts), [0, 0, 0])
    assert (evaluation.mean, evaluation.components["once"], evaluation.components["rest"]) == (
        -inf,
        5,
        -inf,
    )
    assert evaluation.components["turns"] == 0.5
    assert np.isnan(evaluation.variance).all()
    assert solve(evaluation.mdp).gap_table.tolist() == [[0.0], [0.0], [0.0]]


def test_quantiles_say_why_they_are_missing() -> None:
    evaluation = evaluate(two_rewards().with_(discount="9/10"), "random")
    assert evaluation.quantiles is None
    assert "9/10" in evaluation.quantiles_missing
    evaluation = evaluate(two_rewards(), "random")
    assert evaluation.quantiles == {0.05: -1.0, 0.25: -1.0, 0.5: -1.0, 0.75: 0.5, 0.95: 0.5}
    assert evaluation.quantiles_missing == ""


def test_the_variance_counts_the_error_of_the_value() -> None:
    """Values that are off by as much as their error says leave a true bound of the variance."""
    flip = [("1/2", 2, 0), ("1/2", 2, 2)]
    rows = [(0, 0, [("1/2", 1, 1), ("1/2", 2, 4)]), (1, 0, flip), (2, 0, [(1, 2, 0)])]
    for start in (0, {0: "1/2", 1: "1/2"}):
        mdp = MDP.from_outcomes(rows).with_(start=start)
        exact = evaluate(mdp, [0, 0, 0])
        for off in ([0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.25, -0.5, 0.0]):
            error = np.abs(off)
            near = replace(exact, value=exact.value + np.array(off), error=exact.error + error)
            for name in ("variance", "sd"):
                one, other = near.numbers[name], exact.numbers[name]
                assert one.error > 0
                assert abs(one.value - other.value) <= one.error + other.error
    sure = MDP.from_outcomes([(0, 0, [(1, 2, 0)]), (1, 0, [(1, 2, 100)]), (2, 0, [(1, 2, 0)])])
    apart = evaluate(sure.with_(start={0: "9/10", 1: "1/10"}), [0, 0, 0])
    off = np.array([0.0, 0.5, 0.0])
    near = replace(apart, value=apart.value + off, error=apart.error + off)
    assert abs(near.numbers["variance"].value - 900) <= near.numbers["variance"].error
