"""What is infinite is said to be, the rest is given, and no warning of NumPy gets out."""

from fractions import Fraction as F
from math import inf, isnan
from pathlib import Path

import pytest
from answers import within
from cli_runner import run, strict

from exact_mdp import MDP, evaluate, return_distribution, simulate


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


@pytest.mark.parametrize("size", [1.7e308, 1e308, 1e200, 1.0, 1e-200, 1e-308])
@pytest.mark.parametrize("discount", [0, "1/2", 1])
def test_spreads_are_right_at_any_scale(size: float, discount: object) -> None:
    """A fair bet of ± size: its sd is the size, whether or not the variance is a float."""
    rows = [(0, 0, [(0.5, 1, size), (0.5, 1, -size)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, discount)
    evaluation = evaluate(mdp, [0, 0])
    assert evaluation.sd == pytest.approx(size, rel=1e-12)
    assert within(evaluation.numbers["sd"], F(size))
    variance = evaluation.numbers["variance"].value
    assert variance == (inf if size > 1e160 else pytest.approx(size * size))
    assert evaluation.variance[0] == variance
    sample = simulate(mdp, [0, 0], 400, rng=3)
    assert sample.sd == pytest.approx(size, rel=0.02)
    assert abs(sample.mean) < 4 * sample.standard_error
    if discount == 1:
        listed = return_distribution(mdp, [0, 0])
        assert (listed.mean, listed.sd) == (0, pytest.approx(size))


def test_spreads_between_starts_are_right_at_any_scale() -> None:
    rows = [(0, 0, [(1, 2, 1e308)]), (1, 0, [(1, 2, -1e308)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, start={0: "1/2", 1: "1/2"})
    assert evaluate(mdp, [0, 0, 0]).sd == pytest.approx(1e308)


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
    assert (evaluation.mean, evaluation.sd) == (-1e308, pytest.approx(1e308))
    assert return_distribution(mdp, [0, 0, 0]).sd == pytest.approx(1e308)
