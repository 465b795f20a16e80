"""The paper's section about its agents: claims with verdicts, figures, an example."""

from __future__ import annotations

import matplotlib as mpl
import pytest

from exact_mdp.mdp import Scenario
from exact_mdp.mdp.care.perception import perceived
from exact_mdp.paper_repro.agents.claims import statements
from exact_mdp.paper_repro.report import section42
from exact_mdp.solvers import evaluate


def test_each_statement_has_a_verdict() -> None:
    rows = section42.claims()
    assert [row.claim for row in rows] == [each.claim for each in statements()]
    verdicts = {section42.CHECKED, section42.MODEL, section42.PEOPLE}
    assert {row.verdict for row in rows} == verdicts
    assert all(row.place and row.evidence for row in rows)


def test_the_measured_perception_is_that_of_its_noise() -> None:
    found = section42.measured()
    assert found.counts.counts.sum() == 16 * section42.EACH
    rates = found.counts.rates(Scenario.load(section42.SCENARIO).statuses)
    inside = [
        rate.low <= 1 - section42.NOISE <= rate.high
        for both in rates.values()
        for rate in both.values()
    ]
    assert sum(inside) >= 7  # of eight intervals at 95 %
    mean = found.costs.value.value
    seen = perceived(found.mdp, found.policy, found.counts.counts / section42.EACH)
    assert mean == pytest.approx(evaluate(found.mdp, seen).mean, rel=1e-12)


@pytest.mark.slow
def test_figures_and_numbers() -> None:
    import matplotlib.pyplot as plt

    mpl.use("Agg")
    for name, draw in section42.figures().items():
        figure = draw()
        assert name.isidentifier()
        assert draw.__doc__
        assert figure.axes[0].get_title()
    plt.close("all")
    told = section42.summary()
    assert told["taken_as_true_at_90"] < told["memoryless_at_90"] < told["filtering_low_at_90"]
    assert told["measured_low"] < told["measured_high"] < told["perfect"]


def test_the_example_is_the_papers_record() -> None:
    text = section42.conversation_text(timesteps=2)
    assert text.splitlines()[0].endswith("No real person took part.")
    assert "Timestep 1" in text
    assert "Timestep 2" not in text
    assert text == section42.conversation_text(timesteps=2)
