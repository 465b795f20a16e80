"""Figures: what stands on the axes is what was found, and every picture has its function."""

import itertools
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from picture_texts import legend_of, texts_of

from exact_mdp import (
    MDP,
    Family,
    QLearning,
    Scenario,
    check,
    curve,
    evaluate,
    gradient,
    learning_curve,
    outcomes,
    plots,
    psa,
    return_distribution,
    sobol,
    solve,
    thresholds,
    tornado,
    train,
)

SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)


@pytest.fixture(scope="module")
def draws() -> Any:
    return psa(SMALL, 800, rng=0, effective_sample_size=10)


MAINTENANCE = MDP.from_arrays(  # costs as negative rewards: wait and wear, or replace
    [[["3/10", "7/10"], [0, 1]], [[1, 0], [1, 0]]], [[-1, -8], [-5, -8]], "19/20", layout="ass"
)


@pytest.mark.parametrize(
    "model", [MAINTENANCE, MAINTENANCE.with_(discount="1/2"), SMALL], ids=["cost", "less", "care"]
)
def test_a_fill_says_where_the_value_goes(model: MDP | Scenario) -> None:
    """It is the derivative's sign, where the value or the parameter is negative, too."""
    slopes, low = gradient(model, exact=False), "lowers the value"
    ax = slopes.plot(most=60)
    names = texts_of(ax.get_yticklabels())
    legend = ax.get_legend()
    looks = {t.get_text(): p for t, p in zip(legend.get_texts(), legend.get_patches(), strict=True)}
    for name, bar in zip(names, ax.patches, strict=True):
        each = slopes[name]
        assert bar.get_width() == each.elasticity
        drawn = looks["raises the value" if each.value.value > 0 else low]
        assert (bar.get_facecolor(), bar.get_hatch()) == (drawn.get_facecolor(), drawn.get_hatch())
    if model is MAINTENANCE:
        discount = slopes["discount"]
        assert discount.value.value < 0 < discount.elasticity


LONG = [f"a machine in condition {k}" for k in range(24)]
MANY = MDP.from_arrays(np.eye(200)[np.newaxis], np.arange(200.0), 0.9)
EVEN = MDP.from_arrays(np.full((6, 24, 24), 1 / 24), np.zeros((24, 6)), 0.9, states=LONG)
HALLS = [f"a machine in the northern hall of the factory in condition {k}" for k in range(200)]
HALL = MANY.with_(states=HALLS)
FEW = MDP.from_arrays(np.eye(30)[np.newaxis], np.arange(30.0), 0.9, states=HALLS[:30])


@pytest.mark.parametrize("size", [None, (5.5, 3.8), (3.3, 3.9)])
@pytest.mark.parametrize(
    "draw",
    [
        lambda ax: tornado(SMALL, policy="random").plot(ax),
        lambda ax: gradient(SMALL, exact=False).plot(ax),
        lambda ax: tornado(MAINTENANCE, names=["discount"]).plot(ax),
        lambda ax: evaluate(EVEN, "random").plot(ax, visits=True),
        lambda ax: solve(EVEN).plot(ax),
        lambda ax: plots.plot_policy(EVEN, "random", ax=ax),
        lambda ax: solve(MANY).plot(ax),
        lambda ax: check(MANY, [0] * 200).plot(ax),
        lambda ax: solve(HALL).plot(ax),
        lambda ax: solve(FEW).plot(ax),
        lambda ax: check(FEW, [0] * 30).plot(ax),
        lambda ax: plots.plot_policy(FEW, [0] * 30, ax=ax),
        lambda ax: thresholds(SMALL, "reward.assist.directive", relative=1).plot(ax),
        lambda ax: curve(MAINTENANCE, "discount").plot(ax),
        lambda ax: return_distribution(SMALL.compile(), "random").plot(ax),
        lambda ax: plots.plot_influence(SMALL, ax=ax),
    ],
)
def test_no_text_is_cut_or_covered(draw: Any, size: tuple[float, float] | None) -> None:
    ax = None if size is None else plt.subplots(figsize=size, layout="constrained")[1]
    ax = draw(ax)
    figure = ax.figure
    assert ax.get_title(loc="left")[:1].isupper()
    figure.canvas.draw()
    for axis in (ax.xaxis, ax.yaxis):
        labels = [label for label in axis.get_ticklabels() if label.get_text()]
        boxes = [label.get_window_extent() for label in labels]
        for one, other in itertools.combinations(boxes, 2):
            assert not one.overlaps(other)
    drawn, (wide, high) = figure.get_tightbbox(), figure.get_size_inches()
    assert -0.01 <= drawn.x0 < drawn.x1 <= wide + 0.01
    assert -0.01 <= drawn.y0 < drawn.y1 <= high + 0.01
    mixed = [text for text in figure.axes[0].texts if "any of" in text.get_text()]
    written = [text.get_window_extent() for text in mixed]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(written, 2))
    legend = figure.axes[0].get_legend()
    assert legend is None or not legend.get_window_extent().overlaps(figure.axes[0].bbox)


@pytest.mark.parametrize("wide", [4.2, 9.0])
def test_a_legend_stands_apart_at_any_width(wide: float) -> None:
    figure, ax = plt.subplots(figsize=(wide, 3.2), layout="constrained")
    curve(MAINTENANCE, "discount", policy="random").plot(ax)
    figure.canvas.draw()
    legend = ax.get_legend().get_window_extent()
    assert not legend.overlaps(ax.bbox)
    assert figure.bbox.x0 <= legend.x0 < legend.x1 <= figure.bbox.x1


def test_the_acceptability_curve_is_the_distribution_of_the_regret(draws: Any) -> None:
    both = draws.plot()
    for number, line in enumerate(both.lines):
        tolerances, shares = line.get_data()
        lost = draws.regret(number)
        assert np.allclose(shares, [(lost <= t).mean() for t in tolerances])
    assert both.lines[0].get_ydata()[-1] >= 0.98
    assert "Δ (reward)" in both.get_xlabel()
    ticks, near = both.get_xticks(), both.xaxis.get_transform().linthresh
    assert ticks[0] == 0
    assert len(ticks) > 1
    assert (ticks[1:] > near).all()  # none stands upon the 0
    both.figure.canvas.draw()
    assert [float(label.get_text()) for label in both.get_xticklabels()] == pytest.approx(ticks)


def test_the_heat_map_shows_shares_of_draws(draws: Any) -> None:
    ax = plots.plot_optimal_actions(draws)
    assert np.allclose(ax.collections[0].get_array(), draws.probability_optimal()[0])
    assert texts_of(ax.get_yticklabels()) == list(draws.labels)


def test_figures_of_learning() -> None:
    """What is drawn is the mean of each run, with a legend, on labelled axes."""
    mdp, learner = Scenario.load("yuan2025").compile(), QLearning(epochs=40)
    names = ("constant ε", "another run")
    curves = {
        name: learning_curve(mdp, learner.train(mdp, k), rng=1) for k, name in enumerate(names)
    }
    learned = outcomes(mdp, train(mdp, learner, 12, rng=0))
    with plots.style():
        drawn = [
            plots.plot_learning_curves(curves, optimum=146.2, window=5),
            plots.plot_regrets({"constant ε": learned}, ax=Figure().subplots()),
            plots.plot_distinct({"constant ε": learned, "again": learned}),
            plots.plot_learning_curves(curves),  # a window longer than the curve
        ]
    for ax in drawn:
        assert ax.get_ylabel()
        ax.figure.canvas.draw()
    smoothed, regrets, distinct, _ = drawn
    assert legend_of(smoothed) == [*names, "optimum"]
    lines = {line.get_label(): line.get_ydata() for line in smoothed.lines}
    exact = curves["constant ε"].value
    assert lines["constant ε"] == pytest.approx([exact[i : i + 5].mean() for i in range(36)])
    x, y = regrets.lines[0].get_data()
    assert (x[-1], y[-1]) == (learned.regret.max(), 1)
    assert f"{learned.regret.mean():.2f}" in legend_of(regrets)[0]
    assert sum(bar.get_height() for bar in distinct.patches) == pytest.approx(2)


def test_figures_of_indices() -> None:
    names = ["base.anger", "discount", "reward.anger"]
    indices = sobol(SMALL, policy="always:directive", names=names, n=16, rng=0)
    for output in ("optimal", "fixed", "regret"):
        ax = indices.plot(output=output)
        assert ax.get_xlabel().startswith("share")
        ax.figure.canvas.draw()
    ax = indices.plot(most=2)
    total = dict(zip(indices.names, indices.optimal.total, strict=True))
    widths = [patch.get_width() for patch in ax.patches]
    assert widths[2:] == sorted(total.values(), reverse=True)[:2]
    assert ax.get_yticklabels()[0].get_text().startswith(max(total, key=total.__getitem__))


def test_bars_stand_in_the_order_of_the_table() -> None:
    """By the whole length of a bar, not by the end that is farther from today's value."""
    family = Family(
        parameters={"near": 2, "far": 0},
        build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]], [at["near"] + at["far"], 0]),
    )
    bars = tornado(family, ranges={"near": (0, 4), "far": (0, 3)})
    assert bars.frame()["parameter"].tolist() == ["near", "far"]
    for output in ("optimal", "fixed", "regret"):
        shown = texts_of(bars.plot(output=output).get_yticklabels())
        assert shown == ["near [0, 4]", "far [0, 3]"]
    assert texts_of(bars.plot(most=1).get_yticklabels()) == ["near [0, 4]"]
    wide = {"near": ("3/2", "5/2"), "far": ("-4/5", "1/10")}
    shown = texts_of(tornado(family, ranges=wide).plot().get_yticklabels())
    assert shown == ["near [1.5, 2.5]", "far [-0.8, 0.1]"]
