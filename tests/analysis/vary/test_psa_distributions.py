"""Distributions of uncertain parameters: moments, streams, files, and what is refused."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas
import pytest
from numpy.random import SeedSequence
from scipy import stats
from scipy_laws import SCIPY_LAWS

from exact_mdp import (
    MDP,
    Family,
    Parameter,
    Scenario,
    Uncertain,
    moving,
    parametric,
    psa,
    uncertainty,
)

YUAN = parametric(Scenario.load("yuan2025"))
COUNT = 40_000


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("beta", {"mean": 0.05, "effective_sample_size": 30}),
        ("beta", {"mean": 0.95, "sd": 0.1}),
        ("beta", {"alpha": 84, "beta": 716}),
        ("normal", {"mean": -5, "relative_sd": 0.3}),
        ("normal", {"mean": 0, "sd": 2}),
        ("gamma", {"mean": -5, "relative_sd": 0.3}),
        ("gamma", {"mean": 20, "sd": 30}),
        ("gamma", {"shape": 44.5, "scale": 45}),
        ("lognormal", {"mean": 3, "sd": 0.5}),
        ("lognormal", {"meanlog": 1.1, "sdlog": 0.2}),
        ("uniform", {"mean": 4000, "sd": 500}),
        ("uniform", {"low": -1, "high": 3}),
        ("triangular", {"mean": 4000, "relative_sd": 0.1}),
        ("triangular", {"low": 0, "mode": 1, "high": 5}),
    ],
)
def test_draws_have_the_stated_mean_spread_and_law(kind: str, said: dict[str, float]) -> None:
    part = Uncertain.of("p", kind, **said)
    law, (mean,), (sd,) = SCIPY_LAWS[kind](*part.numbers), part.mean, part.sd
    assert (law.mean(), law.std()) == pytest.approx((abs(mean) if kind == "gamma" else mean, sd))
    if "mean" in said:
        size = said.get("effective_sample_size", np.inf)
        spread = abs(mean) * said.get("relative_sd", 0) or (mean * (1 - mean) / (size + 1)) ** 0.5
        assert (mean, sd) == (said["mean"], pytest.approx(said.get("sd", spread)))
    drawn = part.draw(SeedSequence(1), COUNT)
    assert drawn.shape == (COUNT, 1)
    sign = np.sign(mean) if kind == "gamma" else 1
    assert stats.kstest(sign * drawn[:, 0], law.cdf).pvalue > 1e-3


MODEL = Family(
    parameters=(
        Parameter(name="cost", value="4000", low=0),
        Parameter(name="p", value="3/20", low=0, high=1),
        Parameter(name="weight", value=-2),
    ),
    build=lambda at: MDP.from_arrays([[[1]]], [0], 0),
)


@pytest.mark.parametrize(
    ("stated", "kinds"),
    [
        ({"cost": {"relative_sd": "1/10"}}, {"cost": "gamma", "p": "beta"}),
        (
            {"cost": {"sd": 400}, "weight": {"sd": 1}},
            {"cost": "gamma", "p": "beta", "weight": "normal"},
        ),
        ({"p": {"relative_sd": 0.1}}, {"p": "beta"}),
        ({"p": {"distribution": "lognormal", "mean": 0.1, "sd": 0.01}}, {"p": "lognormal"}),
        ({"p": {"fixed": True}, "cost": {"distribution": "normal", "sd": 9}}, {"cost": "normal"}),
    ],
)
def test_what_a_parameter_may_be_decides_its_distribution(stated, kinds) -> None:
    distributions = uncertainty(MODEL, stated)
    assert {part.label: part.kind for part in distributions.parts} == kinds


def test_a_sample_of_ones_own_is_drawn_row_by_row() -> None:
    frame = pandas.DataFrame({"cost": [1.0, 2.0, 3.0], "p": [0.1, 0.2, 0.4]})
    analysis = psa(MODEL, uncertain=frame)
    assert analysis.table.points.tolist() == frame.to_numpy().tolist()
    assert psa(MODEL, 2, uncertain=frame).table.points.tolist() == frame.to_numpy()[:2].tolist()
    assert analysis.uncertainty.fixed == {"weight": "not in the sample"}


def test_a_dirichlet_row_has_the_law_that_it_must_have() -> None:
    part, law = Uncertain.of_row("row", ("p", "q"), (2.4, 6.0, 3.6)), stats.dirichlet([2.4, 6, 3.6])
    drawn = part.draw(SeedSequence(2), COUNT)
    assert (*part.mean, *part.sd) == pytest.approx((*law.mean()[:2], *law.var()[:2] ** 0.5))
    assert np.cov(drawn.T)[0, 1] == pytest.approx(-0.2 * 0.5 / 13, rel=0.05)
    for column, shape in zip([*drawn.T, drawn.sum(axis=1)], (2.4, 6, 8.4), strict=True):
        assert stats.kstest(column, stats.beta(shape, 12 - shape).cdf).pvalue > 1e-3


def test_a_larger_sample_begins_with_the_smaller_and_other_parts_change_nothing() -> None:
    one = uncertainty(YUAN, default=20)
    two = uncertainty(YUAN, {"base.anger": {"fixed": True}}, default=20)
    small, large = one.draw(SeedSequence(0), 50), one.draw(SeedSequence(0), 90)
    assert np.array_equal(small, large[:50])
    unchanged = [name != "base.anger" for name in one.names]
    assert np.array_equal(two.draw(SeedSequence(0), 50), small[:, unchanged])


def test_what_is_drawn_and_what_is_held_is_everything() -> None:
    distributions = uncertainty(YUAN)
    names = {parameter.name for parameter in YUAN.parameters}
    assert set(distributions.names) | set(distributions.fixed) == names
    assert not set(distributions.names) & set(distributions.fixed)
    assert distributions.fixed["persistence.anger"] == "1 today"
    assert distributions.fixed["assistance.supportive.anger.onset"] == "0 today"
    assert "reward.anger" in distributions.fixed
    assert "discount" in distributions.fixed


def test_the_longest_beginning_counts(tmp_path: Path) -> None:
    file = tmp_path / "uncertain.toml"
    file.write_text(
        "[default]\neffective_sample_size = 200\n[base]\neffective_sample_size = 40\n"
        '["base.anger"]\neffective_sample_size = 15\n[influence.anger]\nfixed = true\n'
        '["reward.trial"]\ndistribution = "gamma"\nrelative_sd = 0.2\n'
        "[reward.assist]\nrelative_sd = 0.5\n"
    )
    distributions = uncertainty(YUAN, file)
    assert (distributions.default, uncertainty(YUAN, file, default=9).default) == (200, 9)
    sizes = {part.names[0]: (part.kind, part.size) for part in distributions.parts}
    assert sizes["base.anger"] == ("beta", 15)
    assert sizes["base.confusion"] == ("beta", 40)
    assert sizes["persistence.confusion"] == ("beta", 200)
    assert sizes["reward.trial"] == ("gamma", pytest.approx(0.2))
    assert sizes["reward.assist.directive"] == ("normal", 0.5)
    assert distributions.fixed["influence.anger.confusion"] == "stated to be fixed"
    assert distributions.fixed["reward.assist.none"] == "0 today"


ROW = "(state 0, 0)"
ONE, TWO = f"{ROW}: to state 1", f"{ROW}: to state 2"
THREE = "(state 1, 0): to state 1"
LAWS = MDP.from_arrays([[["1/2", "1/4", "1/4"], ["2/3", "1/3", 0], [0, 0, 1]]], [1, 0, 0])
ROWS = replace(
    moving(LAWS, {ONE: [(0, 1)], TWO: [(0, 2)], THREE: [(1, 1)]}, {"reward.1": 1}),
    rows={ROW: (ONE, TWO), "(state 1, 0)": (THREE,)},
)
FIVE, FIXED = {"effective_sample_size": 5}, {"fixed": True}


@pytest.mark.parametrize(
    ("stated", "size"),
    [
        ({}, 7.0),
        ({ROW: FIVE}, 5.0),
        ({ONE: FIVE, TWO: FIVE}, 5.0),
        ({ROW: FIVE, ONE: FIVE}, 5.0),
        ({ROW: FIXED}, None),
        ({ONE: FIXED, TWO: FIXED}, None),
    ],
)
def test_what_is_stated_of_a_row_holds_for_all_of_it(stated, size) -> None:
    distributions = uncertainty(ROWS, stated, default=7)
    sizes = {part.label: part.size for part in distributions.parts}
    assert (sizes.get(ROW), sizes["(state 1, 0)"]) == (size, 7.0)
    assert {ONE, TWO} <= (set(distributions.names) if size else set(distributions.fixed))
    assert not set(distributions.names) & set(distributions.fixed)
    for names in ([ROW], [ONE, TWO]):  # drawn whole, and nothing else
        alone = uncertainty(ROWS, names=names)
        assert alone.names == (ONE, TWO)
        assert set(alone.fixed) == {THREE, "reward.1", "discount"}
    assert {part.kind for part in uncertainty(replace(ROWS, rows={})).parts} == {"beta"}


THIRD = 1 / 3


@pytest.mark.parametrize(
    "row", [("1/2", "1/3", "1/6"), (THIRD, 0.1, 1 - THIRD - 0.1 + 1e-16)], ids=["exact", "floats"]
)
def test_rows_of_any_model_are_dirichlet_and_stay_distributions(row: tuple[object, ...]) -> None:
    """Rows of floats that sum to 1 but for rounding, too."""
    ends = [(state, 0, [(1, state, 0)]) for state in (1, 2)]
    mdp = MDP.from_outcomes([(0, 0, [(p, s, s) for s, p in enumerate(row)]), *ends], "9/10")
    family = replace(moving(mdp, {ONE: [(0, 1)], TWO: [(0, 2)]}), rows={ROW: (ONE, TWO)})
    distributions = uncertainty(family)
    assert [(part.kind, part.label) for part in distributions.parts] == [("dirichlet", ROW)]
    for one, two in distributions.draw(SeedSequence(3), 5).tolist():
        chance = {s: p for p, s, _ in family.at({ONE: one, TWO: two}).table.row(0)}
        assert sum(chance.values()) == 1
        assert (float(chance[1]), float(chance[2])) == pytest.approx((one, two))


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1])
def test_a_row_of_which_little_is_known_stays_a_distribution(size: float) -> None:
    """All of its mass is on one outcome in most draws, and rounding alone is left of the others."""
    ends = [(state, 0, [(1, 4, state)]) for state in (1, 2, 3)] + [(4, 0, [(1, 4, 0)])]
    mdp = MDP.from_outcomes([(0, 0, [("1/3", s, 0) for s in (1, 2, 3)]), *ends])
    analysis = psa(mdp, 1000, rng=0, effective_sample_size=size)
    assert max(sum(map(Fraction, row)) for row in analysis.table.points.tolist()) <= 1
    assert abs(analysis.value.value - 2) < 4 * analysis.value.standard_error
