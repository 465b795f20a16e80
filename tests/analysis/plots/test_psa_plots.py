"""Figures of the probabilistic analysis: what stands on the axes is what was found."""

import importlib
import pkgutil

import matplotlib
import numpy as np
import pytest

from exact_mdp import analysis, solvers
from exact_mdp.analysis.plots.psa import plot_acceptability, plot_optimal_actions
from exact_mdp.analysis.sensitivity.psa.distributions import uncertainty
from exact_mdp.analysis.sensitivity.psa.expected_loss import expected_loss
from exact_mdp.analysis.sensitivity.psa.psa import PSA, psa
from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.mdp.parametric import parametric
from exact_mdp.mdp.result import Pictured

matplotlib.use("Agg")
SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)


@pytest.fixture(scope="module")
def found() -> PSA:
    return psa(SMALL, 800, rng=0, effective_sample_size=10)


@pytest.fixture(autouse=True)
def closed():
    from matplotlib import pyplot

    yield
    pyplot.close("all")


def test_the_acceptability_curve_is_the_distribution_of_the_regret(found: PSA) -> None:
    ax = found.plot(tolerances=[0, 0.01, 0.1, 1])
    shares = [(found.regret() <= t).mean() for t in (0, 0.01, 0.1, 1)]
    assert np.allclose(ax.lines[0].get_ydata(), shares)
    both = plot_acceptability(found, candidates=range(min(2, len(found.candidates))))
    assert both.lines[0].get_ydata()[-1] >= 0.98
    assert "Δ (reward)" in both.get_xlabel()
    ticks, near = both.get_xticks(), both.xaxis.get_transform().linthresh
    assert ticks[0] == 0
    assert len(ticks) > 1
    assert (ticks[1:] > near).all()  # none stands upon the 0
    both.figure.canvas.draw()
    assert [float(label.get_text()) for label in both.get_xticklabels()] == pytest.approx(ticks)


def test_a_policy_that_never_loses_has_a_curve_too() -> None:
    weights = uncertainty(
        parametric(SMALL), {"reward": {"relative_sd": 1e-6}}, names=["reward.timestep"]
    )
    sure = psa(SMALL, 50, rng=0, uncertain=weights)
    ax = plot_acceptability(sure)
    assert list(ax.lines[0].get_ydata()) == [1.0]


def test_the_heat_map_shows_shares_of_draws(found: PSA) -> None:
    ax = plot_optimal_actions(found)
    assert np.allclose(ax.images[0].get_array(), found.probability_optimal()[0])
    assert [each.get_text() for each in ax.get_yticklabels()] == list(found.labels)


def test_expected_losses_are_drawn_at_their_points() -> None:
    curve = expected_loss(SMALL, {"a": "optimal", "b": "random"}, [10, 100], rng=0, n=50)
    ax = curve.plot()
    assert ax.get_xscale() == ax.get_yscale() == "log"
    assert {line.get_label() for line in ax.lines} >= {"best of these"}
    assert "observations" in ax.get_xlabel()
    bars = [segment[:, 1] for bar in ax.containers for segment in bar[2][0].get_segments()]
    assert np.min(bars) > 0
    ends = np.column_stack([curve.low.T.reshape(-1), curve.high.T.reshape(-1)])
    floor = ax.lines[0].get_ydata().min() / 10
    assert np.allclose(bars, np.maximum(ends, floor), rtol=1e-9, atol=floor)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"points": []}, "0 points"),
        ({"n": 1}, "1 draws"),
        ({"policies": {}}, "0 policies"),
        ({"points": [0]}, "sample size 0"),
        ({"names": ["base.angre"]}, "did you mean"),
    ],
)
def test_curves_that_cannot_be_are_refused(words: dict[str, object], message: str) -> None:
    given = {"policies": {"a": "optimal"}, "points": [10], "rng": 0, "n": 5} | words
    with pytest.raises(ModelError, match=message):
        expected_loss(SMALL, **given)


def test_every_picture_is_drawn_by_a_function_that_is_there() -> None:
    for package in (analysis, solvers):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if "kernels" not in module.name and "plugin" not in module.name:
                importlib.import_module(module.name)
    waiting, seen = [Pictured], []
    while waiting:
        waiting += (kinds := waiting.pop().__subclasses__())
        seen += [kind for kind in kinds if hasattr(kind, "picture")]
    assert len(seen) >= 15
    for kind in seen:
        module, _, function = kind.picture.partition(":")
        assert callable(getattr(importlib.import_module(module), function)), kind
