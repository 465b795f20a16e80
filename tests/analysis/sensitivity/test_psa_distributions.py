"""Distributions of uncertain parameters: moments, streams, files, and what is refused."""

from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest
from numpy.random import SeedSequence

from exact_mdp import (
    MDP,
    ModelError,
    Scenario,
    Uncertain,
    Uncertainty,
    load_uncertainty,
    parametric,
    uncertainty,
)
from exact_mdp.analysis.sensitivity.psa.rows import row_family

YUAN = parametric(Scenario.load("yuan2025"))
COUNT = 40_000


@pytest.mark.parametrize(
    "part",
    [
        Uncertain(names=("p",), kind="beta", mean=(0.05,), size=30),
        Uncertain(names=("p",), kind="beta", mean=(0.99,), size=2),
        Uncertain(names=("p", "q"), kind="dirichlet", mean=(0.2, 0.5), size=12),
        Uncertain(names=("w",), kind="normal", mean=(-5.0,), size=0.3),
        Uncertain(names=("w",), kind="gamma", mean=(-5.0,), size=0.3),
        Uncertain(names=("w",), kind="gamma", mean=(20.0,), size=1.5),
    ],
    ids=lambda part: f"{part.kind}-{part.mean[0]}",
)
def test_draws_have_the_stated_mean_and_spread(part: Uncertain) -> None:
    drawn = part.draw(SeedSequence(1), COUNT)
    assert drawn.shape == (COUNT, len(part.names))
    error = drawn.std(axis=0) / COUNT**0.5
    assert (np.abs(drawn.mean(axis=0) - part.mean) < 4 * error).all()
    fourth = ((drawn - drawn.mean(axis=0)) ** 4).mean(axis=0)
    spread = (fourth - drawn.var(axis=0) ** 2) ** 0.5 / COUNT**0.5
    assert (np.abs(drawn.var(axis=0) - np.square(part.sd)) < 4 * spread).all()
    if part.kind in ("beta", "dirichlet"):
        assert drawn.min() >= 0
        assert drawn.sum(axis=1).max() <= 1
    if part.kind == "gamma":
        assert (np.sign(drawn) == np.sign(part.mean[0])).all()


def test_a_dirichlet_row_is_negatively_correlated_as_it_must_be() -> None:
    part = Uncertain(names=("p", "q"), kind="dirichlet", mean=(0.2, 0.5), size=12)
    drawn = part.draw(SeedSequence(2), COUNT)
    assert np.cov(drawn.T)[0, 1] == pytest.approx(-0.2 * 0.5 / 13, rel=0.05)


def test_a_larger_sample_begins_with_the_smaller_and_other_parts_change_nothing() -> None:
    one = uncertainty(YUAN, default=20)
    two = uncertainty(YUAN, {"base.anger": {"fixed": True}}, default=20)
    small, large = one.draw(SeedSequence(0), 50), one.draw(SeedSequence(0), 90)
    assert np.array_equal(small, large[:50])
    kept = [name != "base.anger" for name in one.names]
    assert np.array_equal(two.draw(SeedSequence(0), 50), small[:, kept])


def test_what_is_drawn_and_what_is_held_is_everything() -> None:
    found = uncertainty(YUAN)
    names = {parameter.name for parameter in YUAN.parameters}
    assert set(found.names) | set(found.fixed) == names
    assert not set(found.names) & set(found.fixed)
    assert found.fixed["persistence.anger"] == "1 today"
    assert found.fixed["assistance.supportive.anger.onset"] == "0 today"
    assert "reward.anger" in found.fixed
    assert "discount" in found.fixed


def test_the_longest_beginning_counts(tmp_path: Path) -> None:
    file = tmp_path / "uncertain.toml"
    file.write_text(
        "[default]\neffective_sample_size = 200\n[base]\neffective_sample_size = 40\n"
        '["base.anger"]\neffective_sample_size = 15\n[influence.anger]\nfixed = true\n'
        '["reward.trial"]\ndistribution = "gamma"\nrelative_sd = 0.2\n'
        "[reward.assist]\nrelative_sd = 0.5\n"
    )
    stated, default = load_uncertainty(file)
    found = uncertainty(YUAN, stated, default=default)
    sizes = {part.names[0]: (part.kind, part.size) for part in found.parts}
    assert sizes["base.anger"] == ("beta", 15)
    assert sizes["base.confusion"] == ("beta", 40)
    assert sizes["persistence.confusion"] == ("beta", 200)
    assert sizes["reward.trial"] == ("gamma", 0.2)
    assert sizes["reward.assist.directive"] == ("normal", 0.5)
    assert found.fixed["influence.anger.confusion"] == "stated to be fixed"
    assert found.fixed["reward.assist.none"] == "0 today"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[base\n", "broken TOML"),
        ("", "nothing is stated"),
        ('["base.angre"]\neffective_sample_size = 3\n', "base.angre"),
        ("[base]\neffective_sample = 3\n", "unknown setting 'effective_sample'"),
        ("effective_sample_size = 3\n", "unknown setting"),
        ("[default]\nrelative_sd = 3\n", "states more than"),
        ('[default]\neffective_sample_size = "3"\n', "'3'"),
        ("[base]\neffective_sample_size = 0\n", "effective sample size 0"),
        ("[base]\neffective_sample_size = -2\n", "effective sample size -2"),
        ("[base]\neffective_sample_size = nan\n", "effective sample size nan"),
        ("[base]\neffective_sample_size = true\n", "True"),
        ("[base]\nrelative_sd = 0.1\n", "relative spread"),
        ("[reward]\neffective_sample_size = 9\n", "reward weight"),
        ("[reward]\nrelative_sd = 0\n", "relative standard deviation 0"),
        ('[reward]\nrelative_sd = 0.1\ndistribution = "beta"\n', "beta"),
        ('[reward]\ndistribution = "gamma"\n', "without a relative_sd"),
        ('[base]\nfixed = "false"\n', "fixed is 'false'"),
        ("[base]\nfixed = true\neffective_sample_size = 3\n", "fixed, and a distribution"),
        ("[base]\nrelative_sd = 0.1\neffective_sample_size = 3\n", "both"),
        ("[reward]\nrelative_sd = 1e-200\n", "relative standard deviation 1e-200"),
        ('[reward]\nrelative_sd = 1e-200\ndistribution = "gamma"\n', "1e-200"),
        ("[reward]\nrelative_sd = 1e200\n", r"1e\+200"),
        (f"[base]\neffective_sample_size = {10**300}\n", r"1e\+300"),
        (f"[base]\neffective_sample_size = {10**400}\n", "300 digits"),
        (f"[default]\neffective_sample_size = {10**400}\n", "300 digits"),
        ("[base]\neffective_sample_size = 1e-300\n", "1e-300"),
        ("[base]\neffective_sample_size = inf\n", "inf"),
        ('"base.anger" = [0.1, 0.2]\n', "psa takes distributions"),
    ],
)
def test_files_that_cannot_be_are_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "uncertain.toml"
    file.write_text(text)
    with pytest.raises(ModelError, match=message):
        uncertainty(YUAN, load_uncertainty(file)[0])


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"base": {"efective_sample_size": 3}}, "unknown setting 'efective_sample_size'"),
        ({"base": {"fixed": "no"}}, "fixed is 'no'"),
        ({"base": {"fixed": 1}}, "fixed is 1"),
        ({"base": 50}, "50 is stated"),
        ({"base": {"effective_sample_size": "3"}}, "'3'"),
        ({"reward": {"distribution": "gama"}}, "gama"),
        ({"reward": {"relative_sd": True}}, "True"),
    ],
)
def test_settings_that_cannot_be_are_refused_from_python_too(stated, message) -> None:
    with pytest.raises(ModelError, match=message):
        uncertainty(YUAN, stated)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"kind": "beta", "names": ("a", "b"), "mean": (0.3, 0.2)}, "2 names"),
        ({"kind": "beta", "names": ("a",), "mean": (0.3, 0.2)}, "2 means"),
        ({"kind": "dirichlet", "names": (), "mean": ()}, "0 names"),
        ({"kind": "normal", "names": ("a",), "mean": (float("inf"),)}, "around inf"),
        ({"kind": "gamma", "names": ("a",), "mean": (float("nan"),)}, "around nan"),
        ({"kind": "beta", "names": ("a",), "mean": (float("nan"),)}, "means nan"),
    ],
)
def test_distributions_that_cannot_be_are_refused(words, message) -> None:
    with pytest.raises(ModelError, match=message):
        Uncertain(size=10.0, **words)


def test_a_parameter_is_drawn_once() -> None:
    part = Uncertain(names=("a",), kind="beta", mean=(0.3,), size=10.0)
    with pytest.raises(ModelError, match="a is drawn twice"):
        Uncertainty(parts=(part, part), fixed={})


ROW = "(state 0, 0)"
ONE, TWO = f"{ROW}: to state 1", f"{ROW}: to state 2"
FAMILY = row_family(
    MDP.from_arrays([[["1/2", "1/4", "1/4"], ["2/3", "1/3", 0], [0, 0, 1]]], [1, 0, 0])
)


@pytest.mark.parametrize(
    ("stated", "size"),
    [
        ({}, 7.0),
        ({ROW: {"effective_sample_size": 5}}, 5.0),
        ({ONE: {"effective_sample_size": 5}, TWO: {"effective_sample_size": 5}}, 5.0),
        ({ROW: {"effective_sample_size": 5}, ONE: {"effective_sample_size": 5}}, 5.0),
        ({ROW: {"fixed": True}}, None),
        ({ONE: {"fixed": True}, TWO: {"fixed": True}}, None),
    ],
)
def test_what_is_stated_of_a_row_holds_for_all_of_it(stated, size) -> None:
    found = uncertainty(FAMILY, stated, default=7)
    sizes = {part.label: part.size for part in found.parts}
    assert sizes.get(ROW) == size
    assert sizes["(state 1, 0)"] == 7.0
    assert {ONE, TWO} <= (set(found.names) if size else set(found.fixed))
    assert not set(found.names) & set(found.fixed)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({ONE: {"effective_sample_size": 5}}, "different settings"),
        ({TWO: {"fixed": True}}, "different settings"),
        ({ROW: {"effective_sample_size": 5}, TWO: {"fixed": True}}, "different settings"),
        ({ROW: {"relative_sd": 0.3}}, "relative spread of a probability"),
        ({"(state 0, 1)": {"fixed": True}}, "unknown parameter"),
    ],
)
def test_what_does_not_fit_a_row_is_refused(stated, message) -> None:
    with pytest.raises(ModelError, match=message):
        uncertainty(FAMILY, stated)


def test_a_row_is_drawn_whole_or_not_at_all() -> None:
    for names in ([ROW], [ONE, TWO]):
        found = uncertainty(FAMILY, names=names)
        assert found.names == (ONE, TWO)
        assert set(found.fixed) == {"(state 1, 0): to state 1", "discount"}
    for name in (ONE, TWO):
        with pytest.raises(ModelError, match="without the others"):
            uncertainty(FAMILY, names=[name])
    with pytest.raises(ModelError, match="in two rows"):
        uncertainty(replace(FAMILY, rows={"a": (ONE,), "b": (ONE, TWO)}))
    with pytest.raises(ModelError, match="not a probability of a row"):
        uncertainty(replace(FAMILY, rows={"a": ("discount",)}))
    assert {part.kind for part in uncertainty(replace(FAMILY, rows={})).parts} == {"beta"}


def test_rows_of_any_model_are_dirichlet_and_stay_distributions() -> None:
    rows = [
        (0, 0, [(F(1, 2), 0, F(1)), (F(1, 3), 1, F(0)), (F(1, 6), 2, F(2))]),
        (1, 0, [(F(1), 2, F(0))]),
        (2, 0, [(F(1), 2, F(0))]),
    ]
    family = row_family(MDP.from_outcomes(rows, F(9, 10)))
    (names,) = family.rows.values()
    found = uncertainty(family)
    assert [part.kind for part in found.parts] == ["dirichlet"]
    drawn = found.draw(SeedSequence(3), 5)
    for row in drawn.tolist():
        mdp = family.at(dict(zip(names, row, strict=True)))
        chance = {state: p for p, state, _ in mdp.table.row(0)}
        assert sum(chance.values()) == 1
        assert [float(chance[state]) for state in (1, 2)] == pytest.approx(row)


def test_a_model_without_chance_has_nothing_to_draw() -> None:
    with pytest.raises(ModelError, match="0 rows"):
        row_family(MDP.from_arrays([[[1]]], [1], "1/2"))


def test_rows_of_floats_that_sum_to_one_but_for_rounding_can_be_drawn() -> None:
    third = 1 / 3
    outcomes = [(third, 0, 0.0), (0.1, 1, 1.0), (1 - third - 0.1 + 1e-16, 2, 0.0)]
    ends = [(state, 0, [(1.0, state, 0.0)]) for state in (1, 2)]
    mdp = MDP.from_outcomes([(0, 0, outcomes), *ends], 0.9)
    family = row_family(mdp)
    (names,) = family.rows.values()
    drawn = uncertainty(family).draw(SeedSequence(4), 3)
    for row in drawn.tolist():
        chances = [p for p, _, _ in family.at(dict(zip(names, row, strict=True))).table.row(0)]
        assert sum(chances) == 1
