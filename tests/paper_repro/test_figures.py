"""The figures of the report: words and units, equal scales, and nothing that is cut off."""

from __future__ import annotations

import re
from collections.abc import Iterator

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from reading_cases import small_search

from exact_mdp.analysis.plots import plot_influence, plot_return_distribution, style
from exact_mdp.mdp import Scenario
from exact_mdp.paper_repro.reading import QUICK, Reading, default
from exact_mdp.paper_repro.readings.wording import changes
from exact_mdp.paper_repro.report.drawings import (
    Average,
    combinations,
    plot_averages,
    plot_choices,
    plot_status_policy,
)
from exact_mdp.paper_repro.report.figures import PICTURES
from exact_mdp.paper_repro.report.readings import _broken, _changed
from exact_mdp.paper_repro.reported import ACTIONS, STATUSES
from exact_mdp.solvers import return_distribution

mpl.use("Agg")
QUICKEST = (
    "status_transitions", "influence_graph", "optimal_policy_map", "return_distributions",
    "cost_of_choices",
)  # fmt: skip


@pytest.fixture(scope="module")
def view() -> Reading:
    return default(QUICK)


@pytest.fixture(scope="module")
def figures(view: Reading) -> Iterator[dict[str, Figure]]:
    with style():
        yield {p.name: p.draw(view) for p in PICTURES if p.name in QUICKEST}
    plt.close("all")


@pytest.fixture
def ax() -> Iterator[Axes]:
    with style():
        yield plt.subplots(figsize=(6, 5))[1]
    plt.close("all")


def texts(drawn: Axes | Figure) -> list[str]:
    found = (each for each in drawn.findobj(Text) if each.get_visible())
    return [each.get_text() for each in found if each.get_text()]


@pytest.mark.parametrize("name", QUICKEST)
def test_nothing_is_cut_off_at_any_resolution(figures: dict[str, Figure], name: str) -> None:
    figure = figures[name]
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for dpi in (110, 200):
        figure.set_dpi(dpi)
        figure.draw_without_rendering()
        drawn, (wide, high) = figure.get_tightbbox(), figure.get_size_inches()
        assert -0.01 <= drawn.x0 < drawn.x1 <= wide + 0.01
        assert -0.01 <= drawn.y0 < drawn.y1 <= high + 0.01


@pytest.mark.parametrize("name", QUICKEST)
def test_figures_say_no_negative_nothing_and_no_code_names(
    figures: dict[str, Figure], name: str
) -> None:
    for text in texts(figures[name]):
        assert not re.search(r"[-−]0(\.0+)?(?![\d.])", text)
        assert "_" not in text


def test_averages_have_a_unit_and_no_negative_nothing(ax: Axes) -> None:
    row = Average(label="a", exact=10.0, standard_error=1.0, reported=10.01, span=(8.0, 11.0))
    plot_averages([row], optimum=12.0, ax=ax)
    assert ax.get_xlabel() == "average return (points)"
    assert [each.get_text() for each in ax.texts] == ["+0.0 s.e.", "optimum 12.0"]


def test_losses_are_positive_numbers_or_words(ax: Axes) -> None:
    losses = np.array([[0.0, 0.004, 1.5]])
    plot_choices(losses, rows=["well"], columns=["a", "b", "c"], marked={0: 1}, ax=ax)
    assert [each.get_text() for each in ax.texts] == ["best", "under 0.01", "1.50"]
    ((x, y),) = [line.get_xydata()[0] for line in ax.lines]
    assert 1 < x < 2
    assert 0 < y < 1


def test_distributions_are_on_one_scale(figures: dict[str, Figure]) -> None:
    axes = figures["return_distributions"].axes
    assert len({(each.get_xlim(), each.get_ylim()) for each in axes}) == 1
    for each in axes:
        assert sum(bar.get_height() for bar in each.patches) == pytest.approx(1)


def test_stretches_add_up_what_lies_in_them(view: Reading, ax: Axes) -> None:
    law = return_distribution(view.mdp, "random")
    plot_return_distribution(law, bin=7, ax=ax)
    values = np.array([float(value) for value in law.values])
    for bar in ax.patches:
        low = round(bar.get_x())
        assert low % 7 == 0
        inside = (values >= low) & (values < low + 7)
        assert bar.get_height() == pytest.approx(law.probabilities[inside].sum(), abs=1e-12)


def test_policy_maps_are_words(ax: Axes) -> None:
    names = Scenario.load("yuan2025").statuses
    choices, shares = np.arange(16) % 4, np.linspace(0.5, 1, 16)
    plot_status_policy(ACTIONS, choices, statuses=names, shares=shares, marked=[5], ax=ax)
    assert ax.get_legend() is None
    rows = [label.get_text() for label in ax.get_yticklabels()]
    assert rows == combinations(names[:2])
    assert rows == ["neither", "confusion", "forgetfulness", "forgetfulness\nconfusion"]
    for vector, text in enumerate(ax.texts):
        assert text.get_text().startswith(ACTIONS[choices[vector]])
        assert ("not optimal" in text.get_text()) == (vector == 5)
        column, row = int(text.get_position()[0]), int(text.get_position()[1])
        assert STATUSES[vector] == f"{row:02b}{column:02b}"


def test_the_dots_are_the_changes(ax: Axes) -> None:
    space = small_search().space
    numbers = [0, 1, len(space) // 2, len(space) - 1]
    _changed(ax, space, numbers)
    heads = [label.get_text() for label in ax.get_xticklabels()]
    black = [line for line in ax.lines if line.get_color() == "black"]
    for row, (number, line) in enumerate(zip(numbers, black, strict=True)):
        assert set(line.get_ydata()) <= {row}
        told = ", ".join(heads[int(x)] for x in line.get_xdata())
        assert told == (changes(space, number) if number else "")


def test_lines_are_of_nearly_equal_length() -> None:
    assert _broken("every trial costs") == "every trial costs"
    lines = _broken("a skip takes a timestep of its own").splitlines()
    assert len(lines) == 2
    assert max(map(len, lines)) <= 22


def test_each_influence_is_an_arrow_with_its_number(ax: Axes) -> None:
    scenario = Scenario.load("yuan2025")
    plot_influence(scenario, ax=ax)
    found = sorted(text.get_text() for text in ax.texts if text.get_text().startswith("+"))
    pairs = [(a, b) for a in scenario.statuses for b in scenario.statuses if a != b]
    assert found == sorted(f"+{float(100 * scenario[f'influence.{a}.{b}']):g}" for a, b in pairs)
    boxes = [text.get_position() for text in ax.texts]
    apart = [np.hypot(a - c, b - d) for k, (a, b) in enumerate(boxes) for c, d in boxes[:k]]
    assert min(apart) > 0.12  # no label on another
