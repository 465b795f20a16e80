"""Distributions by their moments and their draws, against those of scipy; and what is drawn."""

import math
import os
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
import pytest
from model_contents import negated
from numpy.random import SeedSequence
from refusal_tables import refused
from scipy import stats
from scipy_laws import SCIPY_LAWS

from exact_mdp import MDP, Family, ModelError, Parameter, moving, parametric, psa
from exact_mdp.analysis.vary import distributions
from exact_mdp.analysis.vary.distributions import (
    KINDS,
    SETTINGS,
    WITHIN,
    Uncertain,
    Uncertainty,
    drawn_family,
    row_family,
    uncertainty,
)
from exact_mdp.analysis.vary.psa import sample_parameters

OWN: dict[str, list[tuple[float, ...]]] = {
    "beta": [(2.0, 5.0), (0.5, 0.25), (84.0, 716.0)],
    "gamma": [(2.0, 3.0), (0.5, 45.0), (0.25, 0.5)],
    "lognormal": [(1.1, 0.2), (-2.0, 1.5)],
    "normal": [(-5.0, 2.0), (0.0, 0.5)],
    "uniform": [(-1.0, 3.0), (0.25, 0.5)],
    "triangular": [(0.0, 1.0, 5.0), (-3.0, -3.0, 4.0), (-3.0, 4.0, 4.0)],
}
EACH = [(kind, numbers) for kind, every in OWN.items() for numbers in every]


# ---- one parameter -------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "numbers"), EACH)
def test_numbers_have_the_moments_of_another_library_and_draw_its_law(
    kind: str, numbers: tuple[float, ...]
) -> None:
    said = dict(zip(KINDS[kind].own, numbers, strict=True))
    part, law = Uncertain.of("p", kind, **said), SCIPY_LAWS[kind](*numbers)
    assert part.numbers == numbers
    assert (part.mean[0], part.sd[0]) == pytest.approx((law.mean(), law.std()))
    drawn = part.draw(SeedSequence(1), 4000)
    assert drawn.shape == (4000, 1)
    assert stats.kstest(drawn[:, 0], law.cdf).pvalue > 1e-3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("mean", "sd"), [(0.25, 0.125), (0.5, 0.25), (0.875, 0.2)])
def test_a_mean_and_a_spread_make_a_law_that_has_them(kind: str, mean: float, sd: float) -> None:
    for said in ({"sd": sd}, {"relative_sd": sd / mean}):
        part = Uncertain.of("p", kind, mean=mean, **said)
        law = SCIPY_LAWS[kind](*part.numbers)
        assert (law.mean(), law.std()) == pytest.approx((mean, sd))
        assert (part.names, part.label, part.kind) == (("p",), "p", kind)
        assert (part.mean[0], part.sd[0]) == (mean, pytest.approx(sd))


@pytest.mark.parametrize("kind", ["gamma", "normal", "uniform", "triangular"])
def test_a_negative_mean_keeps_its_sign(kind: str) -> None:
    part = Uncertain.of("p", kind, mean=-4, relative_sd=0.25)
    assert (part.mean, part.sd, part.size) == ((-4,), (1,), 0.25)
    drawn = part.draw(SeedSequence(0), 4000)
    assert (drawn.mean(), drawn.std()) == pytest.approx((-4, 1), abs=0.05)
    mirrored = Uncertain.of("p", kind, mean=4, relative_sd=0.25).draw(SeedSequence(0), 4000)
    if kind == "gamma":
        assert np.array_equal(drawn, -mirrored)


def test_moments_are_given_back_as_they_were_said() -> None:
    part = Uncertain.of("p", "lognormal", mean=0.1, sd=0.03)
    assert (part.mean, part.sd) == ((0.1,), (0.03,))
    part = Uncertain.of("p", "lognormal", mean=0.7, relative_sd=0.3)
    assert (part.mean, part.sd) == ((0.7,), (0.7 * 0.3,))


@pytest.mark.parametrize("size", [1e-6, 0.5, 19.0, 1e15])
def test_a_beta_of_n_observations_has_variance_of_n_plus_1(size: float) -> None:
    part = Uncertain.of("p", "beta", mean=0.25, effective_sample_size=size)
    assert part.numbers == pytest.approx((0.25 * size, 0.75 * size))
    assert part.size == pytest.approx(size)
    assert part.sd[0] ** 2 == pytest.approx(0.25 * 0.75 / (size + 1))


def test_the_size_of_others_is_their_relative_spread() -> None:
    assert Uncertain.of("p", "normal", mean=-8, sd=2).size == 0.25
    assert Uncertain.of("p", "uniform", low=-1, high=1).size is None
    assert Uncertain.of("p", "normal", mean=0, sd=2).numbers == (0, 2)


IMPOSSIBLE: list[tuple[str, dict[str, float]]] = [
    ("beta", {"alpha": 0, "beta": 1}),
    ("beta", {"alpha": 1, "beta": 0}),
    ("beta", {"mean": 0, "sd": 0.1}),
    ("beta", {"mean": 0.5, "sd": 0.5}),
    ("gamma", {"shape": 0, "scale": 1}),
    ("gamma", {"shape": 1, "scale": 0}),
    ("gamma", {"mean": 0, "sd": 1}),
    ("lognormal", {"meanlog": 1, "sdlog": 0}),
    ("lognormal", {"mean": 0, "sd": 1}),
    ("lognormal", {"mean": -1, "sd": 1}),
    ("normal", {"mean": 1, "sd": 0}),
    ("normal", {"mean": 1, "sd": -1}),
    ("normal", {"mean": 1}),
    ("normal", {"sd": 1}),
    ("normal", {"mean": 1, "sd": 1, "relative_sd": 1}),
    ("normal", {"mean": 1, "effective_sample_size": 9}),
    ("normal", {"mean": 1, "sd": 1, "low": 0}),
    ("normal", {"mean": 0, "relative_sd": 1}),
    ("normal", {"mean": math.inf, "sd": 1}),
    ("normal", {"mean": math.nan, "relative_sd": 1}),
    ("uniform", {"low": 1, "high": 1}),
    ("uniform", {"low": -math.inf, "high": 1}),
    ("triangular", {"low": 1, "mode": 1, "high": 1}),
    ("triangular", {"low": 1, "mode": 0, "high": 2}),
    ("triangular", {"low": 1, "mode": 3, "high": 2}),
    ("uniform", {}),
    ("beta", {"alpha": 1, "beta": 1, "mean": 0.5}),
    ("beta", {"alpha": 1}),
]


@pytest.mark.parametrize(("kind", "said"), IMPOSSIBLE)
def test_what_is_no_distribution_is_refused(kind: str, said: dict[str, float]) -> None:
    with pytest.raises(ModelError, match="distribution of p"):
        Uncertain.of("p", kind, **said)


def test_spreads_of_which_floats_can_draw_are_taken_and_no_others() -> None:
    """A range in units of the mean; ends included."""
    assert WITHIN["effective_sample_size"][1:] == (1e-6, 1e15)
    assert WITHIN["relative_sd"][1:] == WITHIN["sd"][1:] == (1e-9, 1e3)
    for mean in (-4.0, 0.0, 0.5):
        unit = abs(mean) or 1.0
        for spread, unit_of in (("sd", unit), ("relative_sd", 1.0)):
            if spread == "relative_sd" and not mean:
                continue
            for number in (1e-9 * unit_of, 1e3 * unit_of):
                sd = number if spread == "sd" else number * unit
                part = Uncertain.of("p", "normal", mean=mean, **{spread: number})
                assert part.numbers == pytest.approx((mean, sd))
            for number in (0.99e-9 * unit_of, 1001 * unit_of):
                with pytest.raises(ModelError, match="standard deviation"):
                    Uncertain.of("p", "normal", mean=mean, **{spread: number})
    for number in (0.9e-6, 1.1e15):
        with pytest.raises(ModelError, match="effective sample size"):
            Uncertain.of("p", "beta", mean=0.5, effective_sample_size=number)


# ---- rows ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("counts", [(2.4, 6.0, 3.6), (0.5, 1.5), (1.0, 2.0, 3.0, 4.0)])
def test_a_row_has_the_moments_and_the_law_of_a_dirichlet(counts: tuple[float, ...]) -> None:
    names = [f"p{k}" for k in range(len(counts) - 1)]
    part, law = Uncertain.of_row("row", names, counts), stats.dirichlet(counts)
    assert (part.kind, part.label, part.names) == ("dirichlet", "row", tuple(names))
    assert part.mean == pytest.approx(law.mean()[:-1])
    assert part.sd == pytest.approx(law.var()[:-1] ** 0.5)
    assert (part.numbers, part.size) == (counts, pytest.approx(sum(counts)))
    drawn = part.draw(SeedSequence(2), 4000)
    assert drawn.shape == (4000, len(names))
    for column, count in zip(drawn.T, counts, strict=False):
        assert stats.kstest(column, stats.beta(count, sum(counts) - count).cdf).pvalue > 1e-3
    rest = stats.beta(counts[-1], sum(counts[:-1]))
    assert stats.kstest(1 - drawn.sum(axis=1), rest.cdf).pvalue > 1e-3


COVARIANCE = [[0.25, -0.1, 0.0], [-0.1, 0.09, 0.02], [0.0, 0.02, 0.04]]


@pytest.mark.parametrize("kind", ["normal", "lognormal"])
def test_jointly_normal_parameters_have_their_moments_and_every_sum_its_law(kind: str) -> None:
    """Var of a sample covariance is (Σii Σjj + Σij²) / (n - 1), and of a sample mean Σii / n."""
    names, mean, square, n = ["a", "b", "c"], [1.0, -2.0, 0.5], np.array(COVARIANCE), 20_000
    part = Uncertain.of_joint("all", names, kind, mean, COVARIANCE)
    assert (part.names, part.label, part.kind, part.size) == (("a", "b", "c"), "all", kind, None)
    drawn = part.draw(SeedSequence(5), n)
    assert drawn.shape == (n, 3)
    if kind == "lognormal":
        for place in range(3):
            law = stats.lognorm(s=square[place, place] ** 0.5, scale=np.exp(mean[place]))
            assert part.mean[place] == pytest.approx(law.mean())
            assert part.sd[place] == pytest.approx(law.std())
        drawn = np.log(drawn)
    else:
        assert part.mean == tuple(mean)
        assert part.sd == pytest.approx(square.diagonal() ** 0.5)
    variance = square.diagonal()
    assert (np.abs(drawn.mean(axis=0) - mean) < 5 * (variance / n) ** 0.5).all()
    spread = ((np.outer(variance, variance) + square**2) / (n - 1)) ** 0.5
    assert (np.abs(np.cov(drawn.T) - square) < 5 * spread).all()
    for weights in ([1, 1, 1], [1, -2, 3], [0, 1, 0]):
        law = stats.norm(np.dot(weights, mean), (weights @ square @ weights) ** 0.5)
        assert stats.kstest(drawn @ weights, law.cdf).pvalue > 1e-3


def test_jointly_normal_draws_are_a_factor_of_the_covariance_times_a_stream() -> None:
    part = Uncertain.of_joint("all", ["a", "b", "c"], "normal", [1, -2, 0.5], COVARIANCE)
    rng = np.random.default_rng(SeedSequence(7, spawn_key=(crc32(b"a b c"),)))
    wanted = [1, -2, 0.5] + rng.standard_normal((9, 3)) @ np.linalg.cholesky(COVARIANCE).T
    assert part.draw(SeedSequence(7), 9) == pytest.approx(wanted, rel=1e-12)
    two = Uncertain.of_joint("fit", ["a", "b"], "normal", [1, 2], [[4, 1], [1, 9]])
    assert two.size is None


@pytest.mark.parametrize(
    ("kind", "mean", "covariance", "what", "fix"),
    [
        ("normal", [1, 2, 3], [[1, 0, 0.5], [0, 1, 0], [0.25, 0, 1]], "two covariances of a and c",
         "give a symmetric covariance"),
        ("normal", [1, 2, 3], [[1, 0, 0], [0, math.nan, 0], [0, 0, 1]], "not a variance",
         "give a symmetric covariance"),
        ("normal", [1, 2], [[1, 0], [0, 1]],
         "means of shape (2,), and a covariance of shape (2, 2)",
         "give 3 means, and 3 rows of 3 numbers"),
        ("normal", [1, 2, 3], [[1, 2, 0], [2, 1, 0], [0, 0, 1]],
         "the covariance is not positive definite",
         "correct it; if one parameter follows from the others, leave it out, and let the function "
         "that builds the model compute it"),
        ("lognormal", [1e3, 2, 3], np.eye(3), "a mean or sd is infinite", "give smaller numbers"),
        ("lognormal", [-750, 2, 3], np.diag([1500, 1, 1]), "a mean or sd is infinite",
         "give smaller numbers"),  # a mean of 1
    ],
)  # fmt: skip
def test_a_covariance_is_that_of_a_law(
    kind: str, mean: Any, covariance: Any, what: str, fix: str
) -> None:
    call = partial(Uncertain.of_joint, "all", ["a", "b", "c"], kind, mean, covariance)
    refused(call, f"={what}", "=distribution of all", f"={fix}")


def test_several_parameters_are_stated_by_name_and_covariance(tmp_path: Path) -> None:
    several = Family(
        parameters={"x": 3, "y": 5},
        build=lambda at: MDP.from_arrays([[[1]]], [at["x"] + at["y"]], 0),
    )
    path = tmp_path / "fit.toml"
    path.write_text('fit = {names = ["x", "y"], covariance = [[4, 1], [1, 9]]}\n')
    settings = {"names": ("x", "y"), "covariance": np.array([[4, 1], ["1", 9]], dtype=object)}
    for stated in ({"fit": settings}, path):
        (part,) = uncertainty(several, stated, names=["fit"]).parts
        assert (part.mean, part.sd, part.kind) == ((3.0, 5.0), (2.0, 3.0), "normal")
    moved = uncertainty(several, {"fit": settings | {"mean": [0, "1/2"]}}).parts[0]
    assert moved.mean == (0.0, 0.5)
    logs = settings | {"distribution": "lognormal", "meanlog": [0, 1]}
    assert uncertainty(several, {"fit": logs}).parts[0].numbers == (0, 1, 4, 1, 1, 9)
    # The sum, which the model earns, has the variance 4 + 2 + 9.
    table = psa(several, 40, uncertain={"fit": settings}, rng=3).table
    assert table.optimal == pytest.approx(table.points.sum(axis=1))
    sums = uncertainty(several, {"fit": settings}).draw(SeedSequence(3), 4000).sum(axis=1)
    assert abs(sums.var(ddof=1) - 15) < 5 * 15 * (2 / 3999) ** 0.5
    limited = replace(
        several, parameters=(Parameter(name="x", value=3, low=0), several.parameters[1])
    )
    with pytest.raises(ModelError, match=r"x is -.* outside \[0, inf\]"):
        psa(limited, 400, uncertain={"fit": settings})


def test_drawn_rows_never_sum_to_more_than_one() -> None:
    """Where all of the mass is on one outcome, what rounding adds is taken away, and no more."""
    for outcomes in (2, 3, 9, 40):
        counts = [1e-3 / outcomes] * outcomes
        names = [f"p{k}" for k in range(outcomes - 1)]
        drawn = Uncertain.of_row("row", names, counts).draw(SeedSequence(0), 300)
        sums = [sum(map(Fraction, row)) for row in drawn.tolist()]
        assert 1 - 5 * len(names) * Fraction(1, 2**52) < max(sums) <= 1
        rng = np.random.default_rng(SeedSequence(0, spawn_key=(crc32(" ".join(names).encode()),)))
        plain = rng.dirichlet(counts, size=300)[:, :-1]
        below = plain.sum(axis=1) < 1 - 1e-12
        assert np.array_equal(drawn[below], plain[below])
        assert np.allclose(drawn, plain, rtol=5 * len(names) * 2.0**-52, atol=0)


@pytest.mark.parametrize(
    "counts", [(1.0, 2.0), (1.0, 2.0, 3.0, 4.0), (0.0, 1.0, 2.0), (-1.0, 3.0, 2.0), (1e15, 1, 1)]
)
def test_a_row_needs_a_count_above_zero_for_each_outcome(counts: tuple[float, ...]) -> None:
    with pytest.raises(ModelError, match="distribution of row"):
        Uncertain.of_row("row", ["p", "q"], counts)


def test_counts_of_a_row_may_be_as_few_and_as_many_as_those_of_a_beta() -> None:
    for size in (1e-6, 2.0**49, 1e15):
        assert Uncertain.of_row("row", ["p"], (size / 2, size / 2)).size == size
    for size in (0.9e-6, 1.1e15):
        with pytest.raises(ModelError, match="concentrations"):
            Uncertain.of_row("row", ["p"], (size / 2, size / 2))


# ---- streams -------------------------------------------------------------------------------------


def test_each_part_has_the_stream_of_its_name_and_of_the_seed() -> None:
    part = Uncertain.of("p", "uniform", low=0, high=1)
    own = np.random.default_rng(SeedSequence(5, spawn_key=(crc32(b"p"),)))
    assert np.array_equal(part.draw(SeedSequence(5), 9)[:, 0], own.uniform(size=9))
    child = np.random.default_rng(SeedSequence(5, spawn_key=(1, crc32(b"p"))))
    assert np.array_equal(part.draw(SeedSequence(5).spawn(2)[1], 9)[:, 0], child.uniform(size=9))
    other = replace(part, names=("q",))
    assert not np.array_equal(other.draw(SeedSequence(5), 9), part.draw(SeedSequence(5), 9))


def test_a_larger_sample_begins_with_the_smaller_and_columns_follow_the_parts() -> None:
    one, row = (
        Uncertain.of("p", "beta", alpha=1, beta=2),
        Uncertain.of_row("r", ["a", "b"], [1, 2, 3]),
    )
    both = Uncertainty(parts=(row, one), fixed={})
    assert both.names == ("a", "b", "p")
    small, large = both.draw(SeedSequence(0), 5), both.draw(SeedSequence(0), 8)
    assert np.array_equal(small, large[:5])
    assert np.array_equal(small, np.hstack([row.draw(SeedSequence(0), 5),
                                            one.draw(SeedSequence(0), 5)]))  # fmt: skip
    assert Uncertainty(parts=(), fixed={}).draw(SeedSequence(0), 5).shape == (5, 0)
    with pytest.raises(ModelError, match="p"):
        Uncertainty(parts=(one, one), fixed={})


# ---- what a model draws --------------------------------------------------------------------------


def parameter(name: str, value: object, low: object = None, high: object = None) -> Parameter:
    return Parameter(name=name, value=value, low=low, high=high)


ONE = MDP.from_arrays([[[1]]], [0], 0)
MODEL = Family(
    parameters=(
        parameter("cost.drug", "4000", 0),
        parameter("cost.care", "100", 0),
        parameter("p", "3/20", 0, 1),
        parameter("weight", -2),
        parameter("debt", 5, -9, 9),
        parameter("never", 0, 0, 1),
        parameter("always", 1, 0, 1),
        parameter("free", 0, 0),
        parameter("discount", "9/10", 0, 1),
    ),
    build=lambda at: ONE,
)
SIZE = "effective_sample_size"


def drawn(stated: Any = None, **how: Any) -> dict[str, Uncertain]:
    return {part.label: part for part in uncertainty(MODEL, stated, **how).parts}


def test_only_probabilities_between_0_and_1_are_drawn_unless_more_is_stated() -> None:
    found = uncertainty(MODEL)
    (part,) = found.parts
    assert (part.names, part.kind) == (("p",), "beta")
    assert part.numbers == pytest.approx((15, 85))
    assert found.assumed == ("p",)
    assert found.assumption == "1 of 1 distributions are not stated, and rest on 100 " \
        "observations each"  # fmt: skip
    assert found.fixed == {
        "cost.drug": "numbers are held unless stated otherwise",
        "cost.care": "numbers are held unless stated otherwise",
        "weight": "numbers are held unless stated otherwise",
        "debt": "numbers are held unless stated otherwise",
        "never": "0 today",
        "always": "1 today",
        "free": "numbers are held unless stated otherwise",
        "discount": "the discount is held unless stated otherwise",
    }
    assert drawn(default=20)["p"].numbers == pytest.approx((3, 17))
    assert uncertainty(MODEL, default=20).default == 20
    assert found.default == 100
    assert uncertainty(MODEL, found) is found


def test_what_a_parameter_may_be_decides_its_distribution() -> None:
    stated = {name.name: {"sd": 0.25} for name in MODEL.parameters if name.name[:4] != "cost"}
    kinds = {label: part.kind for label, part in drawn(
        stated | {"cost": {"relative_sd": "1/10"}}, names=[
            "cost.drug", "cost.care", "p", "weight", "debt"]
    ).items()}  # fmt: skip
    assert kinds == {
        "cost.drug": "gamma", "cost.care": "gamma", "p": "beta", "weight": "normal",
        "debt": "normal",
    }  # fmt: skip
    care = drawn({"cost": {"relative_sd": "1/10"}})["cost.care"]
    assert (care.mean, care.sd) == ((100,), (10,))
    only_high = Family(parameters=(parameter("x", 1, 0, 2), parameter("y", -1, None, 1)),
                       build=lambda at: ONE)  # fmt: skip
    found = uncertainty(only_high, {"x": {"sd": 0.1}, "y": {"sd": 0.1}})
    assert [part.kind for part in found.parts] == ["gamma", "normal"]


def test_todays_value_is_the_mean_unless_another_is_stated() -> None:
    part = drawn({"p": {"mean": 0.4, SIZE: 10}})["p"]
    assert part.numbers == pytest.approx((4, 6))
    part = drawn({"p": {SIZE: 10}})["p"]
    assert part.numbers == pytest.approx((1.5, 8.5))
    part = drawn({"p": {"distribution": "lognormal", "mean": 0.1, "sd": 0.01}})["p"]
    assert (part.kind, part.mean, part.sd) == ("lognormal", (0.1,), (0.01,))
    part = drawn({"p": {"alpha": 2, "beta": 3}})["p"]
    assert part.numbers == (2, 3)
    assert drawn({"p": {"distribution": "beta"}})["p"].numbers == pytest.approx((15, 85))
    found = uncertainty(MODEL, {"p": {"distribution": "beta"}})
    assert found.assumed == ("p",)
    assert uncertainty(MODEL, {"p": {SIZE: 9}}).assumed == ()
    assert uncertainty(MODEL, {"p": {SIZE: 9}}).assumption == ""


def test_a_number_that_is_0_today_has_no_relative_spread() -> None:
    found = uncertainty(
        MODEL, {"never": {SIZE: 5}, "free": {"relative_sd": 0.5}, "always": {"relative_sd": 0.1}}
    )
    assert (found.fixed["never"], found.fixed["free"]) == ("0 today", "0 today")
    assert found.fixed["always"] == "1 today"
    assert drawn({"debt": {"mean": 0, "sd": 2}})["debt"].numbers == (0, 2)
    for stated in ({"never": {"sd": 0.1}}, {"always": {"sd": 0.1}}, {"free": {"sd": 1}}):
        with pytest.raises(ModelError, match="distribution of"):
            uncertainty(MODEL, stated)
    with pytest.raises(ModelError, match="effective sample size"):
        uncertainty(MODEL, {"never": {SIZE: 0}})
    one = Family(parameters=(parameter("x", 1, 0),), build=lambda at: ONE)
    (part,) = uncertainty(one, {"x": {"relative_sd": 0.5}}).parts
    assert (part.kind, part.sd) == ("gamma", (0.5,))


def test_a_uniform_or_a_triangle_stays_within_what_the_parameter_may_be() -> None:
    for low, high in ((0, 1), (0.25, 0.5)):
        said = {"distribution": "uniform", "low": low, "high": high}
        assert drawn({"p": said})["p"].numbers == (low, high)
    inside = {"distribution": "triangular", "low": -9, "mode": 0, "high": 9}
    assert drawn({"debt": inside})["debt"].numbers == (-9, 0, 9)
    outside: list[tuple[str, dict[str, object]]] = [
        ("p", {"distribution": "uniform", "low": -0.5, "high": 0.5}),
        ("p", {"distribution": "uniform", "low": 0.5, "high": 1.25}),
        ("debt", {"distribution": "triangular", "low": -10, "mode": 0, "high": 9}),
        ("debt", {"distribution": "triangular", "low": -9, "mode": 0, "high": 10}),
        ("cost.drug", {"distribution": "uniform", "low": -1, "high": 10}),
    ]
    for name, said in outside:
        with pytest.raises(ModelError, match="outside the parameter's limits"):
            uncertainty(MODEL, {name: said})
    free = {"weight": {"distribution": "uniform", "low": -100, "high": 100}}
    assert drawn(free)["weight"].numbers == (-100, 100)
    assert drawn({"cost.drug": {"distribution": "uniform", "low": 0, "high": 1e9}})
    assert drawn({"p": {"distribution": "normal", "mean": 0.5, "sd": 0.5}})  # is drawn; may leave


def test_the_longest_beginning_of_a_name_counts() -> None:
    for order in (1, -1):
        stated = dict([("cost", {"sd": 1}), ("cost.drug", {"sd": 2})][::order])
        sds = {label: part.sd for label, part in drawn(stated).items() if label != "p"}
        assert sds == {"cost.drug": (2,), "cost.care": (1,)}
    found = uncertainty(MODEL, {"cost": {"sd": 1}, "cost.care": {"fixed": True}})
    assert found.fixed["cost.care"] == "stated to be fixed"
    assert "cost.drug" in found.names
    for unknown in ("cos", "cost.drug.more", "pp"):
        with pytest.raises(ModelError, match="parameter"):
            uncertainty(MODEL, {unknown: {"sd": 1}})


def test_a_file_states_distributions_and_the_size_of_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "uncertain.toml"
    file.write_text(f"[default]\n{SIZE} = 40\n[cost]\nsd = 3\n[cost.care]\nfixed = true\n")
    found = uncertainty(MODEL, file)
    assert found.default == 40
    assert {part.label: part.numbers[-1] for part in found.parts} == {
        "cost.drug": pytest.approx(9 / 4000), "p": pytest.approx(0.85 * 40),
    }  # fmt: skip
    assert uncertainty(MODEL, str(file), default=9).default == 9
    assert uncertainty(MODEL, file, names=["p"]).names == ("p",)
    for text in ("sd = 3", f"[default]\n{SIZE} = 40\nsd = 3", "", "[p]\nsd = 'x'", "[[p]]"):
        file.write_text(text)
        with pytest.raises(ModelError, match=r"uncertain\.toml"):
            uncertainty(MODEL, file)
    size = f"{SIZE} = 50"
    cases = [
        ("p = 0.25", "=p = 0.25", f"={file}",
         f'=psa takes distributions: write "p" = {{{size}}}'),
        ("", "=nothing is stated in the file", f"={file}", f'=write "NAME" = {{{size}}}'),
        (f"[default]\n{SIZE} = 40\nsd = 3", f"=[default] states more than {SIZE}",
         f"={file}, default", "=state the rest for each parameter"),
        (f"[default]\n{SIZE} = 'x'", "='x' is not a finite rational number",
         f"=parameter default, {SIZE}", OF_NUMBER),
    ]  # fmt: skip
    for text, *said in cases:
        file.write_text(text)
        refused(partial(uncertainty, MODEL, file), *said)
    os.truncate(file, 2**24 + 1)
    refused(partial(uncertainty, MODEL, file), "more than the 16,777,216 bytes", f"={file}")
    fix = "=in Python give a sample as a pandas.DataFrame: a column for each parameter, a row for "
    fix += "each draw"
    what = "=a table is not a file of distributions, which ends in .toml"
    draws = tmp_path / "draws.CSV"
    refused(lambda: uncertainty(MODEL, draws), what, f"={draws}", fix)


def test_a_sample_of_ones_own_has_its_moments() -> None:
    frame = pd.DataFrame({"cost.drug": [1.0, 2.0, 6.0], "p": [0.1, 0.2, 0.3]})
    found = uncertainty(MODEL, frame)
    assert found.names == ("cost.drug", "p")
    assert [(part.kind, part.label) for part in found.parts] == [
        ("sample", "cost.drug"), ("sample", "p")
    ]  # fmt: skip
    assert [part.mean[0] for part in found.parts] == pytest.approx([3, 0.2])
    assert [part.sd[0] for part in found.parts] == pytest.approx([7**0.5, 0.1])
    assert found.sample is not None
    assert found.sample.tolist() == frame.to_numpy().tolist()
    assert {*found.fixed} == {p.name for p in MODEL.parameters} - {"cost.drug", "p"}
    assert {*found.fixed.values()} == {"not in the sample"}
    (one,) = uncertainty(MODEL, frame[["p"]][:1]).parts
    assert (one.mean, one.sd) == ((0.1,), (0,))
    (two,) = uncertainty(MODEL, frame[["p"]][:2]).parts
    assert (two.mean[0], two.sd[0]) == pytest.approx((0.15, 0.005**0.5))
    with pytest.raises(ModelError, match="uncertain"):
        uncertainty(MODEL, [1, 2])


BOTH = {"names": ["weight", "debt"], "covariance": [[1, 0], [0, 1]]}
OF_NUMBER = '=write 0.1 or "1/10"'
ALONE = '=write names = ["a", "b"] and covariance = [[…, …], […, …]]'
REFUSED: list[tuple[str, object, str, str, str]] = [
    ("p", 3, "=3 is stated", "=parameter p",
     '=state a distribution: {"distribution": "beta", "mean": 0.1, "sd": 0.02}; or give a sample '
     "as a pandas.DataFrame: a column for each parameter, a row for each draw"),
    ("p", {"se": 1}, "=a beta with mean = 0.15, sd = 1", "=distribution of p", "an sd that is"),
    ("p", {"sdd": 1}, "=unknown setting 'sdd'", "=parameter p", "=did you mean sd?"),
    ("p", {"xyz": 1}, "=unknown setting 'xyz'", "=parameter p",
     f"=choose one of {', '.join(SETTINGS)}"),
    ("p", {"sem": 1}, "=unknown setting 'sem'", "=parameter p",
     "=state sd, or se: the standard error of an estimate"),
    ("p", {"fixed": 1}, "=fixed is 1", "=parameter p", "=write fixed = true, or leave it out"),
    ("p", {"fixed": True, "sd": 1}, "=fixed, and a distribution", "=parameter p",
     "=state one of the two"),
    ("p", {"distribution": "exponential"}, "=unknown distribution 'exponential'", "=parameter p",
     '=state a "gamma" of shape 1'),
    ("p", {"distribution": "bet"}, "=unknown distribution 'bet'", "=parameter p",
     "=did you mean beta?"),
    ("p", {"distribution": 3}, "=unknown distribution 3", "=parameter p", "choose one of beta"),
    ("p", {"sd": "x"}, "='x' is not a finite rational number", "=parameter p, sd", OF_NUMBER),
    ("p", {"sd": math.inf}, "=standard deviation inf", "=distribution of p",
     "=choose a number above 0, from 1.5e-10 to 150"),
    ("p", {"alpha": [1, 2]}, "=[1, 2] is not a number", "=parameter p, alpha", "write a number"),
    ("p", {"sd": 1, "relative_sd": 1}, "=a beta with mean, sd, relative_sd", "=distribution of p",
     "=state a mean and one of sd, relative_sd, effective_sample_size; or alpha, beta alone"),
    ("weight", {"mean": 0, "relative_sd": 1}, "=a relative spread around 0",
     "=distribution of weight", "=state a finite mean, and around 0 an sd"),
    ("weight", {"mean": math.inf, "sd": 1}, "=a spread around inf", "=distribution of weight",
     "=state a finite mean, and around 0 an sd"),
    ("weight", {"mean": 0}, "=a normal with mean", "=distribution of weight",
     "=state a mean and one of sd, relative_sd"),
    ("fit", {"names": ["p", "debt"]}, "=names alone", "=parameter fit", ALONE),
    ("fit", {"covariance": [[1]]}, "=covariance alone", "=parameter fit", ALONE),
    ("p", BOTH, "=a row or a parameter has this name", "=distribution of p",
     "=name the several differently"),
    ("fit", BOTH | {"distribution": "gamma"}, "=unknown joint distribution 'gamma'",
     "=distribution of fit", "=choose one of normal, lognormal"),
    ("fit", BOTH | {"distribution": "lognormal"}, "=a lognormal covariance without means",
     "=distribution of fit", "=state meanlog, the means of the logarithms"),
    ("fit", BOTH | {"sd": 1}, "=sd beside a covariance", "=distribution of fit",
     "=state names, covariance, and perhaps mean, a list"),
    ("fit", {"names": ["weight"], "covariance": [[1]]}, "=too few names", "=distribution of fit",
     "=name two or more; one has an sd, without covariance"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "settings", "what", "where", "fix"), REFUSED)
def test_unknown_settings_are_refused(
    name: str, settings: Any, what: str, where: str, fix: str
) -> None:
    refused(lambda: uncertainty(MODEL, {name: settings}), what, where, fix)
    assert {"mean", "sd", "low", "high", "mode", "shape", "alpha", "fixed"} <= {*SETTINGS}


def test_unknown_distributions_and_names_used_twice_are_refused_with_their_place() -> None:
    said = "=unknown distribution 'bet'", "=distribution of p", "=did you mean beta?"
    refused(lambda: Uncertain.of("p", "bet", mean=1, sd=1), *said)
    refused(lambda: Uncertain.of_interval("p", "bet", 1, 2), *said)
    part = Uncertain.of("p", "uniform", low=0, high=1)
    refused(lambda: Uncertainty(parts=(part, part), fixed={}),
            "=two drawn parameters have the same name, 'p'", "=uncertainty")  # fmt: skip
    refused(lambda: uncertainty(MODEL, default=0), "=effective sample size 0.0", "=default")


def test_not_to_be_fixed_is_to_be_as_usual() -> None:
    assert drawn({"p": {"fixed": False}}).keys() == drawn().keys()


# ---- rows of a model -----------------------------------------------------------------------------

ROW, OTHER = "(state 0, 0)", "(state 1, 0)"
TO_1, TO_2, BACK = f"{ROW}: to state 1", f"{ROW}: to state 2", f"{OTHER}: to state 1"
THREE = MDP.from_arrays([[["1/2", "1/4", "1/4"], ["2/3", "1/3", 0], [0, 0, 1]]], [1, 0, 0])
NAMED = replace(
    moving(THREE, {TO_1: [(0, 1)], TO_2: [(0, 2)], BACK: [(1, 1)]}, {"reward.1": 1}),
    rows={ROW: (TO_1, TO_2), OTHER: (BACK,)},
)


@pytest.mark.parametrize(
    ("stated", "numbers"),
    [
        ({}, (2, 2, 4)),
        ({ROW: {SIZE: 4}}, (1, 1, 2)),
        ({TO_1: {SIZE: 4}, TO_2: {SIZE: 4}}, (1, 1, 2)),
        ({ROW: {SIZE: 4}, TO_1: {SIZE: 4}}, (1, 1, 2)),
        ({ROW: {"alpha": [1, 2, 3]}}, (1, 2, 3)),
        ({ROW: {"alpha": (1, "1/2", 3)}}, (1, 0.5, 3)),
        ({ROW: {"distribution": "dirichlet"}}, (2, 2, 4)),
        ({ROW: {"fixed": True}}, None),
        ({TO_1: {"fixed": True}, TO_2: {"fixed": True}}, None),
    ],
)
def test_what_is_stated_of_a_row_holds_for_all_of_it(stated: Any, numbers: Any) -> None:
    found = uncertainty(NAMED, stated, default=8)
    parts = {part.label: part for part in found.parts}
    assert parts[OTHER].numbers == pytest.approx((8 / 3, 16 / 3))
    assert (parts[ROW].numbers if ROW in parts else None) == (numbers and pytest.approx(numbers))
    assert ({TO_1, TO_2} <= {*found.fixed}) == (numbers is None)
    assert {*found.fixed} | {*found.names} == {TO_1, TO_2, BACK, "reward.1", "discount"}
    nothing = stated in ({}, {ROW: {"distribution": "dirichlet"}})
    assert found.assumed == ((ROW, OTHER) if nothing else (OTHER,))


APART = (f"=the parameters of {ROW} have different settings", f"=distribution of {ROW}",
         f'=they are drawn together: state the settings once, for "{ROW}"')  # fmt: skip
DIRICHLET = ("=probabilities of a row are Dirichlet", f"=row {ROW}",
             f"=state its {SIZE}, or alpha, a list of one more than its parameters")  # fmt: skip
ROWS_REFUSED: list[tuple[dict[str, object], tuple[str, str, str]]] = [
    ({TO_1: {SIZE: 4}}, APART),
    ({TO_1: {SIZE: 4}, TO_2: {SIZE: 5}}, APART),
    ({ROW: {SIZE: 5}, TO_1: {SIZE: 4}, TO_2: {SIZE: 4}}, APART),
    ({ROW: {"sd": 1}}, DIRICHLET),
    ({ROW: {"distribution": "beta"}}, DIRICHLET),
    ({ROW: {"alpha": 3}}, ("=alpha is 3", f"=row {ROW}", "=give a list of numbers")),
    ({ROW: {"alpha": [1, 2]}},
     ("=2 concentrations for 2 probabilities and the remaining one", f"=distribution of {ROW}",
      "=give one for each, and one more for the remaining probability of the row")),
    ({ROW: {"alpha": [1, 2, "x"]}},
     ("='x' is not a finite rational number", f"=parameter {ROW}, alpha", OF_NUMBER)),
    ({ROW: {SIZE: "x"}},
     ("='x' is not a finite rational number", f"=parameter {ROW}, {SIZE}", OF_NUMBER)),
    ({ROW: {SIZE: 0}},
     ("=effective sample size 0.0", f"=row {ROW}", "choose a number above 0, from 1e-06 to")),
    ({ROW: {"names": ["reward.1", "discount"], "covariance": [[1, 0], [0, 1]]}},
     ("=a row or a parameter has this name", f"=distribution of {ROW}",
      "=name the several differently")),
]  # fmt: skip


@pytest.mark.parametrize(("stated", "said"), ROWS_REFUSED)
def test_the_entries_of_a_row_are_drawn_together_or_refused(
    stated: Any, said: tuple[str, str, str]
) -> None:
    refused(lambda: uncertainty(NAMED, stated), *said)


def test_a_row_is_asked_for_by_its_name_or_by_all_of_its_entries() -> None:
    for names in ([ROW], [TO_1, TO_2], [TO_2, TO_1], [ROW, TO_1]):
        found = uncertainty(NAMED, names=names)
        assert found.names == (TO_1, TO_2)
        assert {*found.fixed} == {BACK, "reward.1", "discount"}
        assert {*found.fixed.values()} == {"not among the names asked for"}
    with pytest.raises(ModelError, match="without the others of"):
        uncertainty(NAMED, names=[TO_2])
    both = replace(NAMED, rows={ROW: (TO_1, TO_2), OTHER: (BACK, TO_2)})
    with pytest.raises(ModelError, match="rows"):
        uncertainty(both)
    with pytest.raises(ModelError, match="row of rewards"):
        uncertainty(replace(NAMED, rows={"of rewards": ("reward.1",)}))
    single = {part.kind for part in uncertainty(replace(NAMED, rows={})).parts}
    assert single == {"beta"}


def random_model(rng: np.random.Generator) -> MDP:
    """Up to four states with one to three actions each, of which some rows are certain."""
    count, rows = int(rng.integers(2, 5)), list[Any]()
    for state in range(count):
        for action in range(int(rng.integers(1, 4))):
            law = rng.integers(0, 4, count)
            law[int(rng.integers(count))] += 1
            total = int(law.sum())
            rows.append((state, action, [(Fraction(int(n), total), after, int(rng.integers(-2, 3)))
                                         for after, n in enumerate(law) if n]))  # fmt: skip
    return MDP.from_outcomes(rows, discount="1/2")


@pytest.mark.parametrize("seed", range(20))
def test_the_rows_of_any_model_are_parameters_but_for_the_largest_of_each(seed: int) -> None:
    mdp = random_model(np.random.default_rng(seed))
    family, expected = row_family(mdp), dict[str, dict[str, Fraction]]()
    for pair in range(mdp.n_pairs):
        chance: dict[int, Fraction] = {}
        for p, after, _ in mdp.table.row(pair):
            chance[after] = chance.get(after, Fraction(0)) + p
        if len(chance) == 1:
            continue
        most = min(state for state in chance if chance[state] == max(chance.values()))
        state, action = mdp.pair_state[pair], mdp.actions[mdp.pair_action[pair]]
        label = f"(state {state}, {action})"
        expected[label] = {
            f"{label}: to state {after}": chance[after] for after in sorted(chance) if after != most
        }
    values = {p.name: p.value for p in family.parameters}
    assert {
        label: {name: values[name] for name in names} for label, names in family.rows.items()
    } == expected
    assert all([*names] == [*expected[label]] for label, names in family.rows.items())
    numbers = {p.name: p.value for p in parametric(mdp).parameters}
    names = {name for row in expected.values() for name in row}
    assert {name: value for name, value in values.items() if name not in names} == numbers
    for label, row in expected.items():
        for name, value in row.items():
            moved = family.at({name: value / 2})
            pair = [*family.own.transition.toarray().tolist()]
            change = np.abs(np.array(pair) - moved.transition.toarray()).sum(axis=1)
            assert (change > 0).sum() == 1, label


def test_rows_of_outcomes_to_the_same_state_are_one_and_certain_rows_none() -> None:
    mdp = MDP.from_outcomes(
        [(0, 0, [("1/2", 1, 1), ("1/4", 1, 2), ("1/4", 0, 0)]), (1, 0, [("1/2", 1, 0),
         ("1/2", 1, 3)])], discount="1/2",
    )  # fmt: skip
    family = row_family(mdp)
    assert {**family.rows} == {"(state 0, 0)": ("(state 0, 0): to state 0",)}


def test_rows_of_a_model_that_repeats_in_time_are_refused() -> None:
    mdp = random_model(np.random.default_rng(0))
    with pytest.raises(ModelError, match="before it was unrolled"):
        row_family(mdp.within(3))
    family = drawn_family(mdp.within(3))
    assert {**row_family(mdp).rows} == {**family.rows}
    assert family.at({}).n_states == mdp.within(3).n_states
    assert drawn_family(NAMED) is NAMED
    assert {**drawn_family(mdp).rows} == {**row_family(mdp).rows}


def test_so_many_random_rows_are_drawn_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    assert distributions.MOST_ROWS == 2000
    monkeypatch.setattr(distributions, "MOST_ROWS", 2)
    row_family(THREE)
    monkeypatch.setattr(distributions, "MOST_ROWS", 1)
    with pytest.raises(ModelError, match="2 rows of the model are random"):
        row_family(THREE)


def test_rows_are_drawn_together_whatever_is_asked_of_their_model() -> None:
    rows = [["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]
    family = row_family(MDP.from_arrays([rows], [1, 0, 0], "1/2"))
    for model in (family, family.with_question(negated)):
        (part,) = uncertainty(model).parts
        assert (part.kind, len(part.names)) == ("dirichlet", 2)


# ---- intervals, standard errors, and a table with settings ---------------------------------------


@pytest.mark.parametrize(
    ("kind", "ends"),
    [("normal", (-1, 3)), ("uniform", (2, 3)), ("lognormal", (0.5, 0.72)), ("gamma", (100, 900)),
     ("beta", (0.1, 0.3))],
)  # fmt: skip
def test_an_interval_is_that_of_the_draws(kind: str, ends: tuple[float, float]) -> None:
    part = Uncertain.of_interval("p", kind, *ends)
    drawn = part.draw(SeedSequence(1), 20_000)[:, 0]
    for share, end in zip((0.025, 0.975), ends, strict=True):
        assert stats.binomtest(int((drawn < end).sum()), len(drawn), share).pvalue > 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_an_interval_has_two_ends_and_a_distribution(kind: str) -> None:
    fix = "=give [low, high] within the range of a normal, lognormal, uniform, gamma, beta"
    for low, high in ((0.5, 0.5), (0.5, 0.25), (0.5, math.inf), (-math.inf, 0.5), (math.nan, 0.5)):
        what = f"=no {kind} has the 95 % interval from {low} to {high}"
        call = partial(Uncertain.of_interval, "p", kind, low, high)
        refused(call, what, "=distribution of p", fix)


def family_of(*names: str) -> Family:
    known = [Parameter(name=name, value=10, low=0) for name in names]
    return Family(parameters=tuple(known), build=lambda at: MDP.from_arrays([[[1]]], [0], 0))


def test_settings_by_other_words() -> None:
    model = family_of("a", "b", "c")
    said = {
        "a": {"interval": [5, 20]},
        "b": {"se": 2},
        "c": {"distribution": "gamma", "shape": 4, "rate": "1/2"},
    }
    first, second, third = uncertainty(model, said).parts
    assert (first.kind, first) == ("gamma", Uncertain.of_interval("a", "gamma", 5, 20))
    assert (second.kind, second.mean, second.sd) == ("gamma", (10,), (2,))
    assert third.numbers == (4, 2)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"interval": [5, 20], "mean": 7}, r"an interval \[5, 20\] beside mean\n.*\n.*alone"),
        ({"interval": 5}, "write interval"),
        ({"interval": [5]}, "write interval"),
        ({"interval": [20, 5]}, "no gamma has the 95 % interval from 20.0 to 5.0"),
        ({"interval": [0, 5]}, "no gamma has"),
        ({"interval": [1, 5], "distribution": "triangular"}, "no triangular has"),
        ({"interval": [1, "x"]}, "parameter a, interval"),
        ({"se": 1, "sd": 1}, "state one of the two"),
        ({"shape": 1, "rate": 0}, "a gamma with"),
        ({"sem": 1}, "or se"),
    ],
)
def test_wrong_words_of_settings_are_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        uncertainty(family_of("a"), {"a": {"distribution": "gamma"} | settings})


def test_a_table_and_settings_together() -> None:
    model, table = family_of("a", "b", "c"), pd.DataFrame({"b": [1.0, 2, 3, 4]})
    chosen = uncertainty(model, [table, {"a": {"sd": 2}}])
    assert chosen.names == ("b", "a")
    assert [*chosen.fixed] == ["c"]
    draws = sample_parameters(model, chosen, 3, 0, 64)
    alone = sample_parameters(model, uncertainty(model, {"a": {"sd": 2}}), 3, 0, 64)
    assert draws[:, 0].tolist() == [1, 2, 3]
    assert draws[:, 1].tolist() == alone[:, 0].tolist()
    fix = "=give [table, {name: settings}]: one table and the settings of other parameters"
    cases: list[tuple[list[Any], tuple[str, str, str]]] = [
        ([table, {"b": {"sd": 1}}],
         ("=a column, and settings", "=parameter b", "=leave it out of one of the two")),
        ([table], ("=1 things are given", "=uncertain", fix)),
        ([table, table], ("=2 things are given", "=uncertain", fix)),
    ]  # fmt: skip
    for wrong, said in cases:
        refused(partial(uncertainty, model, wrong), *said)


def test_what_is_in_a_table_is_not_drawn_and_other_probabilities_rest_on_the_default() -> None:
    chances = [Parameter(name=name, value="1/4", low=0, high=1) for name in "pq"]
    model = Family(parameters=tuple(chances), build=lambda at: MDP.from_arrays([[[1]]], [0], 0))
    table = pd.DataFrame({"p": [0.1, 0.2]})
    for settings in ({}, {"q": {SIZE: 20}}):
        chosen = uncertainty(model, [table, settings], default=20)
        assert [part.kind for part in chosen.parts] == ["sample", "beta"]
        assert chosen.names == ("p", "q")
        assert chosen.parts[1].numbers == (5, 15)
        assert chosen.default == 20
