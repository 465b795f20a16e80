"""Mean, spread, components, steps, visits and events of a policy, against exact arithmetic."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from math import inf, isnan
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from answers import near, within
from care_oracle import READINGS
from cli_runner import run, strict
from hypothesis import given
from policy_cases import Case, care, careful, cases, directive, policy_of, state_of, uniform

from exact_mdp import (
    MDP,
    Claim,
    Evaluation,
    ModelError,
    SolverError,
    certify,
    evaluate,
    return_distribution,
    simulate,
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
        arrivals = [float(discounted[s]) for s in range(case.n_states)]  # an end is visited once
        np.testing.assert_allclose(evaluation.visits, arrivals, rtol=1e-7, atol=1e-9)
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


def test_what_goes_on_in_states_of_rest_is_counted() -> None:
    """They earn nothing in all: their components and events go on, as the discount tends to 1."""
    rows = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 2, 0)]), (1, 1, [(1, 3, 0)]), (2, 0, [(1, 1, 0)]),
            (3, 0, [(1, 3, 0)])]  # fmt: skip
    parts = {"life": [1, 3, 0, -1, 0], "turns": [0, 1, 0, -1, 0], "once": [5, 0, 0, 0, 0]}
    mdp = MDP.from_outcomes(rows, components=parts)
    event = np.array([0, 0, 0, 1, 2], dtype=np.uint8)
    seen = MDP.from_outcomes(rows, events=("back", "never"))
    seen = seen.with_(table=replace(seen.table, event=event), components=parts)
    for each in (mdp, seen):
        law = evaluate(each, [0, 0, 0, 0])
        assert law.mean == 1
        assert law.components == pytest.approx(
            {"life": inf, "turns": 0.5, "once": 5.0, "rest": -inf}
        )
    assert law.event_probability == {"back": 1.0, "never": 0.0}
    near_one = evaluate(mdp.with_(discount=1 - F(1, 10**9)), [0, 0, 0, 0]).components
    assert near_one["life"] > 10**8
    assert near_one["turns"] == pytest.approx(0.5, abs=1e-8)


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


# ---- numbers that are infinite, or beyond the floats ---------------------------------------------


@pytest.mark.parametrize(("earned", "asks"), [(0, False), (1, False), (-1, False), (0, True)])
def test_sampled_runs_that_never_end_have_no_number_of_steps(
    earned: int, asks: bool, tmp_path: Path
) -> None:
    """They rest, gain or lose for ever, or miss a goal: in `evaluate` and `simulate` alike."""
    rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 1)]), (1, 0, [("1/2", 1, earned), ("1/2", 3, 0)])]
    rows += [(2, 0, [(1, 2, 0)]), (3, 0, [(1, 1, earned)])]
    mdp = MDP.from_outcomes(rows, labels={"home": [False, False, True, False]})
    mdp.save(path := tmp_path / "m.npz")
    mdp = mdp.until("home") if asks else mdp
    sample = simulate(mdp, "random", 100, 0)
    assert 30 < sample.endless < 70
    assert sample.mean_steps == evaluate(mdp, "random").steps == inf
    words = ["simulate", path, "random", "--episodes", 20, *(["--until", "home"] * asks)]
    assert strict(run(*words, "--json").out)["steps"] == "inf"
    assert "inf: some never end" in run(*words).out
    short = simulate(mdp, "random", 100, 0, horizon=3)
    assert (short.endless, short.mean_steps) == (0, short.steps.mean())


@pytest.mark.parametrize("chance", [F(1, 10**20), F(1, 10**300), F(1, 10**400)])
def test_an_end_beyond_the_floats_leaves_the_rest(chance: F, tmp_path: Path) -> None:
    """The mean, the spread and the events stand, and so does a number of steps that is a float."""
    rows = [(0, 0, [(chance, 1, 1), (1 - chance, 0, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    evaluation = evaluate(mdp, [0, 0])
    assert evaluation.mean == pytest.approx(2)
    assert evaluation.ends
    assert evaluation.sd < 1e-5
    if 1 / chance < 10**308:
        assert evaluation.steps == float(1 / chance)
        return
    assert isnan(evaluation.steps)
    assert evaluation.numbers["steps"].error == inf
    mdp.save(path := tmp_path / "late.npz")
    result = run("evaluate", path, "random", "--json").result
    assert (result["steps"], result["error_bounds"]["steps"]) == (None, "inf")
    assert result["mean"] == pytest.approx(2)
    assert "cannot bound" in run("evaluate", path, "random").out


@pytest.mark.parametrize("size", [1.7e308, 1e200, 1e150, 1.0, 1e-150, 1e-200])
@pytest.mark.parametrize("discount", [0, "1/2", 1])
def test_spreads_are_right_where_their_squares_are_floats(size: float, discount: object) -> None:
    """A fair bet of ± size: its sd is the size, or unknown."""
    rows = [(0, 0, [(0.5, 1, size), (0.5, 1, -size)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, discount)
    evaluation = evaluate(mdp, [0, 0])
    for name, exact in (("sd", F(size)), ("variance", F(size) ** 2)):
        number = evaluation.numbers[name]
        assert isnan(number.value) == (size > 1e151) or within(number, exact)
    if not 1e-151 < size < 1e151:
        return
    assert evaluation.sd == pytest.approx(size, rel=1e-12)
    assert evaluation.variance[0] == pytest.approx(size * size)
    sample = simulate(mdp, [0, 0], 400, rng=3)
    assert sample.sd == pytest.approx(size, rel=0.02)
    assert abs(sample.mean) < 4 * sample.standard_error
    if discount == 1:
        listed = return_distribution(mdp, [0, 0])
        assert (listed.mean, listed.sd) == (0, pytest.approx(size))


def test_nothing_earned_is_exactly_nothing() -> None:
    """Without rewards the mean is 0 at any discount, however near to 1."""
    rows = [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 0, 0)])]
    evaluation = evaluate(MDP.from_outcomes(rows, F(10**16 - 1, 10**16)), [0, 0])
    assert (evaluation.mean, evaluation.start.error, evaluation.sd) == (0, 0, 0)
    assert evaluation.steps == inf


def test_returns_beyond_the_floats_are_infinite() -> None:
    """Two losses of 1e308 make one that no float holds; its quantile is -inf, the rest stands."""
    rows = [(0, 0, [(1, 1, -1e308)]), (1, 0, [(0.5, 2, -1e308), (0.5, 2, 1e308)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
    evaluation = evaluate(mdp, [0, 0, 0])
    assert evaluation.quantiles is not None
    assert (evaluation.quantiles[0.05], evaluation.quantiles[0.95]) == (-inf, 0)
    assert (evaluation.mean, isnan(evaluation.sd)) == (-1e308, True)


def test_spreads_between_starts_beyond_the_floats_are_unknown() -> None:
    rows = [(0, 0, [(1, 2, 1e308)]), (1, 0, [(1, 2, -1e308)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, start={0: "1/2", 1: "1/2"})
    assert isnan(evaluate(mdp, [0, 0, 0]).sd)


def test_a_large_model_without_cycles_is_its_recursion_in_any_order_of_states() -> None:
    """Values, visits and the error bound, of states whose numbers say nothing of their order."""
    drawn, states, choices = np.random.default_rng(1), 6_001, 6
    place = drawn.permutation(states)
    rows, value, visits = [], [F(0)] * states, [0.0] * states
    for s in range(states - 1):
        ahead = sorted({min(s + int(step), states - 1) for step in drawn.integers(1, 9, choices)})
        gain = int(drawn.integers(-9, 10))
        rows.append((s, [(F(1, len(ahead)), t, gain) for t in ahead]))
    for s, row in reversed(rows):
        value[s] = sum((p * (gain + F(19, 20) * value[t]) for p, t, gain in row), F(0))
        value[s] = value[s].limit_denominator(10**30)
    visits[0] = 1.0
    for s, row in rows:
        for p, t, _ in row:
            visits[t] += float(p) * visits[s]
    listed = [(place[s], 0, [(p, place[t], gain) for p, t, gain in row]) for s, row in rows]
    mdp = MDP.from_outcomes(
        [*listed, (place[-1], 0, [(1, place[-1], 0)])], "19/20", start=int(place[0])
    )
    assert mdp.n_transitions > 20_000
    found = evaluate(mdp, "random")
    mean = found.numbers["mean"]
    assert abs(F(mean.value) - value[0]) <= F(mean.error) < F(1, 10**9)
    assert found.visits[place[:-1]] == pytest.approx(visits[:-1])
