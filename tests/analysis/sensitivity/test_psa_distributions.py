"""Distributions of uncertain parameters: moments, streams, files, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from numpy.random import SeedSequence

from exact_mdp import (
    ModelError,
    Scenario,
    Uncertain,
    Uncertainty,
    load_uncertainty,
    parametric,
    uncertainty,
)

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
