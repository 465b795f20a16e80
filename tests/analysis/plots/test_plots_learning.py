"""The pictures of learning: each draws what it is given, on the axes that it is given."""

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from exact_mdp.analysis.learning.curves import LearningCurve, learning_curve, random_curve
from exact_mdp.analysis.learning.instability import Prediction, predict
from exact_mdp.analysis.learning.outcomes import Outcomes, outcomes
from exact_mdp.analysis.plots import (
    plot_distinct,
    plot_learning_curves,
    plot_regrets,
    plot_value_bands,
    style,
)
from exact_mdp.mdp import MDP, Scenario
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.training import train_many

LEARNER = QLearning(epochs=40)


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").compile()


@pytest.fixture(scope="module")
def found(care: MDP) -> Outcomes:
    return outcomes(care, train_many(care, LEARNER, 12, rng=0))


@pytest.fixture(scope="module")
def curves(care: MDP) -> dict[str, LearningCurve]:
    run = LEARNER.train(care, 0)
    return {
        "constant ε": learning_curve(care, run, rng=1),
        "random": random_curve(care, 40, rng=2),
    }


@pytest.fixture(scope="module")
def theory(care: MDP) -> Prediction:
    return predict(care, LEARNER, n=4, episodes=60)


@pytest.fixture
def ax() -> Iterator[Axes]:
    with style():
        yield Figure().subplots()


def drawn(ax: Axes) -> None:
    """Draw it for real; every axis is labelled."""
    assert ax.get_ylabel()
    ax.figure.canvas.draw()


def test_learning_curves(ax: Axes, curves: dict[str, LearningCurve]) -> None:
    assert plot_learning_curves(curves, optimum=146.2, window=5, ax=ax) is ax
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["constant ε", "random", "optimum"]
    heavy = next(line for line in ax.get_lines() if line.get_label() == "constant ε")
    exact = curves["constant ε"].exact
    assert heavy.get_ydata() == pytest.approx([exact[i : i + 5].mean() for i in range(36)])
    drawn(ax)


def test_a_window_longer_than_the_curve(ax: Axes, curves: dict[str, LearningCurve]) -> None:
    plot_learning_curves(curves, ax=ax)
    drawn(ax)


def test_value_bands(ax: Axes) -> None:
    values = np.random.default_rng(0).normal(size=(9, 30))
    plot_value_bands({"a": values, "b": values + 1}, window=1, optimum=3.0, ax=ax)
    line = next(line for line in ax.get_lines() if line.get_label() == "a")
    assert line.get_ydata() == pytest.approx(values.mean(axis=0))
    drawn(ax)


def test_regrets(ax: Axes, found: Outcomes) -> None:
    plot_regrets({"constant ε": found}, ax=ax)
    x, y = ax.get_lines()[0].get_data()
    assert x[-1] == found.regret.max()
    assert y[-1] == 1
    assert f"{found.regret.mean():.2f}" in ax.get_legend().get_texts()[0].get_text()
    drawn(ax)


def test_distinct(ax: Axes, found: Outcomes) -> None:
    plot_distinct({"constant ε": found, "again": found}, ax=ax)
    heights = [bar.get_height() for bar in ax.patches]
    assert sum(heights) == pytest.approx(2)
    drawn(ax)
