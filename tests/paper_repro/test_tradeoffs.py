"""The part of the report about anger and completed subtasks: its numbers, found another way."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pytest

from exact_mdp import evaluate
from exact_mdp.paper_repro.reading import QUICK, default
from exact_mdp.paper_repro.report.tradeoffs import PICTURES, held_to, tradeoffs_part


def test_the_numbers_are_those_of_the_policies() -> None:
    """The free optimum is the optimum; a held one, evaluated in floats, has its totals."""
    reading = default(QUICK)
    part = tradeoffs_part(reading)
    free, *_ = rows = part.tables[0].rows
    best = reading.evaluations["optimal"]
    assert free[1:4] == (
        f"{best.mean:.3f}",
        f"−{-best.components['anger']:.3f}",
        f"{best.components['subtask-complete']:.3f}",
    )
    half = held_to(reading, "-1/2")
    measured = evaluate(reading.mdp, half.policy)
    assert measured.mean == pytest.approx(float(half.start_value))
    assert measured.components["anger"] == pytest.approx(-0.5)
    (sentence,) = part.sentences
    assert f"costs {best.mean - measured.mean:.3f} of its return of {best.mean:.3f}" in sentence
    near = held_to(reading, "-499/1000")  # the price is the slope where no vertex is near
    slope = (half.start_value - near.start_value) * 1000
    assert float(slope) == pytest.approx(float(half.prices["anger"]))
    returns = [float(row[1]) for row in rows]
    assert returns == sorted(returns, reverse=True)


def test_the_picture_has_the_reported_policies_below_the_front() -> None:
    (picture,) = PICTURES
    figure = picture.draw(default(QUICK))
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels[1] == "optimal policy (on the front)"
    assert all("(distance 0." in label for label in labels[2:])
    plt.close(figure)
